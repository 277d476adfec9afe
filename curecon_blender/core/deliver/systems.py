# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a deliverable's file says of its coordinates: as WKT, as GeoTIFF's keys, in words. In English, like the
formats themselves."""

from __future__ import annotations

from ..base.options import LOCAL, SITE, UTM
from ..base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN
from .placement import Placement

_DATUMS = {ELLIPSOID: "above the WGS84 ellipsoid, not above sea level",
           SEA_LEVEL: "above sea level, as the photos state it; which geoid is not known",
           UNKNOWN: "above an unknown datum: the photos do not say whether ellipsoid or sea level"}
# EPSG's numbers of vertical systems: mean sea level, and (GeoTIFF's own) the WGS84 ellipsoid.
_MEAN_SEA_LEVEL, _GEOTIFF_ELLIPSOID = 5714, 5030
_WGS84 = ('GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
          'AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
          'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]')
_METRE = 'UNIT["metre",1,AUTHORITY["EPSG","9001"]]'
_PLAN_AXES = 'AXIS["Easting",EAST],AXIS["Northing",NORTH]'
_VERTICAL = {
    SEA_LEVEL: f'VERT_CS["MSL height",VERT_DATUM["Mean Sea Level",2005,AUTHORITY["EPSG","5100"]],{_METRE},'
               f'AXIS["Up",UP],AUTHORITY["EPSG","{_MEAN_SEA_LEVEL}"]]',
    ELLIPSOID: f'VERT_CS["WGS 84 ellipsoidal height",VERT_DATUM["WGS 84 ellipsoid",2002],{_METRE},AXIS["Up",UP]]',
}
# Keys of GeoTIFF 1.1 and their values.
_MODEL, _RASTER, _CITATION, _GEOGRAPHIC = 1024, 1025, 1026, 2048
_PROJECTED, _PROJECTED_CITATION, _METHOD, _LINEAR_UNIT = 3072, 3073, 3075, 3076
_VERTICAL_SYSTEM, _VERTICAL_CITATION, _VERTICAL_UNIT = 4096, 4097, 4099
_ORIGIN_LONGITUDE, _ORIGIN_LATITUDE, _FALSE_EAST, _FALSE_NORTH, _SCALE = 3080, 3081, 3082, 3083, 3092
_PROJECTED_MODEL, _OWN, _AREA, _METRES, _TRANSVERSE_MERCATOR = 1, 32767, 1, 9001, 1

GeoKeys = dict[int, int | float | str]

# What LAS says of extra bytes and of a record, and the name of E57.
CONFIDENCE, VIEWS, SIGMA = "of the match, per cent", "photos that confirm it", "std deviation, mm, 0 unknown"
TEXT_AREA, COPC_INFO, E57_NAME = "Text area description", "COPC info", "ASTM E57 3D Imaging Data File"


def _zone_name(placement: Placement) -> str:
    zone, south = placement.zone
    return f"{zone}{'S' if south else 'N'}"


def epsg(placement: Placement) -> int:
    """Of the UTM zone."""
    zone, south = placement.zone
    return (32700 if south else 32600) + zone


def _datum(placement: Placement) -> str | None:
    """What the heights count from, where they are altitudes."""
    if placement.kind != UTM or placement.origin.altitude is None:
        return None
    return placement.origin.altitude_datum


def wkt(placement: Placement) -> str:
    """The system as WKT 1 (OGC 01-009), which LAS asks for."""
    if placement.kind == LOCAL:
        axes = _PLAN_AXES if placement.frame.north else 'AXIS["X",OTHER],AXIS["Y",OTHER]'
        unit = _METRE if placement.unit else 'UNIT["unknown",1]'
        return f'LOCAL_CS["Site frame",LOCAL_DATUM["Site",32767],{unit},{axes}]'
    if placement.kind == SITE:
        name, end = "Site frame", ""
        parameters = {"latitude_of_origin": placement.origin.latitude, "central_meridian": placement.origin.longitude,
                      "scale_factor": 1.0, "false_easting": 0.0, "false_northing": 0.0}
    else:
        zone, south = placement.zone
        name, end = f"WGS 84 / UTM zone {_zone_name(placement)}", f',AUTHORITY["EPSG","{epsg(placement)}"]'
        parameters = {"latitude_of_origin": 0.0, "central_meridian": 6.0 * zone - 183, "scale_factor": 0.9996,
                      "false_easting": 500_000.0, "false_northing": 10_000_000.0 if south else 0.0}
    told = ",".join(f'PARAMETER["{parameter}",{value:.15g}]' for parameter, value in parameters.items())
    plan = f'PROJCS["{name}",{_WGS84},PROJECTION["Transverse_Mercator"],{told},{_METRE},{_PLAN_AXES}{end}]'
    height = _VERTICAL.get(_datum(placement) or "")
    return f'COMPD_CS["{name} + height",{plan},{height}]' if height else plan


def geokeys(placement: Placement, *, heights: bool) -> GeoKeys:
    """The system as keys of a GeoTIFF whose plane is the plan, and whose values are heights or colours."""
    if placement.kind == LOCAL:
        return _of_plane("Site frame, in metres" if placement.unit else "Site frame, scale unknown", placement.unit)
    keys: GeoKeys = {_MODEL: _PROJECTED_MODEL, _RASTER: _AREA, _LINEAR_UNIT: _METRES}
    if placement.kind == SITE:
        return keys | {
            _CITATION: "Site frame", _GEOGRAPHIC: 4326, _PROJECTED: _OWN, _PROJECTED_CITATION: "Site frame",
            _METHOD: _TRANSVERSE_MERCATOR, _ORIGIN_LONGITUDE: placement.origin.longitude,
            _ORIGIN_LATITUDE: placement.origin.latitude, _FALSE_EAST: 0.0, _FALSE_NORTH: 0.0, _SCALE: 1.0,
        }
    keys[_PROJECTED] = epsg(placement)
    datum = _datum(placement)
    if heights and datum in _VERTICAL:
        keys |= {_VERTICAL_SYSTEM: _MEAN_SEA_LEVEL if datum == SEA_LEVEL else _GEOTIFF_ELLIPSOID,
                 _VERTICAL_CITATION: f"Heights {_DATUMS[datum]}", _VERTICAL_UNIT: _METRES}
    return keys


def facade_geokeys(placement: Placement, side: str) -> GeoKeys:
    """Keys of a GeoTIFF whose plane is a façade's."""
    return _of_plane(f"Facade {side}: x along it to the right, y up", placement.unit)


def _of_plane(name: str, unit: str) -> GeoKeys:
    """Of a plane that is none of the Earth's."""
    keys: GeoKeys = {_MODEL: _OWN, _RASTER: _AREA, _CITATION: name}
    return keys | ({_LINEAR_UNIT: _METRES} if unit else {})


def words(placement: Placement) -> list[str]:
    """What a file says of its coordinates, in sentences."""
    frame = placement.frame
    if placement.kind == UTM:
        altitude, datum = placement.origin.altitude, placement.origin.altitude_datum
        heights = ("Heights count from the site's own zero: its altitude is unknown." if altitude is None
                   else f"Heights are altitudes {_DATUMS[datum]}.")
        lines = [f"UTM zone {_zone_name(placement)} on WGS84 (EPSG:{epsg(placement)}), metres.", heights]
    else:
        unit = "metres" if placement.unit else "of unknown scale: do not measure"
        axes = "x east, y north, z up" if frame.north else "z up, north unknown"
        lines = [f"Coordinates of the site: {axes}, {unit}.", "Heights count from the site's own zero."]
    if placement.kind == SITE:
        origin = placement.origin
        altitude_said = ("its altitude is unknown" if origin.altitude is None
                         else f"its altitude is {origin.altitude:.3f} m {_DATUMS[origin.altitude_datum]}")
        lines.append(f"Their origin lies at WGS84 latitude {origin.latitude:.9f}, longitude {origin.longitude:.9f}; "
                     f"{altitude_said}.")
    if frame.doubt:
        lines.append("Heights are doubtful.")
    return lines

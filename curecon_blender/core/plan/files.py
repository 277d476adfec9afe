# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Plans as files: DJI's KMZ (WPML), Litchi's CSV, KML and GPX. Heights count from take-off.

Formats: DJI's published WPML description, Litchi's mission CSV, OGC KML 2.2, GPX 1.1.
"""

from __future__ import annotations

import csv
import io
import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ..base.errors import PlanError
from ..base.files import atomic_write
from ..base.geodesy import enu_to_geodetic
from .records import Flight, Plan, Waypoint

_WPMZ = "http://www.dji.com/wpmz/1.0.2"
_KML = "http://www.opengis.net/kml/2.2"
_XML = '<?xml version="1.0" encoding="UTF-8"?>\n'
_LITCHI = ["latitude", "longitude", "altitude(m)", "heading(deg)", "curvesize(m)", "rotationdir", "gimbalmode",
           "gimbalpitchangle", *(f"{part}{n}" for n in range(1, 16) for part in ("actiontype", "actionparam")),
           "altitudemode", "speed(m/s)", "poi_latitude", "poi_longitude", "poi_altitude(m)", "poi_altitudemode",
           "photo_timeinterval", "photo_distinterval"]
_STAY, _PHOTO, _NOTHING = 0, 1, -1  # Litchi's actions
_STILL = 1000  # milliseconds that the drone hangs before a photo


def positions(plan: Plan, waypoints: tuple[Waypoint, ...]) -> np.ndarray:
    """(N,3) latitude, longitude in degrees, metres above take-off.

    Raises PlanError where the building's place on Earth is not known.
    """
    origin = plan.building.origin
    if origin is None:
        raise PlanError("The building's position is not known, so no mission file can be written.",
                        remedy="Give its latitude and longitude (--position).")
    places = np.array([waypoint.place for waypoint in waypoints])
    geodetic = enu_to_geodetic(np.c_[places[:, :2], np.zeros(len(places))], origin)
    geodetic[:, 1] = (geodetic[:, 1] + 180) % 360 - 180
    geodetic[:, 2] = places[:, 2] - plan.wishes.takeoff[2]
    return geodetic


def write_kmz(path: Path, plan: Plan, flight: Flight, created: int) -> None:
    """One flight for DJI Fly and Pilot 2; `created` is the time in milliseconds since 1970."""
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("wpmz/template.kml", _document(
            f"<wpml:author>CU-Recon</wpml:author><wpml:createTime>{created}</wpml:createTime>"
            f"<wpml:updateTime>{created}</wpml:updateTime>{_configuration(plan)}"))
        archive.writestr("wpmz/waylines.wpml", _document(_configuration(plan) + _wayline(plan, flight)))


def write_litchi(path: Path, plan: Plan, flight: Flight) -> None:
    """One flight as a mission that Litchi's hub imports."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(_LITCHI)
    places = positions(plan, flight.waypoints)
    for waypoint, (latitude, longitude, height) in zip(flight.waypoints, places, strict=True):
        actions = [(_STAY, _STILL), (_PHOTO, 0)] if waypoint.photo else []
        actions += [(_NOTHING, 0)] * (15 - len(actions))
        rows.writerow([f"{latitude:.8f}", f"{longitude:.8f}", f"{height:.2f}", f"{waypoint.heading % 360:.1f}", 0, 0, 2,
                       f"{waypoint.pitch:.1f}", *(value for action in actions for value in action),
                       0, f"{plan.speed:.1f}", 0, 0, 0, 0, -1, -1])
    _write(path, out.getvalue())


def write_kml(path: Path, plan: Plan) -> None:
    """All flights as lines, and the photos as points, for a globe."""
    parts = []
    for n, flight in enumerate(plan.flights, start=1):
        found = positions(plan, flight.waypoints)
        line = " ".join(_lon_lat(place) + f",{place[2]:.2f}" for place in found)
        points = "".join(
            f"<Placemark><name>{escape(waypoint.leg)}</name><Point><altitudeMode>relativeToGround</altitudeMode>"
            f"<coordinates>{_lon_lat(place)},{place[2]:.2f}</coordinates></Point></Placemark>"
            for waypoint, place in zip(flight.waypoints, found, strict=True) if waypoint.photo)
        parts.append(f"<Folder><name>Flight {n}</name><Placemark><name>Way</name><LineString>"
                     f"<altitudeMode>relativeToGround</altitudeMode><coordinates>{line}</coordinates></LineString>"
                     f"</Placemark>{points}</Folder>")
    _write(path, f'{_XML}<kml xmlns="{_KML}"><Document>{"".join(parts)}</Document></kml>\n')


def write_gpx(path: Path, plan: Plan) -> None:
    """Each flight as a route; `ele` is metres above take-off."""
    routes = []
    for n, flight in enumerate(plan.flights, start=1):
        points = "".join(f'<rtept lat="{place[0]:.8f}" lon="{place[1]:.8f}"><ele>{place[2]:.2f}</ele></rtept>'
                         for place in positions(plan, flight.waypoints))
        routes.append(f"<rte><name>Flight {n}</name>{points}</rte>")
    _write(path, f'{_XML}<gpx version="1.1" creator="CU-Recon" '
           f'xmlns="http://www.topografix.com/GPX/1/1">{"".join(routes)}</gpx>\n')


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as file:
        file.write(text.encode())


def _document(inside: str) -> str:
    return f'{_XML}<kml xmlns="{_KML}" xmlns:wpml="{_WPMZ}"><Document>{inside}</Document></kml>\n'


def _configuration(plan: Plan) -> str:
    security = min(max(plan.building.obstacles.highest + plan.wishes.clearance - plan.wishes.takeoff[2], 2.0), 1500.0)
    return _element("missionConfig", {
        "flyToWaylineMode": "safely", "finishAction": "goHome", "exitOnRCLost": "executeLostAction",
        "executeRCLostAction": "goBack", "takeOffSecurityHeight": f"{security:.1f}",
        "globalTransitionalSpeed": f"{plan.speed:.1f}",
        "droneInfo": {"droneEnumValue": str(plan.drone.wpml), "droneSubEnumValue": "0"},
    })


def _wayline(plan: Plan, flight: Flight) -> str:
    places = positions(plan, flight.waypoints)
    points = "".join(_placemark(plan, n, waypoint, place)
                     for n, (waypoint, place) in enumerate(zip(flight.waypoints, places, strict=True)))
    facts = _elements({"templateId": "0", "executeHeightMode": "relativeToStartPoint", "waylineId": "0",
                       "distance": f"{flight.metres:.1f}", "duration": f"{flight.minutes * 60:.1f}",
                       "autoFlightSpeed": f"{plan.speed:.1f}"})
    return f"<Folder>{facts}{points}</Folder>"


def _placemark(plan: Plan, n: int, waypoint: Waypoint, place: np.ndarray) -> str:
    heading = (waypoint.heading + 180) % 360 - 180
    facts = _elements({
        "index": str(n), "executeHeight": f"{place[2]:.2f}", "waypointSpeed": f"{plan.speed:.1f}",
        "waypointHeadingParam": {"waypointHeadingMode": "smoothTransition", "waypointHeadingAngle": f"{heading:.1f}",
                                 "waypointPoiPoint": "0.000000,0.000000,0.000000", "waypointHeadingAngleEnable": "1",
                                 "waypointHeadingPathMode": "followBadArc"},
        "waypointTurnParam": {"waypointTurnMode": "toPointAndStopWithDiscontinuityCurvature",
                              "waypointTurnDampingDist": "0"},
        "useStraightLine": "1",
    })
    turn: _Values = {
        "gimbalHeadingYawBase": "aircraft", "gimbalRotateMode": "absoluteAngle", "gimbalPitchRotateEnable": "1",
        "gimbalPitchRotateAngle": f"{waypoint.pitch:.1f}", "gimbalRollRotateEnable": "0", "gimbalRollRotateAngle": "0",
        "gimbalYawRotateEnable": "0", "gimbalYawRotateAngle": "0", "gimbalRotateTimeEnable": "0",
        "gimbalRotateTime": "0", "payloadPositionIndex": "0",
    }
    actions: list[tuple[str, _Values]] = [("gimbalRotate", turn)]
    if waypoint.photo:
        actions.append(("takePhoto", {"payloadPositionIndex": "0", "useGlobalPayloadLensIndex": "0"}))
    group = _elements({"actionGroupId": str(n), "actionGroupStartIndex": str(n), "actionGroupEndIndex": str(n),
                       "actionGroupMode": "sequence", "actionTrigger": {"actionTriggerType": "reachPoint"}})
    for number, (function, values) in enumerate(actions):
        action: _Values = {"actionId": str(number), "actionActuatorFunc": function, "actionActuatorFuncParam": values}
        group += _element("action", action)
    return (f"<Placemark><Point><coordinates>{_lon_lat(place)}</coordinates></Point>{facts}"
            f"<wpml:actionGroup>{group}</wpml:actionGroup></Placemark>")


_Values = dict[str, "str | _Values"]


def _elements(values: _Values) -> str:
    return "".join(_element(name, value) for name, value in values.items())


def _element(name: str, value: str | _Values) -> str:
    return f"<wpml:{name}>{_elements(value) if isinstance(value, dict) else escape(value)}</wpml:{name}>"


def _lon_lat(place: np.ndarray) -> str:
    return f"{place[1]:.8f},{place[0]:.8f}"

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the report says of a part: its survey, and four words, each with plain sentences, its figures and its maps.

What is a Text is said in the report's language; what is a plain string is a name or a number and stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from ..base.language import Text
from . import maps
from .document import Picture, Section, length, listed, rounded, share, short
from .figures import Correctness, Part, Residuals, Survey
from .maps import Lettering
from .measure import GROUND, ROOFS, SEEN_WELL, WALLS, Site, finest_pixels
from .tables import gps_table, lens_table, points_table

_MOST_VIEWS = 8  # photos at the end of the colour bar
_RESOLVED = 3  # pixels that a detail needs to be told
_FINE = 1.5  # times the photos' pixel that a texture may be and still be as fine
_SEEN_WHOLE = 0.95  # of a kind of surface: what is seen better needs no word
_KINDS = {WALLS: Text("walls"), ROOFS: Text("roofs"), GROUND: Text("ground")}


def sections_of(site: Site, lettering: Lettering) -> list[Section]:
    """What is told of one part."""
    part, cloud = site.part, site.cloud
    unit = "m" if part.correctness.metres else Text("units")
    plan = maps.plan_of(cloud.points, unit, lettering, north=part.correctness.north)
    above = Picture(Text("From above, in the photos' colours. White: nothing was measured."),
                    maps.photo_map(plan, cloud.colours))
    ends = [Text("{}", "2"), Text("{}", str((2 + _MOST_VIEWS) // 2)), Text("{} or more", str(_MOST_VIEWS))]
    views = Picture(Text("How many photos measured the surface."),
                    maps.ramp_map(plan, cloud.views.astype(float), 2, _MOST_VIEWS, ends))
    return [
        _survey(part, (above,)),
        _clearness(part, (_pixel_map(site, plan),)),
        _accuracy(site, (*_precision_map(site, plan), *_camera_map(site, lettering), *_pattern_maps(site, lettering))),
        _integrity(part, (views,)),
        _authenticity(site, lettering),
    ]


def _survey(part: Part, pictures: tuple[Picture, ...]) -> Section:
    survey, metres = part.survey, part.correctness.metres
    area = f"{survey.area:,.0f} m²" if metres else Text("{} square units", f"{survey.area:.3g}")
    above = rounded(survey.above, metres=metres)
    rows = [(Text("Photos placed"), Text("{} of {}", str(part.integrity.placed), str(part.integrity.photos))),
            (Text("Photos taken"), _taken(survey)),
            (Text("Cameras above the ground, median"), above),
            (Text("Area in plan"), area), (Text("Points"), f"{part.points:,}"),
            (Text("Faces"), f"{part.faces:,}" if part.faces else Text("no mesh")),
            (Text("Tie points"), f"{survey.tied.points:,}"),
            (Text("Observations of them"), f"{survey.tied.observations:,}"),
            (Text("Photos that see a tie point, median"), f"{survey.tied.photos:.0f}"),
            (Text("Tie points in a photo, median and fewest"), f"{survey.tied.usual:,.0f}, {survey.tied.fewest:,}")]
    for camera in survey.cameras:
        focal = Text("focal length unknown") if camera.focal is None else Text("focal length {} pixels",
                                                                               f"{camera.focal:.0f}")
        rows.append((Text("Camera {}", short(camera.name)),
                     Text("{} photos of {} pixels, {}", str(camera.photos), "×".join(map(str, camera.size)), focal)))
    sentence = Text("{} photos cover {}, taken from about {} above the ground.", str(part.integrity.placed), area,
                    above)
    return Section(title=Text("Survey"), sentences=(sentence,), rows=tuple(rows), pictures=pictures)


def _taken(survey: Survey) -> str:
    if survey.taken is None:
        return Text("not known")
    first, last = (datetime.fromisoformat(time) for time in survey.taken)
    day = Text("{0.day} {0:%B %Y}", first)
    if first.date() == last.date():
        return Text("{}, from {} to {}", day, f"{first:%H:%M}", f"{last:%H:%M}")
    return Text("{} to {}", day, Text("{0.day} {0:%B %Y}", last))


def _clearness(part: Part, pictures: tuple[Picture, ...]) -> Section:
    clear, metres = part.clearness, part.correctness.metres
    low, pixel, high = (length(value, metres=metres) for value in (clear.pixel.low, clear.pixel.median,
                                                                   clear.pixel.high))
    smallest = rounded(_RESOLVED * clear.pixel.median, metres=metres)
    sentences = [Text("A photo's pixel shows about {} of the site: what is smaller than {} cannot be told.", pixel,
                      smallest)]
    rows = [(Text("Ground sampling distance, median"), pixel),
            (Text("The same, for 5 % and 95 % of the points"), Text("{} to {}", low, high))]
    if clear.texel is not None:
        texel = length(clear.texel, metres=metres)
        rows.append((Text("Pixel of the texture, median"), texel))
        sentences.append(Text("The texture's pixels show {} each, as fine as the photos.", texel)
                         if clear.texel <= _FINE * clear.pixel.median else
                         Text("The texture is coarser than the photos: its pixels show {} each.", texel))
    rows.append((Text("Blurred photos in use"), str(clear.blurred)))
    rows.append((Text("Surface looked at"), Text("within {} of the middle", length(part.reach, metres=metres))))
    return Section(title=Text("Clearness"), sentences=tuple(sentences), rows=tuple(rows), pictures=pictures)


def _pixel_map(site: Site, plan: maps.Plan) -> Picture:
    at = np.unique(plan.topmost[plan.topmost >= 0])
    sizes = np.zeros(len(site.cloud), np.float32)
    sizes[at] = finest_pixels(site, site.cloud.points[at])
    low, high = np.percentile(sizes[at], [2, 98]).tolist()
    return Picture(Text("What a pixel of the nearest photo shows, were nothing in its way."),
                   maps.ramp_map(plan, sizes, low, high, _steps(low, high, metres=site.part.correctness.metres)))


def _steps(low: float, high: float, *, metres: bool) -> list[str]:
    """What stands along a bar of lengths."""
    first, middle, last = (length(value, metres=metres) for value in (low, (low + high) / 2, high))
    return [first, middle, Text("{} or more", last)]


def _accuracy(site: Site, pictures: tuple[Picture, ...]) -> Section:
    correct = site.part.correctness
    rows: list[tuple[Text, str]] = [
            (Text("Scale and place"), Text(correct.rests_on)),
            (Text("Cameras"), Text("adjusted with all that is known") if correct.adjusted
             else Text("as found or as given"))]
    if correct.doubt:
        rows.append((Text("Heights"), Text(correct.doubt)))
    if correct.reprojection_error is not None:
        rows.append((Text("Reprojection error, mean"), Text("{:.2f} pixels", correct.reprojection_error)))
    rows += _precision_rows(correct)
    for dome in correct.domes:
        rows.append((Text("Bend: the flight's edge against its middle, by {}", Text(dome.source)),
                     f"{dome.bend:+.2f} m ± {dome.sigma:.2f} m"))
    if correct.focal_sigma is not None:
        rows.append((Text("Left open of the focal length"), f"{100 * correct.focal_sigma:.2f} %"))
    if correct.shutter_shift is not None:
        rows.append((Text("Motion while a photo is read out, median"),
                     Text("{:.1f} pixels", correct.shutter_shift)))
    for kind, scale in correct.supports.items():
        rows.append((Text("Drawing of the {}", _KINDS[kind]),
                     Text("not known") if scale is None else Text("up to 1:{}", str(scale))))
    tables = [
        points_table(Text("Check points, which took no part"), correct.check),
        points_table(Text("Control points, each left out in turn"), correct.left_out),
        points_table(Text("Control points, which hold the site"), correct.control),
        gps_table(correct.gps), *(lens_table(lens) for lens in correct.lenses),
    ]
    return Section(title=Text("Accuracy"), sentences=tuple(_true(correct)), rows=tuple(rows),
                   tables=tuple(table for table in tables if table is not None), pictures=pictures)


def _true(correct: Correctness) -> list[Text]:
    """How true the site is, in sentences."""
    if not correct.metres:
        return [Text("The scale is unknown: nothing may be measured until it is set from a known length or control "
                     "points.")]
    known = {kind: scale for kind, scale in correct.supports.items() if scale is not None}
    said = listed([Text("1:{} ({})", str(scale), listed([_KINDS[kind] for kind in known if known[kind] == scale]))
                   for scale in sorted(set(known.values()))])
    if not known:
        sentences = [Text("No scale of a drawing can be named.")]
    elif correct.doubt:
        sentences = [Text("Heights are doubtful. If they are true, drawings are supported up to {}.", said)]
    else:
        sentences = [Text("Drawings are supported up to {}.", said)]
    independent = correct.check or correct.left_out
    if independent is not None:
        sentences.append(_tested(independent, left_out=correct.check is None))
    else:
        sentences.append(Text("No check point has tested that: it is what the adjustment says of itself."))
    if correct.scale is not None:
        off = length(correct.scale * correct.extent, metres=True)
        sentences.append(Text("All lengths may be off by {}, which is {} over the site's {}.",
                              share(correct.scale), off, length(correct.extent, metres=True)))
    return sentences


def _tested(points: Residuals, *, left_out: bool) -> Text:
    east, north, up = points.rms
    plan, height = length(float(np.hypot(east, north)), metres=True), length(up, metres=True)
    if left_out:
        return Text("{} control points, each left out in turn, are off by {} in plan and {} in height (RMS).",
                    str(points.count), plan, height)
    return Text("{} check points, which took no part, are off by {} in plan and {} in height (RMS).", str(points.count),
                plan, height)


def _precision_rows(correct: Correctness) -> list[tuple[Text, str]]:
    """Standard deviations in words."""
    if correct.sigmas is None:
        return [(Text("Standard deviation of a point"), Text("not known"))]

    def told(sigmas: tuple[float, float]) -> Text:
        plan, height = (length(value, metres=correct.metres) for value in sigmas)
        return Text("{} in plan, {} in height", plan, height)

    whole = correct.sigmas.whole
    return [(Text("Standard deviation of a point within the site, median"), told(correct.sigmas.within)),
            (Text("Standard deviation of a camera, median"), told(correct.sigmas.cameras)),
            (Text("Standard deviation of the site as a whole"),
             Text("nothing but the photos says where it stands") if whole is None else told(whole)),
            *([(Text("Standard deviation of every length"), f"{100 * correct.scale:.2f} %")]
              if correct.scale is not None else [])]


def _precision_map(site: Site, plan: maps.Plan) -> tuple[Picture, ...]:
    sigma = np.linalg.norm(site.cloud.sigmas, axis=1)
    if not sigma.any():
        return ()
    low, high = np.percentile(sigma, [2, 90]).tolist()
    labels = _steps(low, high, metres=site.part.correctness.metres)
    return (Picture(Text("Standard deviation of the points within the site."),
                    maps.ramp_map(plan, sigma, low, high, labels)),)


def _camera_map(site: Site, lettering: Lettering) -> tuple[Picture, ...]:
    correct = site.part.correctness
    if correct.gps is None:
        return ()
    framed = np.concatenate([site.cloud.points[:, :2], site.cameras[:, :2]])
    unit = "m" if correct.metres else Text("units")
    plan = maps.plan_of(site.cloud.points, unit, lettering, north=correct.north, shown=framed)
    return (Picture(Text("Where the cameras stand, and how far each is off its GPS: in plan by its line, in height by "
                         "its colour, red above it."),
                    maps.camera_map(plan, site.cloud.colours, site.cameras, site.off_gps,
                                    lambda value: length(value, metres=correct.metres))),)


def _pattern_maps(site: Site, lettering: Lettering) -> tuple[Picture, ...]:
    return tuple(
        Picture(Text("What the lens of {} leaves over across its photos, mean; {} over all (RMS).", short(lens.camera),
                     Text("{:.2f} pixels", lens.rms)),
                maps.pattern_map(pattern, lettering, lambda value: Text("{:.2f} pixels", value)), wide=False)
        for lens, pattern in zip(site.part.correctness.lenses, site.patterns, strict=True)
    )


def _integrity(part: Part, pictures: tuple[Picture, ...]) -> Section:
    whole = part.integrity
    sentences = [Text("{} of {} photos are in this part, and at least {} photos see {} of its surface.",
                      str(whole.placed), str(whole.photos), str(SEEN_WELL), share(whole.seen_well))]
    if whole.seen_by_kind:
        least = min(whole.seen_by_kind, key=lambda kind: whole.seen_by_kind[kind])
        if whole.seen_by_kind[least] < _SEEN_WHOLE:
            sentences.append(Text("Least is seen of the {}: {}.", _KINDS[least], share(whole.seen_by_kind[least])))
    rows = [(Text("Photos in this part"), Text("{} of {}", str(whole.placed), str(whole.photos))),
            (Text("Surface that {} or more photos see", str(SEEN_WELL)), share(whole.seen_well))]
    rows += [(Text("Of the {}", _KINDS[kind]), share(seen)) for kind, seen in whole.seen_by_kind.items()]
    rows.append((Text("Mesh that no photo measured"),
                 Text("no mesh") if whole.filled is None else share(whole.filled)))
    return Section(title=Text("Integrity"), sentences=tuple(sentences), rows=tuple(rows), pictures=pictures)


def _authenticity(site: Site, lettering: Lettering) -> Section:
    real = site.part.authenticity
    if real.filled is None:
        sentences = [Text("Every point was measured in the photos; there is no mesh yet, so nothing is filled.")]
    else:
        sentences = [Text("{} of the mesh was filled to close it, and is marked as such; the rest was measured.",
                          share(real.filled))]
    rows: list[tuple[Text, str]] = [
        (Text("Mesh that was filled"), Text("no mesh") if real.filled is None else share(real.filled)),
        (Text("Mesh that one photo alone measured"), Text("no mesh") if real.weak is None else share(real.weak)),
        (Text("Texture that no photo shows"), Text("no texture") if real.unseen is None else share(real.unseen)),
        (Text("Points that were removed by hand"), f"{real.removed_points:,}"),
    ]
    if real.removed_points:
        sentences.append(Text("{} points were removed by hand.", f"{real.removed_points:,}"))
    pictures = [*_filled_map(site, lettering)]
    if real.likeness is not None and site.likeness is not None and site.likeness.pair is not None:
        rows.append((Text("Textured mesh against {} of its photos, PSNR", str(real.compared)),
                     Text("{} (median; {} to {})", f"{real.likeness.median:.1f} dB", f"{real.likeness.low:.1f}",
                          f"{real.likeness.high:.1f}")))
        pictures.append(Picture(Text("A photo, and the textured mesh from the same place. The photo was used for the "
                                     "texture: this shows what was lost, and tests nothing."), site.likeness.pair))
    return Section(title=Text("Authenticity"), sentences=tuple(sentences), rows=tuple(rows), pictures=tuple(pictures))


def _filled_map(site: Site, lettering: Lettering) -> Sequence[Picture]:
    if site.mesh is None or not len(site.mesh.faces):
        return ()
    correct = site.part.correctness
    middles = site.mesh.vertices[site.mesh.faces].mean(axis=1)
    colours = site.mesh.colours[site.mesh.faces].astype(np.float32).mean(axis=1)
    plan = maps.plan_of(middles, "m" if correct.metres else Text("units"), lettering, north=correct.north,
                        shown=site.cloud.points)
    return (Picture(Text("Where the mesh was filled, from above."),
                    maps.marked_map(plan, colours, site.mesh.filled, Text("filled"))),)

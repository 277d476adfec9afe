# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's text: four words, each with one plain sentence, its figures and its maps; then the provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from PIL import Image

from ..cloud.ply import Cloud
from . import maps
from .figures import SEEN_WELL, Correctness, Part, Residuals, Site
from .provenance import Provenance

_MOST_VIEWS = 8  # photos at the end of the colour bar


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading, a sentence, rows of a label and its value, and pictures with their captions."""

    title: str
    sentence: str
    rows: tuple[tuple[str, str], ...] = ()
    pictures: tuple[tuple[str, Image.Image], ...] = field(default_factory=tuple)


def sections_of(site: Site) -> list[Section]:
    """What is told of one part."""
    part, cloud = site.part, site.cloud
    plan = maps.plan_of(cloud.points, "m" if part.correctness.metres else "units")
    return [
        _clearness(part, (("From above, in the photos' colours", maps.photo_map(plan, cloud.colours)),)),
        _accuracy(part, _precision_map(cloud, plan, metres=part.correctness.metres)),
        _integrity(part, ((
            "How many photos see the surface",
            maps.ramp_map(plan, cloud.views.astype(float), 2, _MOST_VIEWS, ["2", "5", f"{_MOST_VIEWS} or more"]),
        ),)),
        _authenticity(part, _filled_map(site)),
    ]


def provenance_section(provenance: Provenance) -> Section:
    """Program, settings and the photos with their digests."""
    missing = sum(not photo.sha256 for photo in provenance.photos)
    sentence = f"Made by {provenance.program} from {len(provenance.photos)} photos."
    if missing:
        sentence += f" {missing} of them are no longer in their place, so their digests are unknown."
    rows = [("Made", provenance.made), ("By", provenance.by or "not given"), ("Program", provenance.program),
            ("System", provenance.system),
            ("Libraries", ", ".join(f"{name} {number}" for name, number in provenance.libraries.items())),
            ("Weights, SHA-256", provenance.weights)]
    rows += [(f"Setting: {name}", value) for name, value in provenance.settings.items()]
    rows += [(photo.name + ("" if photo.placed else " (not placed)"), photo.sha256 or "file not found")
             for photo in provenance.photos]
    return Section(title="Provenance", sentence=sentence, rows=tuple(rows))


def length(value: float, *, metres: bool) -> str:
    """A length in words: millimetres below a metre; in units where the scale is unknown."""
    if not metres:
        return f"{value:.3g} units"
    if value < 1:
        return f"{1000 * value:.1f} mm" if value < 0.1 else f"{1000 * value:.0f} mm"
    return f"{value:.2f} m"


def share(value: float) -> str:
    return f"{100 * value:.1f} %" if value < 0.1 else f"{100 * value:.0f} %"


def _clearness(part: Part, pictures: tuple[tuple[str, Image.Image], ...]) -> Section:
    clear = part.clearness
    low, pixel, high = (length(value, metres=part.correctness.metres)
                        for value in (clear.pixel.low, clear.pixel.median, clear.pixel.high))
    texel = None if clear.texel is None else length(clear.texel, metres=part.correctness.metres)
    sentence = f"A photo's pixel shows about {pixel} of the site"
    sentence += f", and a pixel of the texture {texel}." if texel else "; there is no texture yet."
    rows = [("Ground sampling distance, median", pixel),
            ("The same, for 5 % and 95 % of the points", f"{low} to {high}"),
            ("Pixel of the texture, median", texel or "no texture"),
            ("Blurred photos in use", str(clear.blurred)),
            ("Surface looked at", f"within {length(part.reach, metres=part.correctness.metres)} of the middle"),
            ("Points", f"{part.points:,}"), ("Faces", f"{part.faces:,}" if part.faces else "no mesh")]
    return Section(title="Clearness", sentence=sentence, rows=tuple(rows), pictures=pictures)


def _accuracy(part: Part, pictures: tuple[tuple[str, Image.Image], ...]) -> Section:
    correct = part.correctness
    rows = [("Scale and place", correct.rests_on),
            ("Cameras", "adjusted with all that is known" if correct.adjusted else "as found or as given"),
            ("Reprojection error, mean",
             "not known" if correct.reprojection_error is None else f"{correct.reprojection_error:.2f} pixels")]
    if correct.doubt:
        rows.append(("Heights", correct.doubt))
    rows += _residual_rows("GPS of the photos", correct.gps)
    rows += _residual_rows("Control points, which the adjustment used", correct.control)
    rows += _residual_rows("Control points, each left out in turn", correct.left_out)
    rows += _residual_rows("Check points, which it did not use", correct.check)
    rows += _precision_rows(correct)
    for kind, scale in correct.supports.items():
        rows.append((f"Drawing of {kind}", "not known" if scale is None else f"up to 1:{scale}"))
    return Section(title="Accuracy", sentence=_supported(correct), rows=tuple(rows), pictures=pictures)


def _supported(correct: Correctness) -> str:
    if not correct.metres:
        return "The scale is unknown: nothing may be measured until it is set from a known length or control points."
    known = {kind: scale for kind, scale in correct.supports.items() if scale is not None}
    if not known:
        return "How precise the points are is not known, so no scale of a drawing can be named."
    said = [f"1:{scale} of {kind}" for kind, scale in known.items()]
    if correct.doubt:
        return f"Heights are doubtful. If they are true, drawings are supported up to {_listed(said)}."
    return f"Drawings are supported up to {_listed(said)}."


def _precision_rows(correct: Correctness) -> list[tuple[str, str]]:
    """Standard deviations in words."""
    if correct.sigmas is None:
        return [("Standard deviation of a point", "not known")]
    plan, height = (length(value, metres=correct.metres) for value in correct.sigmas.within)
    rows = [("Standard deviation of a point within the site, median", f"{plan} in plan, {height} in height")]
    if correct.sigmas.whole is None or correct.sigmas.scale is None:
        return [*rows, ("Standard deviation of the site as a whole", "nothing but the photos says where it stands")]
    plan, height = (length(value, metres=correct.metres) for value in correct.sigmas.whole)
    return [*rows, ("Standard deviation of the site as a whole",
                    f"{plan} in plan, {height} in height, {100 * correct.sigmas.scale:.2f} % of every length")]


def _precision_map(cloud: Cloud, plan: maps.Plan, *, metres: bool) -> tuple[tuple[str, Image.Image], ...]:
    sigma = np.linalg.norm(cloud.sigmas, axis=1)
    if not sigma.any():
        return ()
    low, high = np.percentile(sigma, [2, 90]).tolist()
    labels = [length(value, metres=metres) for value in (low, (low + high) / 2, high)]
    return (("Standard deviation of the points within the site", maps.ramp_map(plan, sigma, low, high, labels)),)


def _residual_rows(what: str, residuals: Residuals | None) -> list[tuple[str, str]]:
    if residuals is None:
        return [(what, "none")]
    east, north, up = residuals.rms
    return [(f"{what}, RMS of {residuals.count}",
             f"{east:.3f} m east, {north:.3f} m north, {up:.3f} m up")]


def _integrity(part: Part, pictures: tuple[tuple[str, Image.Image], ...]) -> Section:
    whole = part.integrity
    sentence = (f"{whole.placed} of {whole.photos} photos are in this part, and at least {SEEN_WELL} photos see "
                f"{share(whole.seen_well)} of its surface.")
    rows = (("Photos in this part", f"{whole.placed} of {whole.photos}"),
            (f"Surface that {SEEN_WELL} or more photos see", share(whole.seen_well)),
            ("Mesh that no photo measured", "no mesh" if whole.filled is None else share(whole.filled)))
    return Section(title="Integrity", sentence=sentence, rows=rows, pictures=pictures)


def _authenticity(part: Part, pictures: tuple[tuple[str, Image.Image], ...]) -> Section:
    real = part.authenticity
    if real.filled is None:
        sentence = "Every point was measured in the photos; there is no mesh yet, so nothing is filled."
    else:
        sentence = (f"{share(real.filled)} of the mesh was filled to close it, and is marked as such; the rest was "
                    "measured.")
    rows = (("Mesh that was filled", "no mesh" if real.filled is None else share(real.filled)),
            ("Texture that no photo shows", "no texture" if real.unshown is None else share(real.unshown)),
            ("Points that were removed by hand", f"{real.removed_points:,}"))
    return Section(title="Authenticity", sentence=sentence, rows=rows, pictures=pictures)


def _filled_map(site: Site) -> tuple[tuple[str, Image.Image], ...]:
    if site.mesh is None or not len(site.mesh.faces):
        return ()
    middles = site.mesh.vertices[site.mesh.faces].mean(axis=1)
    colours = site.mesh.colours[site.mesh.faces].astype(np.float32).mean(axis=1)
    near = np.linalg.norm(middles[:, :2] - np.median(site.cloud.points[:, :2], axis=0), axis=1) <= site.part.reach
    plan = maps.plan_of(middles, "m" if site.part.correctness.metres else "units", near)
    return (("Where the mesh was filled", maps.marked_map(plan, colours, site.mesh.filled, "filled")),)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"

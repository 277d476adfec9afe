# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Line drawings as DXF and SVG.

The DXF is of AutoCAD's release 12: plain text that every CAD program reads. A library for it would bring packages of
its own for what takes thirty lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ..base.files import atomic_write

# A layer's name, its colour by AutoCAD's number and on paper, and its line's width on paper in millimetres.
LAYERS = {
    "CUT": (7, "#000000", 0.35), "CUT_FILLED": (1, "#d04010", 0.18),
    "CONTOUR": (8, "#806040", 0.13), "CONTOUR_INDEX": (30, "#604020", 0.25), "CONTOUR_FILLED": (1, "#d04010", 0.13),
}
_SCALES = (20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
_WIDEST = 1189.0  # millimetres: A0


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """A line of a drawing: points (N,2), x right and y up, all at one `elevation`."""

    layer: str
    points: np.ndarray
    closed: bool
    elevation: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Strokes in metres (`unit` "m") or a unit unknown, and what the drawing says of itself, a sentence each."""

    strokes: Sequence[Stroke]
    words: Sequence[str]
    unit: str


def write_dxf(path: Path, drawing: Drawing) -> None:
    """One drawing unit is a metre; a stroke's elevation is its z. Raises WorkspaceError."""
    with atomic_write(path) as file:
        def put(*pairs: tuple[int, object]) -> None:
            file.write("".join(f"{code:3d}\n{value}\n" for code, value in pairs).encode("ascii", "backslashreplace"))

        put(*((999, " ".join(line.split())) for line in drawing.words))
        put((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"))
        if drawing.strokes:
            low, high = _bounds(drawing)
            put((9, "$EXTMIN"), (10, f"{low[0]:.4f}"), (20, f"{low[1]:.4f}"), (30, "0.0"))
            put((9, "$EXTMAX"), (10, f"{high[0]:.4f}"), (20, f"{high[1]:.4f}"), (30, "0.0"))
        put((0, "ENDSEC"), (0, "SECTION"), (2, "TABLES"), (0, "TABLE"), (2, "LAYER"), (70, len(LAYERS)))
        for name, (colour, _, _) in LAYERS.items():
            put((0, "LAYER"), (2, name), (70, 0), (62, colour), (6, "CONTINUOUS"))
        put((0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES"))
        for stroke in drawing.strokes:
            z = f"{stroke.elevation:.4f}"
            put((0, "POLYLINE"), (8, stroke.layer), (66, 1), (10, "0.0"), (20, "0.0"), (30, z),
                (70, int(stroke.closed)))
            for x, y in stroke.points.tolist():
                put((0, "VERTEX"), (8, stroke.layer), (10, f"{x:.4f}"), (20, f"{y:.4f}"), (30, z))
            put((0, "SEQEND"), (8, stroke.layer))
        put((0, "ENDSEC"), (0, "EOF"))


def write_svg(path: Path, drawing: Drawing) -> None:
    """At the largest round scale that A0 takes; of unknown scale as large as A4. Raises WorkspaceError."""
    low, high = _bounds(drawing) if drawing.strokes else (np.zeros(2), np.ones(2))
    size = np.maximum(high - low, 1e-6)
    if drawing.unit:
        scale = next((s for s in _SCALES if 1000 * size.max() / s <= _WIDEST), _SCALES[-1])
        millimetre, words = scale / 1000, [f"1:{scale}", *drawing.words]
    else:
        millimetre, words = float(size.max()) / 270, [*drawing.words]
    size = size + 20 * millimetre  # a margin of a centimetre
    paper = size / millimetre
    with atomic_write(path) as file:
        def put(text: str) -> None:
            file.write(text.encode())

        put(f'<svg xmlns="http://www.w3.org/2000/svg" width="{paper[0]:.2f}mm" height="{paper[1]:.2f}mm" '
            f'viewBox="0 0 {size[0]:.4f} {size[1]:.4f}">\n<desc>{escape(chr(10).join(words))}</desc>\n')
        corner = low - 10 * millimetre
        put(f'<g fill="none" stroke-linejoin="round" data-left="{corner[0]:.4f}" data-bottom="{corner[1]:.4f}">\n')
        for layer, (_, colour, width) in LAYERS.items():
            strokes = [stroke for stroke in drawing.strokes if stroke.layer == layer]
            if not strokes:
                continue
            put(f'<g id="{layer}" stroke="{colour}" stroke-width="{width * millimetre:.6f}">\n')
            for stroke in strokes:
                points = stroke.points - corner
                points[:, 1] = size[1] - points[:, 1]
                told = " ".join(f"{x:.3f},{y:.3f}" for x, y in points.tolist())
                put(f'<path d="M{told}{"Z" if stroke.closed else ""}" data-height="{stroke.elevation:.3f}"/>\n')
            put("</g>\n")
        put("</g>\n</svg>\n")


def _bounds(drawing: Drawing) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([stroke.points for stroke in drawing.strokes])
    return points.min(axis=0), points.max(axis=0)

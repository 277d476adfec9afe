# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's letters: a font file cut down to those that it needs, as TrueType, for the PDF to carry and the maps to
be lettered with. Blender's own fonts hold the letters of nearly every language, as WOFF2."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import reportlab
from fontTools import subset
from fontTools.pens.cu2quPen import Cu2QuPen
from fontTools.pens.ttGlyphPen import TTGlyphPen
from fontTools.ttLib import TTFont, TTLibError, newTable
from PIL import ImageFont

from ..base.errors import WorkspaceError
from ..base.language import Text

LATIN = "".join(map(chr, [*range(0x20, 0x7F), *range(0xA0, 0x100)])).replace("\xad", "") + "–—‘’“”…−×"
LATIN_FONT = Path(reportlab.__file__).parent / "fonts" / "Vera.ttf"
_CURVES = 1 / 1000  # of the letters' height that a quadratic curve may leave a cubic one
_KEPT = {"cmap", "glyf", "loca", "head", "hhea", "hmtx", "maxp", "name", "OS/2", "post", "CFF ", "CFF2", "GlyphOrder"}


@dataclass(frozen=True)
class Letters:
    """A TrueType font as the content of its file, and which of the letters wanted it `lacks`."""

    content: bytes
    lacks: str

    def sized(self, pixels: int) -> ImageFont.FreeTypeFont:
        return ImageFont.truetype(io.BytesIO(self.content), pixels)


def letters_of(wanted: set[str], file: Path | None) -> Letters:
    """The letters wanted, from a TrueType, OpenType or WOFF2 `file`, or else from one of Latin letters. Raises
    WorkspaceError for a file that is no font."""
    path = file or LATIN_FONT
    try:
        with TTFont(path, lazy=True, fontNumber=0) as font:
            known = font.getBestCmap()
            lacks = "".join(sorted(letter for letter in wanted - set("\t\n\r") if ord(letter) not in known))
            options = subset.Options(hinting=False, layout_features=[], notdef_outline=True, desubroutinize=True)
            options.drop_tables += [tag for tag in font.reader.tables if tag not in _KEPT]
            cutter = subset.Subsetter(options)
            cutter.populate(unicodes=[ord(letter) for letter in wanted])
            cutter.subset(font)
            if "glyf" not in font:
                _as_true_type(font)
            font.flavor = None
            content = io.BytesIO()
            font.save(content)
    except (OSError, TTLibError) as error:
        raise WorkspaceError(Text("{} is no font that can be read ({}).", path, Text(str(error))), path=path,
                             remedy="Choose a TrueType, OpenType or WOFF2 file.") from error
    return Letters(content.getvalue(), lacks)


def _as_true_type(font: TTFont) -> None:
    """PostScript outlines as quadratic ones, which PDF libraries embed."""
    glyphs, order = font.getGlyphSet(), font.getGlyphOrder()
    drawn = {}
    for name in order:
        pen = TTGlyphPen(None)
        glyphs[name].draw(Cu2QuPen(pen, _CURVES * font["head"].unitsPerEm, reverse_direction=True))
        drawn[name] = pen.glyph()
    font["loca"], font["glyf"] = newTable("loca"), newTable("glyf")
    font["glyf"].glyphOrder, font["glyf"].glyphs = order, drawn
    for tag in ("CFF ", "CFF2"):
        if tag in font:
            del font[tag]
    largest = font["maxp"]
    largest.tableVersion, largest.numGlyphs = 0x00010000, len(order)
    for field in ("TwilightPoints", "Storage", "FunctionDefs", "InstructionDefs", "StackElements",
                  "SizeOfInstructions", "ComponentElements"):
        setattr(largest, f"max{field}", 0)
    largest.maxZones = 1
    font["post"].formatType = 3.0
    font.sfntVersion = "\x00\x01\x00\x00"

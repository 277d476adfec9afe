# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's sections as one HTML page with everything in it, and as PDF."""

from __future__ import annotations

import base64
import html
import io
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import (
    CondPageBreak,
    Flowable,
    HRFlowable,
    KeepTogether,
    Paragraph,
    SimpleDocTemplate,
    Spacer,
    TableStyle,
)
from reportlab.platypus import Image as Placed
from reportlab.platypus import Table as Grid

from ..base.files import atomic_write
from ..base.language import Language
from .document import Picture, Section, Table
from .fonts import Letters

_STYLE = """
body { font: 16px/1.5 Report, system-ui, sans-serif; max-width: 56rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 0; overflow-wrap: anywhere } h1 + p { color: #666; margin-top: .3rem }
h2 { margin: 2.5rem 0 0; border-bottom: 2px solid #444 } h2 + p { font-size: 1.1rem }
h3 { font-size: 1rem; margin: 1.8rem 0 .3rem; overflow-wrap: anywhere }
table { border-collapse: collapse; width: 100% }
td, th { padding: .2rem .6rem .2rem 0; vertical-align: top; text-align: left; border-bottom: 1px solid #e4e4e4 }
th { font-weight: 600; color: #666; font-size: .85rem }
.rows td { overflow-wrap: anywhere } .rows td:first-child { color: #666; width: 40% }
.wide { overflow-x: auto } .figures td, .figures th { text-align: right; white-space: nowrap }
.figures td:first-child, .figures th:first-child { text-align: left }
.words td { overflow-wrap: anywhere; font-size: .85rem } .words td:first-child { min-width: 7rem }
tfoot td { font-weight: 600; border-top: 2px solid #444 }
figure { margin: 1.5rem 0 } img { max-width: 100%; border: 1px solid #ddd } figcaption { color: #666 }
@media (max-width: 30rem) { body { margin: 1rem auto } .figures { font-size: .85rem } }
@media print { body { max-width: none } h2, h3 { break-after: avoid } figure, tr { break-inside: avoid } }
"""
_WIDTH = A4[0] - 40 * mm - 12  # of the text; reportlab keeps 6 points at either side of it
_WIDE, _NARROW = 140 * mm, 80 * mm  # of pictures: two maps a page
_LEAST_LEFT = 70 * mm  # of a page for a section to begin on it
_KEPT = 16  # rows of a table that is not parted between pages
_LONG_WORD = 60  # letters: a digest, in small ones
_FONT = "Report"
_LIGHT, _RULED = colors.HexColor("#e4e4e4"), colors.HexColor("#444444")
_JPEG = 90  # quality: maps are photos, mostly


def write_html(
    path: Path, title: str, subtitle: str, sections: Sequence[Section], language: Language, letters: Letters
) -> None:
    """Write the page, with its pictures and the letters that a computer may lack in it (atomically). Raises
    WorkspaceError."""

    def say(text: str) -> str:
        return html.escape(language.said(text))

    head = say(title)
    parts = [f'<!DOCTYPE html><html lang="{language.tag}"><meta charset="utf-8">'
             '<meta name="viewport" content="width=device-width, initial-scale=1">'
             f"<title>{head}</title><style>{_face(letters)}{_STYLE}</style><h1>{head}</h1><p>{say(subtitle)}</p>"]
    for section in sections:
        parts.append(f"<h2>{say(section.title)}</h2><p>{html.escape(language.joined(section.sentences))}</p>")
        parts.append('<table class="rows">')
        parts += [f"<tr><td>{say(label)}</td><td>{say(value)}</td></tr>" for label, value in section.rows]
        parts.append("</table>")
        for table in section.tables:
            kind = "words" if table.words else "figures"
            parts.append(f'<h3>{say(table.title)}</h3><div class="wide"><table class="{kind}"><thead>'
                         f"{_row(table.head, 'th', say)}</thead><tbody>")
            parts += [_row(row, "td", say) for row in table.rows]
            parts.append("</tbody>" + (f"<tfoot>{_row(table.total, 'td', say)}</tfoot>" if table.total else ""))
            parts.append("</table></div>")
        for picture in section.pictures:
            data = base64.b64encode(_jpeg(picture.image)).decode("ascii")
            parts.append(f'<figure><img alt="{say(picture.caption)}" src="data:image/jpeg;base64,{data}">'
                         f"<figcaption>{say(picture.caption)}</figcaption></figure>")
    with atomic_write(path) as file:
        file.write("\n".join([*parts, "</html>"]).encode("utf-8"))


def _face(letters: Letters) -> str:
    data = base64.b64encode(letters.content).decode("ascii")
    return f"@font-face {{ font-family: {_FONT}; src: url(data:font/ttf;base64,{data}) }}\n"


def _row(cells: Sequence[str], tag: str, say: Any) -> str:
    return "<tr>" + "".join(f"<{tag}>{say(cell)}</{tag}>" for cell in cells) + "</tr>"


class _Pages:
    """Sections as what reportlab lays out."""

    def __init__(self, language: Language) -> None:
        self._language = language
        ink = {"textColor": colors.HexColor("#222222"), "fontName": _FONT}
        self._styles = {
            "title": ParagraphStyle("title", fontSize=22, leading=27, spaceAfter=2, **ink),
            "subtitle": ParagraphStyle("subtitle", fontSize=9, leading=12, fontName=_FONT, textColor=colors.grey),
            "heading": ParagraphStyle("heading", fontSize=15, leading=19, spaceBefore=16, spaceAfter=3, **ink),
            "sentence": ParagraphStyle("sentence", fontSize=11, leading=15, spaceAfter=5, **ink),
            "table": ParagraphStyle("table", fontSize=9, leading=12, spaceBefore=9, spaceAfter=2, keepWithNext=1,
                                    **ink),
            "cell": ParagraphStyle("cell", fontSize=8, leading=10.5, **ink),
            "figure": ParagraphStyle("figure", fontSize=8, leading=10.5, alignment=2, **ink),
            "small": ParagraphStyle("small", fontSize=6.5, leading=8.5, **ink),
            "label": ParagraphStyle("label", fontSize=8, leading=10.5, fontName=_FONT, textColor=colors.grey),
        }

    def text(self, text: str, style: str) -> Paragraph:
        said = self._language.said(text)
        chosen = self._styles[style]
        if any(unicodedata.east_asian_width(letter) in "WF" for letter in said):  # no spaces to break lines at
            chosen = chosen.clone(style, wordWrap="CJK")
        return Paragraph(html.escape(said), chosen)

    def section(self, section: Section) -> list[Flowable]:
        head: list[Flowable] = [self.text(section.title, "heading"),
                                HRFlowable(width="100%", thickness=0.75, color=_RULED, spaceAfter=5),
                                self.text(self._language.joined(section.sentences), "sentence")]
        rows = [[self.text(label, "label"), self.text(value, "small" if _is_long_word(value) else "cell")]
                for label, value in section.rows]
        story: list[Flowable] = [CondPageBreak(_LEAST_LEFT), *head, *([_grid(rows, (0.4, 0.6))] if rows else [])]
        for table in section.tables:
            story += self.table(table)
        narrow = [picture for picture in section.pictures if not picture.wide]
        for picture in section.pictures:
            if picture.wide:
                story.append(KeepTogether([Spacer(0, 4 * mm), *self.picture(picture, _WIDE)]))
        for first in range(0, len(narrow), 2):
            pair = [self.picture(picture, _NARROW) for picture in narrow[first : first + 2]]
            story.append(Grid([[*pair, *[[]] * (2 - len(pair))]], colWidths=(_WIDTH / 2,) * 2, style=TableStyle(
                [("VALIGN", (0, 0), (-1, -1), "TOP"), ("LEFTPADDING", (0, 0), (-1, -1), 0)])))
        return story

    def table(self, table: Table) -> list[Flowable]:
        body = "small" if table.words else "figure"
        styles = ["cell", *[body] * (len(table.head) - 1)]
        first = ["label", *["label" if table.words else "figure"] * (len(table.head) - 1)]
        rows = [[self.text(cell, style) for cell, style in zip(table.head, first, strict=True)]]
        rows += [[self.text(cell, style) for cell, style in zip(row, styles, strict=True)]
                 for row in (*table.rows, *([table.total] if table.total else []))]
        left = 0.3
        widths = (left, *[(1 - left) / (len(table.head) - 1)] * (len(table.head) - 1))
        grid = _grid(rows, widths, head=True, total=table.total is not None)
        title = self.text(table.title, "table")
        return [KeepTogether([title, grid])] if len(rows) <= _KEPT else [title, grid]

    def picture(self, picture: Picture, width: float) -> list[Flowable]:
        height = width * picture.image.height / picture.image.width
        placed = Placed(io.BytesIO(_jpeg(picture.image)), width, height, hAlign="LEFT")
        return [placed, Spacer(0, mm), self.text(picture.caption, "label")]


def _is_long_word(text: str) -> bool:
    return len(text) > _LONG_WORD and " " not in text


def _grid(
    rows: list[list[Paragraph]], widths: Sequence[float], *, head: bool = False, total: bool = False
) -> Grid:
    style = [("LINEBELOW", (0, 0), (-1, -1), 0.25, _LIGHT), ("VALIGN", (0, 0), (-1, -1), "TOP"),
             ("TOPPADDING", (0, 0), (-1, -1), 1), ("BOTTOMPADDING", (0, 0), (-1, -1), 2),
             ("LEFTPADDING", (0, 0), (-1, -1), 0)]
    if head:
        style.append(("LINEBELOW", (0, 0), (-1, 0), 0.75, _RULED))
    if total:
        style.append(("LINEABOVE", (0, -1), (-1, -1), 0.75, _RULED))
    return Grid(rows, colWidths=[width * _WIDTH for width in widths], repeatRows=int(head), style=TableStyle(style))


def write_pdf(
    path: Path, title: str, subtitle: str, sections: Sequence[Section], language: Language, letters: Letters
) -> None:
    """Write the same as PDF on A4 (atomically), with its letters in it. Raises WorkspaceError."""
    pdfmetrics.registerFont(TTFont(_FONT, io.BytesIO(letters.content)))
    pages = _Pages(language)
    story: list[Flowable] = [pages.text(title, "title"), pages.text(subtitle, "subtitle")]
    for section in sections:
        story += pages.section(section)
    head = language.said(title)

    def foot(canvas: Any, document: Any) -> None:
        canvas.setFont(_FONT, 7)
        canvas.setFillColor(colors.grey)
        canvas.drawString(20 * mm, 10 * mm, head)
        canvas.drawRightString(A4[0] - 20 * mm, 10 * mm, str(document.page))

    content = io.BytesIO()
    SimpleDocTemplate(
        content, pagesize=A4, leftMargin=20 * mm, rightMargin=20 * mm, topMargin=18 * mm, bottomMargin=18 * mm,
        title=head, author="CU-Recon", lang=language.tag, initialFontName=_FONT,
    ).build(story, onFirstPage=foot, onLaterPages=foot)
    with atomic_write(path) as file:
        file.write(content.getvalue())


def _jpeg(picture: Image.Image) -> bytes:
    data = io.BytesIO()
    picture.save(data, "JPEG", quality=_JPEG, subsampling=0)
    return data.getvalue()

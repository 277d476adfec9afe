# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's sections as one HTML page with everything in it, and as PDF."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import getSampleStyleSheet
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, KeepTogether, Paragraph, SimpleDocTemplate, Spacer, Table, TableStyle
from reportlab.platypus import Image as Placed

from ..base.files import atomic_write
from .sections import Section

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 56rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.8rem } h2 { margin: 2.5rem 0 0; border-bottom: 1px solid #ccc } h2 + p { font-size: 1.1rem }
table { border-collapse: collapse; width: 100% } td { padding: .2rem .6rem .2rem 0; vertical-align: top;
border-bottom: 1px solid #eee; overflow-wrap: anywhere } td:first-child { color: #666; width: 40% }
figure { margin: 1.5rem 0 } img { max-width: 100%; border: 1px solid #ddd } figcaption { color: #666 }
"""
_WIDTH = 170 * mm  # of the text on A4
_PICTURE = 120 * mm


def write_html(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write the page, pictures included (atomically). Raises WorkspaceError."""
    escape = html.escape
    parts = [f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
             f"<title>{escape(title)}</title><style>{_STYLE}</style><h1>{escape(title)}</h1><p>{escape(subtitle)}</p>"]
    for section in sections:
        parts.append(f"<h2>{escape(section.title)}</h2><p>{escape(section.sentence)}</p><table>")
        parts += [f"<tr><td>{escape(label)}</td><td>{escape(value)}</td></tr>" for label, value in section.rows]
        parts.append("</table>")
        for caption, picture in section.pictures:
            data = base64.b64encode(_png(picture)).decode("ascii")
            parts.append(f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
                         f"<figcaption>{escape(caption)}</figcaption></figure>")
    with atomic_write(path) as file:
        file.write("\n".join(parts).encode("utf-8"))


def write_pdf(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write the same as PDF on A4 (atomically). Raises WorkspaceError."""
    styles = getSampleStyleSheet()
    small = styles["BodyText"].clone("small", fontSize=8, leading=10, splitLongWords=1)
    story: list[Flowable] = [Paragraph(html.escape(title), styles["Title"]),
                             Paragraph(html.escape(subtitle), styles["BodyText"])]
    for section in sections:
        rows = [[Paragraph(html.escape(label), small), Paragraph(html.escape(value), small)]
                for label, value in section.rows]
        story.append(KeepTogether([
            Spacer(0, 5 * mm), Paragraph(html.escape(section.title), styles["Heading2"]),
            Paragraph(html.escape(section.sentence), styles["BodyText"]), Spacer(0, 2 * mm),
        ]))
        if rows:
            story.append(Table(rows, colWidths=(0.36 * _WIDTH, 0.64 * _WIDTH), style=TableStyle([
                ("LINEBELOW", (0, 0), (-1, -1), 0.25, colors.lightgrey), ("VALIGN", (0, 0), (-1, -1), "TOP"),
                ("TOPPADDING", (0, 0), (-1, -1), 1), ("BOTTOMPADDING", (0, 0), (-1, -1), 1),
            ])))
        for caption, picture in section.pictures:
            height = _PICTURE * picture.height / picture.width
            story.append(KeepTogether([Spacer(0, 4 * mm), Placed(io.BytesIO(_png(picture)), _PICTURE, height),
                                       Paragraph(html.escape(caption), small)]))
    content = io.BytesIO()
    SimpleDocTemplate(content, pagesize=A4, leftMargin=20 * mm, rightMargin=20 * mm, topMargin=18 * mm,
                      bottomMargin=18 * mm, title=title, author="CU-Recon").build(story)
    with atomic_write(path) as file:
        file.write(content.getvalue())


def _png(picture: Image.Image) -> bytes:
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()

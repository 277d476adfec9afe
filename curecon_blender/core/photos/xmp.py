# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""XMP packets, read so that a fault in one loses only what it touches.

Cameras and programs write packets that are no XML: prefixes that nobody declares, a bare &, an attribute twice, no end.
So values are picked up tag by tag, and an XML parser says only whether the packet is sound.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

MOST_BYTES = 1 << 20  # drones write some 4 kB
# Prefixes by what they stand for; a prefix that nobody declares stands for itself.
_SPACES = {
    "http://www.dji.com/drone-dji/1.0/": "drone-dji", "http://pix4d.com/camera/1.0": "Camera",
    "http://www.w3.org/1999/02/22-rdf-syntax-ns#": "rdf", "http://ns.adobe.com/exif/1.0/": "exif",
    "http://ns.adobe.com/xap/1.0/": "xmp", "http://ns.google.com/photos/1.0/panorama/": "GPano",
}
_BARE = {uri.rstrip("/"): prefix for uri, prefix in _SPACES.items()}
# Bounded, so that no text can make a search go over it again and again.
_NAME = re.compile(r"([A-Za-z_][\w.-]{0,63}):([A-Za-z_][\w.-]{0,63})(?=[\s/>]|\Z)", re.ASCII)
_ATTRIBUTE = re.compile(
    r"""(?<![\w.:-])([A-Za-z_][\w.-]{0,63}):([A-Za-z_][\w.-]{0,63})\s{0,99}=\s{0,99}(?:"([^"<]{0,9999})"|'([^'<]{0,9999})')""",
    re.ASCII,
)
_TRANSPARENT = ("rdf:", "x:")
_DEEPEST = 32  # elements one in the other
_LONGEST_LIST = 1000  # characters
_NO_TEXT = "\x00 \t\r\n\ufeff"


@dataclass(frozen=True)
class Xmp:
    """`tags` are texts by "prefix:Name", a field of a structure by "prefix:Structure/Name", a list's items joined by
    commas. `fault` says in words what is wrong with the packet, "" for a sound one."""

    tags: dict[str, str] = field(default_factory=dict)
    fault: str = ""

    @property
    def drone(self) -> dict[str, str]:
        """What drones tell, by plain name: DJI's names, which others took up under their own prefixes, and Pix4D's."""
        told = ((key.partition(":"), value) for key, value in self.tags.items())
        return {name: value for (prefix, _, name), value in told if prefix.startswith("drone") or prefix == "Camera"}


def read(packet: bytes | str | None) -> Xmp:
    """What a packet says. Text that appears twice with different values is left out."""
    if not isinstance(packet, bytes | str) or not packet:
        return Xmp()
    if len(packet) > MOST_BYTES:
        return Xmp(fault=f"is larger than {MOST_BYTES >> 20} MiB")
    text = _decoded(packet)
    start, end = text.find("<x:xmpmeta"), text.rfind("</x:xmpmeta>")  # the packet's wrapper may be padded
    if start >= 0:
        text = text[start : end + len("</x:xmpmeta>")] if end > start else text[start:]
    text = text.strip(_NO_TEXT)
    if not text:
        return Xmp()
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # XMP has no use for them
        return Xmp(fault="declares a document type, as XMP never does")
    tags: dict[str, str] = {}
    contradicted = set()
    for key, value, of_list in _values(text):
        if of_list and key in tags:
            if len(tags[key]) < _LONGEST_LIST:
                tags[key] += f",{value}"
            continue
        if tags.setdefault(key, value) != value:
            contradicted.add(key)
        tags[key] = value
    if not (fault := _fault(text)):
        return Xmp(tags=tags)
    for key in contradicted:
        del tags[key]
    if contradicted:
        fault += f", and says two things of {', '.join(sorted(contradicted)[:5])}"
    return Xmp(tags=tags, fault=fault)


def _decoded(packet: bytes | str) -> str:
    if isinstance(packet, str):
        return packet
    wide = packet[:2] in (b"\xff\xfe", b"\xfe\xff") and len(packet) > 2
    return packet.decode("utf-16" if wide else "utf-8", "replace")


def _values(text: str) -> Iterator[tuple[str, str, bool]]:
    """Every attribute and every element's text, in order, by their keys, and whether it is one item of a list."""
    spaces: dict[str, str] = {}
    owners = [""]  # the keys of the elements that are open, of which RDF's own count as what they stand in
    in_note = False
    pieces = text.split("<")
    for piece, following in zip(pieces[1:], [*pieces[2:], ""], strict=False):
        in_note = (in_note or piece.startswith("!--")) and "-->" not in piece
        if piece.startswith("/") and not in_note:
            owners = owners[:-1] or [""]
            continue
        name = _NAME.match(piece)
        if name is None or in_note:
            continue
        attributes = list(_ATTRIBUTE.finditer(piece))
        for attribute in attributes:
            if attribute[1] == "xmlns":
                spaces[attribute[2]] = _BARE.get(_value(attribute).rstrip("/"), attribute[2])
        key, owner = _key(spaces, name), owners[-1]
        if not key.startswith(_TRANSPARENT):
            owner = f"{owner}/{name[2]}" if owner else key
        for attribute in attributes:
            own = _key(spaces, attribute)
            if not own.startswith(("xmlns:", "xml:", "rdf:")) and (value := _value(attribute)):
                yield (own if key.startswith(_TRANSPARENT) and not owner else f"{owner}/{attribute[2]}"), value, False
        head = piece.find(">", attributes[-1].end() if attributes else name.end())
        if head < 0 or piece[head - 1] == "/" or len(owners) == _DEEPEST:
            continue
        owners.append(owner)
        # A text that nothing follows may be cut short.
        if owner and following.startswith("/") and (value := html.unescape(piece[head + 1 :]).strip(_NO_TEXT)):
            yield owner, value, key == "rdf:li"


def _key(spaces: dict[str, str], match: re.Match[str]) -> str:
    return f"{spaces.get(match[1], match[1])}:{match[2]}"


def _value(attribute: re.Match[str]) -> str:
    return html.unescape(attribute[3] if attribute[3] is not None else attribute[4]).strip(_NO_TEXT)


def _fault(text: str) -> str:
    parser = expat.ParserCreate(namespace_separator=" ")
    try:
        parser.Parse(text.encode("utf-8", "replace"), True)
    except expat.ExpatError as error:
        return f"is no sound XML ({expat.ErrorString(error.code)} in line {error.lineno})"
    return ""

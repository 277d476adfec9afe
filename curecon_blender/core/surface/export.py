# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What an exported surface says of itself: its frame's place on Earth, licence and credit, in GLB, OBJ and PLY.

Blender's exporters write the geometry; these functions put in afterwards what they have no place for.
"""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..base.errors import WorkspaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, GeoPosition

GENERATOR = "CU-Recon"
_ABOVE = {ELLIPSOID: "above the WGS84 ellipsoid", SEA_LEVEL: "above sea level", UNKNOWN: "of unknown datum"}
_UNLIT = "KHR_materials_unlit"
_GLB, _JSON = 0x46546C67, 0x4E4F534A  # "glTF", "JSON"


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a surface's frame stands, and whose it is. `origin` is None where nobody knows it or it is to stay secret;
    `scale` is "metres" or "unknown"; `north` tells whether y is north. `shift` is what
    to add to come back to a given model's coordinates."""

    scale: str
    north: bool
    origin: GeoPosition | None = None
    shift: tuple[float, float, float] | None = None
    licence: str = ""
    credit: str = ""

    @property
    def copyright(self) -> str:
        """Credit and licence in one line; empty when neither is set."""
        return ", ".join(_one_line(text) for text in (self.credit, self.licence) if text.strip())

    def extras(self) -> dict[str, Any]:
        """As JSON for a GLB."""
        fields: dict[str, Any] = {"generator": GENERATOR, "scale": self.scale, "north": self.north}
        if self.origin is not None:
            fields["origin"] = {"crs": "WGS84", **asdict(self.origin)}
        if self.shift is not None:
            fields["shift"] = list(self.shift)
        return fields | {name: text for name in ("licence", "credit") if (text := _one_line(getattr(self, name)))}

    def lines(self) -> list[str]:
        """As comments for a file whose axes are the site frame's."""
        unit = "metres" if self.scale == "metres" else "of unknown scale"
        lines = [f"{GENERATOR}: Z up, {'x east, y north, ' if self.north else ''}{unit}"]
        if self.origin is not None:
            altitude = "unknown" if self.origin.altitude is None else (
                f"{self.origin.altitude:.4f} {_ABOVE[self.origin.altitude_datum]}")
            lines.append(f"origin WGS84 latitude {self.origin.latitude:.9f} longitude {self.origin.longitude:.9f} "
                         f"altitude {altitude}")
        if self.shift is not None:
            lines.append("add {:.4f} {:.4f} {:.4f} for the given model's coordinates".format(*self.shift))
        return lines + [f"{name}: {text}" for name in ("licence", "credit") if (text := _one_line(getattr(self, name)))]


def describe_glb(
    path: Path, provenance: Mapping[str, Provenance], *,
    marks: Mapping[str, Sequence[str]] | None = None, unlit: bool = False,
) -> None:
    """Put each node's provenance (by its name) into its extras, the first one into the asset's too, and say of
    each material whether it is that of the faces of each of `marks` (material names). With `unlit`, viewers show the
    photos' colours without lights of their own."""
    with open(path, "rb") as file:
        magic, version, _ = struct.unpack("<3I", file.read(12))
        length, kind = struct.unpack("<2I", file.read(8))
        if (magic, version, kind) != (_GLB, 2, _JSON):
            raise WorkspaceError(Text("{} is not a GLB file.", path), remedy="Export it again.", path=path)
        content = json.loads(file.read(length))
        first = next(iter(provenance.values()))
        # The asset speaks for the whole file, in axes as glTF has them.
        axes = "Y up: x east, y up, -z north" if first.north else "Y up"
        content["asset"] |= {"extras": {**first.extras(), "axes": axes}}
        if first.copyright:
            content["asset"]["copyright"] = first.copyright
        for node in content.get("nodes", ()):
            if node.get("name") in provenance:
                node["extras"] = {**node.get("extras", {}), **provenance[node["name"]].extras()}
        for material in content.get("materials", ()):
            of = {mark: material.get("name") in names for mark, names in (marks or {}).items()}
            material["extras"] = {**material.get("extras", {}), **of}
            if unlit:
                material.setdefault("extensions", {})[_UNLIT] = {}
        if unlit and content.get("materials"):
            content["extensionsUsed"] = sorted({*content.get("extensionsUsed", ()), _UNLIT})
        text = json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        rest = path.stat().st_size - 20 - length
        with atomic_write(path) as out:
            out.write(struct.pack("<5I", _GLB, 2, 20 + len(text) + rest, len(text), _JSON))
            out.write(text)
            shutil.copyfileobj(file, out, 1 << 20)


def comment_obj(path: Path, lines: Sequence[str]) -> None:
    """Put comments before everything else in an OBJ."""
    with open(path, "rb") as file, atomic_write(path) as out:
        out.write("".join(f"# {line}\n" for line in lines).encode())
        shutil.copyfileobj(file, out, 1 << 20)


def comment_ply(path: Path, lines: Sequence[str]) -> None:
    """Put comments behind the format line of a PLY."""
    with open(path, "rb") as file, atomic_write(path) as out:
        out.write(file.readline())
        out.write(file.readline())
        out.write("".join(f"comment {line}\n" for line in lines).encode())
        shutil.copyfileobj(file, out, 1 << 20)


def write_mtl(path: Path, pictures: Mapping[str, str]) -> None:
    """Rewrite an OBJ's materials as matte ones with `pictures` (file beside it, by the material's name in Blender).

    The exporter's own say who exported from which .blend, and know nothing of a picture inside of it.
    """
    by_name = {name.replace(" ", "_"): file for name, file in pictures.items()}
    names = [line.split(" ", 1)[1] for line in path.read_text(encoding="utf-8").splitlines()
             if line.startswith("newmtl ")]
    with atomic_write(path) as out:
        for name in names:
            lines = [f"newmtl {name}", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
            if (picture := by_name.get(name.replace(" ", "_"))) is not None:
                lines.append(f"map_Kd {picture}")
            out.write("\n".join([*lines, "", ""]).encode())


def _one_line(text: str) -> str:
    return " ".join(text.split())

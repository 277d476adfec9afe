# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report tells what the workspace holds, in its three forms, and says what it does not know."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import Run, curecon
from PIL import Image

from curecon_blender.core.adjust.record import PointResidual
from curecon_blender.core.base import language
from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.language import Text
from curecon_blender.core.base.records import Frame
from curecon_blender.core.cloud.edits import write_removed
from curecon_blender.core.cloud.ply import Cloud, point_count
from curecon_blender.core.report.document import Section, Table, length
from curecon_blender.core.report.figures import Residuals
from curecon_blender.core.report.fonts import LATIN, letters_of
from curecon_blender.core.report.measure import (
    GROUND,
    ROOFS,
    WALLS,
    Standing,
    kinds_of_surface,
    seen_well,
    sigma_shown,
    supported_scale,
    texel_size,
)
from curecon_blender.core.report.pages import write_html, write_pdf
from curecon_blender.core.report.provenance import site_name
from curecon_blender.core.report.tables import points_table
from curecon_blender.core.surface.mesh import Mesh, read_mesh

CHINESE = language.of_name("zh_HANS")
WORDS = ("Survey", "Clearness", "Accuracy", "Integrity", "Authenticity", "Provenance")


def test_the_report_tells_what_the_workspace_holds(
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "tulou"
    shutil.copytree(textured[0], workspace)
    lost = sorted(site_photos.glob("*.JPG"))[0].name
    done = curecon("report", workspace, "--by", "A. Surveyor <a@b>", "--name", "Eryi & \"Lou\"")
    assert done.code == 0, done.said
    files = done.summary["report"]
    told = json.loads(Path(files["json"]).read_text(encoding="utf-8"))
    part, provenance = told["parts"][0], told["provenance"]
    photos = {photo["name"]: photo for photo in provenance["photos"]}
    assert part["integrity"]["placed"] == part["integrity"]["photos"] == len(photos)
    content = (site_photos / lost).read_bytes()
    assert photos[lost]["sha256"] == hashlib.sha256(content).hexdigest() and photos[lost]["taken"]
    # The site is flown at 30 to 60 m with a lens of 1,200 pixels' focal length, here at half the size.
    assert 0.02 < part["clearness"]["pixel"]["median"] < 0.15
    assert part["clearness"]["texel"] > part["clearness"]["pixel"]["low"] / 2
    mesh = read_mesh(workspace / "mesh.ply")
    assert part["faces"] == len(mesh.faces)
    assert part["integrity"]["filled"] == pytest.approx(mesh.areas[mesh.filled].sum() / mesh.areas.sum(), abs=1e-6)
    textured = read_mesh(workspace / "textured" / "mesh.ply")
    assert np.array_equal(textured.filled, mesh.filled)
    assert part["authenticity"]["unseen"] == pytest.approx(
        textured.areas[textured.unseen].sum() / textured.areas.sum(), abs=1e-6)
    assert part["authenticity"]["weak"] == pytest.approx(mesh.areas[mesh.weak].sum() / mesh.areas.sum(), abs=1e-6)
    assert np.array_equal(textured.weak, mesh.weak) and not (mesh.weak & mesh.filled).any()
    assert 0.3 < part["integrity"]["seen_well"] <= 1
    assert part["correctness"]["metres"] and part["correctness"]["gps"]["count"] == len(photos)
    assert provenance["settings"]["quality"] and len(provenance["weights"]) == 64
    assert all(provenance["settings"].values()) and "views" not in provenance["settings"]  # what was not set
    survey, lens = part["survey"], part["correctness"]["lenses"][0]
    assert survey["cameras"][0]["photos"] == len(photos) and 20 < survey["above"] < 80
    assert survey["tied"]["observations"] > 2 * survey["tied"]["points"] > 0
    assert lens["found"]["values"][0] == pytest.approx(lens["found"]["known"][0], rel=0.02) and 0 < lens["rms"] < 2
    # Photos are in the texture, so it must be like them; a shuffled one would stay below 12 dB.
    assert 15 < part["authenticity"]["likeness"]["median"] < 40 and part["authenticity"]["compared"] > 5

    page = Path(files["html"]).read_text(encoding="utf-8")
    assert all(f"<h2>{word}</h2>" in page for word in WORDS)
    assert "A. Surveyor &lt;a@b&gt;" in page and "<a@b>" not in page  # text from outside stays text
    assert "<title>Accuracy report: Eryi &amp; &quot;Lou&quot;</title>" in page
    words = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)  # a picture's letters may spell anything
    assert page.count("<img ") == 8 and "http" not in words.replace("http-equiv", "")
    pdf = Path(files["pdf"]).read_bytes()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page\n") >= 2


def test_doubtful_heights_are_told_beside_the_scale_of_drawings(
    finished: tuple[Path, Run], tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    record = json.loads((workspace / "views.json").read_text(encoding="utf-8"))
    assert curecon("report", workspace).code == 0
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert "doubtful" not in told["sentences"]["Accuracy"]
    record["components"][0]["frame"]["doubt"] = "Heights are doubtful: the model is bent."
    (workspace / "views.json").write_text(json.dumps(record), encoding="utf-8")
    assert curecon("report", workspace).code == 0
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert told["sentences"]["Accuracy"].startswith("Heights are doubtful")
    assert "the model is bent" in (workspace / "report" / "report.html").read_text(encoding="utf-8")


def test_a_photo_that_is_gone_is_told_and_ends_no_report(finished: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    record = json.loads((workspace / "photos.json").read_text())
    record["photos"][0]["path"] = str(tmp_path / "gone.jpg")
    (workspace / "photos.json").write_text(json.dumps(record))
    done = curecon("report", workspace)
    assert done.code == 0, done.said
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert told["provenance"]["photos"][0]["sha256"] == ""
    assert told["sentences"]["Provenance"].count("1 of them")
    assert "no mesh yet" in told["sentences"]["Authenticity"] and told["parts"][0]["integrity"]["filled"] is None


def test_a_cloud_without_points_is_told(finished: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    cloud = workspace / "cloud.ply"
    write_removed(cloud, np.ones(point_count(cloud), bool))
    done = curecon("report", workspace)
    assert done.code == WorkspaceError.exit_code and "removed by hand" in done.summary["error"]


def test_a_folder_without_a_cloud_has_no_report(tmp_path: Path) -> None:
    done = curecon("report", tmp_path)
    assert done.code == WorkspaceError.exit_code
    assert "not a workspace" in done.summary["error"]


def flat_cloud(views: list[int]) -> Cloud:
    """Points a metre apart on the ground, seen by so many photos."""
    count = len(views)
    points = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)]).astype(np.float32)
    up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    return Cloud(points, np.full((count, 3), 99, np.uint8), up, np.ones(count, np.float32), np.array(views, np.uint8))


def test_what_many_points_show_counts_once() -> None:
    sparse, dense = flat_cloud([2] * 50), flat_cloud([5] * 50)
    crowded = Cloud(np.repeat(dense.points + np.float32([100, 0, 0]), 40, 0), np.repeat(dense.colours, 40, 0),
                    np.repeat(dense.normals, 40, 0), np.repeat(dense.confidence, 40), np.repeat(dense.views, 40))
    both = Cloud(*(np.concatenate([getattr(sparse, name), getattr(crowded, name)])
                   for name in ("points", "colours", "normals", "confidence", "views")))
    assert seen_well(both) == pytest.approx(0.5, abs=0.06)  # cells at the rim may hold some more


def test_walls_roofs_and_ground_are_told_apart() -> None:
    cloud = flat_cloud([3] * 90)
    cloud.points[30:60, 2] = 6
    cloud.normals[60:] = [1, 0, 0]
    kinds = kinds_of_surface(cloud)
    assert [int(kinds[name].sum()) for name in (WALLS, ROOFS, GROUND)] == [30, 30, 30]


def test_a_scale_needs_both_precise_points_and_fine_photos() -> None:
    assert supported_scale(0.005, 0.004) == 20
    assert supported_scale(0.012, 0.004) == 50
    assert supported_scale(0.005, 0.02) == 100
    assert supported_scale(1.0, 0.02) is None


def test_the_size_of_a_texel(tmp_path: Path) -> None:
    Image.new("RGB", (100, 200)).save(tmp_path / "page.png")
    uv = np.array([[[0, 0], [1, 0], [0, 1]]], np.float32)  # 100 by 200 pixels over 1 by 2 metres
    mesh = Mesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32), faces=np.array([[0, 1, 2]], np.int32),
        colours=np.zeros((3, 3), np.uint8), distance=np.zeros(3, np.float32), views=np.ones(3, np.uint8),
        filled=np.zeros(1, bool), uv=uv, page=np.zeros(1, np.int32), pages=("page.png",),
    )
    assert texel_size(mesh, tmp_path) == pytest.approx(0.01)


def test_lengths_are_said_as_people_say_them() -> None:
    assert [length(value, metres=True) for value in (0.0093, 0.35, 12)] == ["9.3 mm", "350 mm", "12.00 m"]
    assert length(0.5, metres=False) == "0.5 units"


def test_each_kind_of_points_has_a_table_of_its_own() -> None:
    off = tuple(PointResidual(name=name, off=(0.03, 0.04, up), marks=4, pixels=0.5)
                for name, up in (("P1", 0.1), ("P2", -0.1)))
    table = points_table(Text("Check points, which took no part"), Residuals(count=2, rms=(0.03, 0.04, 0.1), of=off))
    assert table is not None and [row[0] for row in table.rows] == ["P1", "P2"]
    assert table.total == ("RMS", "0.030", "0.040", "0.100", "0.050", "", "")
    assert points_table(Text("Control points, which hold the site"), None) is None


def test_check_points_overrule_what_the_adjustment_says_of_itself() -> None:
    def points(*ups: float) -> Residuals:
        of = tuple(PointResidual(name=str(up), off=(5.0, 0.0, up), marks=3, pixels=1.0) for up in ups)
        return Residuals(count=len(of), rms=(5.0, 0.0, 1.0), of=of)

    assert sigma_shown(None) == 0
    assert sigma_shown(points(0.2, -0.2, 0.2, -0.2)) == pytest.approx(0.23, abs=0.01)  # all are shifted by 5 m
    assert sigma_shown(points(0.2, -0.2)) == 5.0  # too few to tell


def test_a_site_that_was_scaled_since_is_told_as_it_stands() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[2, 3] = 2 * turn, 7
    standing = Standing(Frame(scale="metres", up="measured"), matrix)
    cloud = flat_cloud([3] * 4)
    cloud.sigmas[:] = [0.01, 0.02, 0.03]
    moved = standing.cloud(cloud)
    assert standing.scale == pytest.approx(2)
    assert np.allclose(moved.points[3], [0, 6, 7]) and np.allclose(moved.sigmas[0], [0.04, 0.02, 0.06])
    assert np.allclose(moved.normals, [0, 0, 1])


@pytest.mark.parametrize(("folders", "name"), [
    (["Eryi_Lou"], "Eryi Lou"), (["二宜楼", "DCIM", "100MEDIA"], "二宜楼"), (["villa", "photos"], "villa"),
    (["site_curecon"], "site"),
])
def test_a_site_is_called_after_its_photos_folder(folders: list[str], name: str) -> None:
    folder = Path("/").joinpath("home", *folders)
    assert site_name([folder / "a.jpg", folder / "b.jpg"], Path("/home/workspace")) == name


def test_names_are_safe_in_both_and_stay_as_they_are_in_another_language(tmp_path: Path) -> None:
    name = "<b>Ground</b> & \"walls\" {0}"
    scale = Text("1:{} ({})", "50", Text("walls"))
    section = Section(
        title=Text("Clearness"), sentences=(Text("Drawings are supported up to {}.", name),),
        rows=((Text("Site"), name), (Text("Heights"), Text("Drawings are supported up to {}.", scale))),
        tables=(Table(title=Text("Photos"), head=(Text("Photo"), "SHA-256"), rows=((name, "ground"),)),),
    )
    letters = letters_of(set(LATIN), None)
    assert not letters.lacks
    write_html(tmp_path / "a.html", name, "", [section], CHINESE, letters)
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<b>" not in page and page.count("&lt;b&gt;Ground&lt;/b&gt; &amp; &quot;walls&quot; {0}") == 5
    assert 'lang="zh-HANS"' in page and "<h2>清晰性</h2>" in page and "1:50 (墙面)" in page and ">ground<" in page
    write_pdf(tmp_path / "a.pdf", name, "", [section], CHINESE, letters)
    assert b"/FontFile2" in (tmp_path / "a.pdf").read_bytes()  # the letters go with it


def test_blenders_font_gives_its_chinese_letters_to_the_pdf(tmp_path: Path) -> None:
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        pytest.skip("bpy, which has the font, is not installed in this Python")
    (font,) = Path(spec.origin).parent.glob("*/datafiles/fonts/Noto Sans CJK Regular.woff2")
    letters = letters_of(set("二宜楼 A\U0001f600"), font)
    assert letters.lacks == "\U0001f600"  # no such in it, and told
    box = letters.sized(40)
    assert box.getmask("二").getbbox() != box.getmask("宜").getbbox()
    assert len(letters.content) < 20_000  # cut down to these
    section = Section(title=Text("Accuracy"), sentences=())
    write_pdf(tmp_path / "a.pdf", "二宜楼", "", [section], CHINESE, letters)
    assert b"/FontFile2" in (tmp_path / "a.pdf").read_bytes()
    (tmp_path / "no.ttf").write_bytes(b"no font")
    with pytest.raises(WorkspaceError, match="no font"):
        letters_of({"a"}, tmp_path / "no.ttf")

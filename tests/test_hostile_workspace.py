# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A workspace that a stranger made to do harm is refused with one error that names the file and the remedy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hostile import change, refused

from curecon_blender.core.adjust.control import read_control
from curecon_blender.core.base import messages
from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.photos import capture
from curecon_blender.core.photos.record import read_photos
from curecon_blender.core.run.workspace import Workspace
from curecon_blender.core.site import adjustment as alignment
from curecon_blender.core.sparse.record import read_frame
from curecon_blender.core.views import record as components
from tests.fuzz import workspace_targets

OUTSIDE = ("../x", "/etc/x", "C:\\x", "C:x", "\\\\host\\share\\x", "a/../../x", "..", "", "nul", "a\nb", "a\0b")


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    workspace_targets.make_workspace(tmp_path)
    return tmp_path


RECORDS: dict[str, Callable[[Path], object]] = {
    "views.json": components.read,
    "sparse/0/frame.json": lambda folder: read_frame(folder / "sparse" / "0"),
    "sparse/0/adjustment.json": lambda folder: alignment.read(folder / "sparse" / "0"),
    "photos.json": read_photos,
    "control.json": read_control,
    "workspace.json": lambda folder: Workspace(folder).__enter__(),
}


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("text", [
    "", "null", "[]", '"x"', "1", "{}", "[" * 200_000, '{"a":' * 200_000, '{"format": NaN}', '{"format": 1e999}',
    '{"format": ' + "9" * 10_000 + "}", '{"format": "1"}', '{"format": true}', '{"format": 1, "components": [null]}',
    "\ufeff{}", "\x00",
], ids=lambda text: text[:12])
def test_json_of_any_kind(workspace: Path, name: str, text: str) -> None:
    if name == "workspace.json" and "components" in text:
        return  # of which it asks for no more
    (workspace / name).write_text(text)
    refused(WorkspaceError, workspace / name, lambda: RECORDS[name](workspace))


def test_json_beyond_its_bound_is_not_read(workspace: Path) -> None:
    path = workspace / "views.json"
    with open(path, "r+b") as file:
        file.truncate(1 << 40)  # a hole: it takes no room on the disk
    refused(WorkspaceError, path, lambda: components.read(workspace))


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("keys", [("sparse",), ("cloud",), ("views", 0, "image"), ("views", 0, "name")], ids=str)
def test_no_path_of_a_workspace_leads_out_of_it(workspace: Path, keys: tuple[Any, ...], name: str) -> None:
    change(workspace / "views.json", "components", 0, *keys, value=name)
    refused(WorkspaceError, workspace / "views.json", lambda: components.read(workspace))


@pytest.mark.parametrize("name", [*OUTSIDE, "a/b"])
def test_no_photo_is_named_with_a_path(workspace: Path, name: str) -> None:
    change(workspace / "photos.json", "photos", 0, "name", value=name)
    refused(WorkspaceError, workspace / "photos.json", lambda: RECORDS["photos.json"](workspace))


@pytest.mark.parametrize(("keys", "value"), [
    (("K",), [[0, 0, 0], [0, 0, 0], [0, 0, 1]]), (("K",), [[6, 0, 2]]), (("K",), [[1e200, 0, 0], [0, 1, 0], [0, 0, 1]]),
    (("cam_from_world",), [[0, 0, 0, 0]] * 3), (("cam_from_world",), [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
    (("near",), 0), (("near",), 10), (("far",), -1), (("width",), 0), (("width",), 1 << 70), (("width",), 2.5),
    (("sources",), [["nobody.jpg", 1]]), (("overlaps",), ["nobody.jpg"]), (("sources", 0), [1]), (("extra",), 1),
    (("name",), "2.jpg"),
], ids=str)
def test_a_camera_that_is_none(workspace: Path, keys: tuple[Any, ...], value: Any) -> None:
    change(workspace / "views.json", "components", 0, "views", 0, *keys, value=value)
    refused(WorkspaceError, workspace / "views.json", lambda: components.read(workspace))


@pytest.mark.parametrize(("key", "value"), [
    ("scale", 0), ("scale", -1), ("scale", 1e300), ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]), ("rotation", []),
    ("measured", [{"kind": "other"}]), ("measured", 1),
])
def test_an_adjustment_that_is_no_similarity(workspace: Path, key: str, value: Any) -> None:
    path = workspace / "sparse" / "0" / "adjustment.json"
    change(path, key, value=value)
    refused(WorkspaceError, path, lambda: alignment.read(path.parent))


@pytest.mark.parametrize("place", [{"latitude": 91, "longitude": 0, "altitude": 0}, {"latitude": "1"}, [], 5])
def test_a_place_that_is_not_on_earth(workspace: Path, place: Any) -> None:
    path = workspace / "sparse" / "0" / "frame.json"
    change(path, "origin", value=place)
    refused(WorkspaceError, path, lambda: read_frame(path.parent))


@pytest.mark.parametrize("when", ["0001-01-01T00:00:00", "9999-12-31T23:59:59-23:59", "now", 5])
def test_a_time_that_no_photo_has(workspace: Path, when: Any) -> None:
    change(workspace / "photos.json", "photos", 0, "time", value=when)
    refused(WorkspaceError, workspace / "photos.json", lambda: capture.read_times(workspace))


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"key": 1}', '{"key": "k", "seconds": "x", "peak_gib": 1}'],
                         ids=lambda text: text[:12])
def test_a_done_marker_that_says_nothing_means_that_the_stage_runs_again(workspace: Path, text: str) -> None:
    (workspace / "stages" / "depth.json").write_text(text)
    with Workspace(workspace) as opened:
        assert opened.record("depth") is None


@pytest.mark.parametrize("line", [
    "", "{}", "[" * 100_000, '{"type": []}', '{"type": "progress", "stage": 1}', '{"type": "log", "text": null}',
    '{"type": "progress", "stage": "depth", "done": 1, "total": 2, "overall": "x", "eta": null}',
], ids=lambda line: line[:20])
def test_a_line_that_is_no_message(line: str) -> None:
    with pytest.raises(ValueError, match="not a worker message"):
        messages.decode(line)


def test_speeds_that_are_none_are_learned_again(tmp_path: Path) -> None:
    from curecon_blender.core.run import cost

    path = tmp_path / "speeds.json"
    for text in ('{"sparse": ["x"]}', '{"sparse": [NaN]}', '{"sparse": [-1]}', '{"sparse": 1}', "[" * 100_000):
        path.write_text(text)
        assert set(cost.slowness_here("cpu", path)) >= {"sparse"}


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
@pytest.mark.parametrize("name", ["depth", "sparse/0", "views.json", ".cloud.ply.partial", "sparse/features.db"])
def test_nothing_is_written_through_a_link(
    workspace: Path, tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    outside = tmp_path_factory.mktemp("outside") / "mine"
    if name != "depth":
        outside.write_text("mine")
    link = workspace / name
    if link.is_dir():
        for file in link.iterdir():
            file.unlink()
        link.rmdir()
    link.unlink(missing_ok=True)
    link.symlink_to(outside)
    refused(WorkspaceError, link, lambda: Workspace(workspace).__enter__())
    assert name == "depth" or outside.read_text() == "mine"


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_photos_may_be_links(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("card")
    (workspace / "DJI_0001.JPG").symlink_to(outside / "DJI_0001.JPG")
    (workspace / "DCIM").symlink_to(outside)
    with Workspace(workspace):
        pass

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on inside Blender 4.5 LTS and, where there is one, 5.2 LTS; and the zip that installs it."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Run
from PIL import Image

sys.path.append(str(ROOT / "scripts"))

import build_extension
import wheel_locks
import windows_paths

SCRIPTS = ROOT / "tests" / "blender"


def _blender52() -> Path:
    named = os.environ.get("CURECON_BLENDER52_PYTHON")
    return Path(named) if named else ROOT / ".venv-blender52" / "bin" / "python"


@pytest.fixture(params=["4.5", "5.2"])
def blender(request: pytest.FixtureRequest) -> Path:
    """A Python with bpy of that version."""
    if request.param == "4.5":
        if importlib.util.find_spec("bpy") is None:
            pytest.skip("bpy is not installed in this Python")
        return Path(sys.executable)
    if not _blender52().is_file():
        pytest.skip("no Python with bpy 5.2: set CURECON_BLENDER52_PYTHON, or make .venv-blender52")
    return _blender52()


def run_script(python: Path, script: str, *arguments: Path, resources: Path) -> None:
    """Run one of tests/blender and assert that it came to its end, and Blender to its own without a crash."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(SCRIPTS)]), "BLENDER_USER_RESOURCES": str(resources),
        "PYTHONUTF8": "1",
    }
    ran = subprocess.run(
        [python, SCRIPTS / script, *arguments], env=environment, capture_output=True, text=True, timeout=300,
    )
    assert ran.returncode == 0 and "CHECKED" in ran.stdout, f"{ran.stdout}\n{ran.stderr}"


def run_alone(python: Path, script: str, folder: Path) -> None:
    """Run one of tests/blender that works in a folder of its own, with Blender's settings of its own."""
    work = folder / "work"
    work.mkdir()
    run_script(python, script, work, resources=folder / "user")


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built and validated extension."""
    if importlib.util.find_spec("bpy") is None and "BLENDER_EXT" not in os.environ:
        pytest.skip("Blender's packager comes with bpy, which is not installed in this Python")
    output = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, ROOT / "scripts" / "build_extension.py", "--output", output], check=True)
    (found,) = output.glob("curecon_blender-*.zip")
    return found


def test_every_class_is_registered_twice_over(blender: Path, tmp_path: Path) -> None:
    run_script(blender, "check_registration.py", resources=tmp_path)


def test_an_imported_workspace_is_right_and_survives_saving(blender: Path, tmp_path: Path) -> None:
    run_alone(blender, "check_import.py", tmp_path)


def test_a_stopped_import_leaves_nothing_and_an_undo_in_its_midst_ends_well(blender: Path, tmp_path: Path) -> None:
    run_alone(blender, "check_steps.py", tmp_path)


def test_the_menus_offer_it_and_what_they_export_is_in_metres(blender: Path, tmp_path: Path) -> None:
    run_alone(blender, "check_menus.py", tmp_path)


def test_bad_input_is_an_error_in_words(blender: Path, tmp_path: Path) -> None:
    run_alone(blender, "check_errors.py", tmp_path)


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="this Python has no torch for the worker")
def test_the_photo_check_and_presets(blender: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    photos = ROOT / "samples" / "tulou" / "photos"
    run_script(blender, "check_photo_check.py", photos, work, Path(sys.executable), resources=tmp_path / "user")


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="this Python has no torch for the worker")
def test_one_press_makes_a_model_and_a_picture(
    blender: Path, finished: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    shutil.copytree(finished[0], tmp_path / "workspace")
    run_script(blender, "check_one_press.py", site_photos, tmp_path / "workspace", Path(sys.executable),
               resources=tmp_path / "user")


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="this Python has no torch for the worker")
def test_the_installation_is_checked(tmp_path: Path) -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed in this Python")
    venv.create(tmp_path / "bare", with_pip=False)
    bare = tmp_path / "bare" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    run_script(Path(sys.executable), "check_self_check.py", Path(sys.executable), bare, resources=tmp_path / "user")


@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="bpy is not installed in this Python")
def test_the_demo_ends_with_a_scene_and_a_picture_of_it(finished: tuple[Path, Run], tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, ROOT / "scripts" / "demo_scene.py", finished[0], tmp_path / "site.blend",
         tmp_path / "site.png"], check=True, timeout=300,
        env=os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "user")},
    )
    assert (tmp_path / "site.blend").stat().st_size > 100_000
    picture = np.asarray(Image.open(tmp_path / "site.png").convert("L"))
    sky = np.median(picture[:20])
    assert (np.abs(picture.astype(int) - sky) > 10).mean() > 0.1, "the site does not fill the picture"


def test_the_zip_installs_and_is_enabled(blender: Path, archive: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    run_script(blender, "check_install.py", archive, work, resources=tmp_path / "user")


def test_the_zip_holds_the_extension_and_nothing_else(archive: Path) -> None:
    names = zipfile.ZipFile(archive).namelist()
    tops = {name.partition("/")[0] for name in names}
    assert {"blender_manifest.toml", "__init__.py", "curecon_blender"} <= tops
    assert tops <= {"blender_manifest.toml", "__init__.py", "curecon_blender", "LICENSE", "wheels"}, tops
    locks = {name for name in names if name.startswith("wheels/") and not name.endswith("/")}
    assert locks == {f"wheels/{target.lock.name}" for target in wheel_locks.TARGETS}  # for Get Libraries
    assert "curecon_blender/core/run/pipeline.py" in names and "curecon_blender/scene/points.py" in names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]


def test_the_zip_holds_every_file_of_the_package(archive: Path) -> None:
    packed = {name for name in zipfile.ZipFile(archive).namelist() if name.startswith("curecon_blender/")}
    listed = subprocess.run(
        ["git", "ls-files", "curecon_blender"], cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()
    assert set(listed) <= packed, set(listed) - packed


@pytest.mark.parametrize("target", wheel_locks.TARGETS, ids=lambda target: target.lock.stem)
def test_a_lock_brings_all_that_the_worker_needs(target: wheel_locks.Target) -> None:
    assert target.lock.is_file()
    assert wheel_locks.check_lock(target) == []


def test_the_locks_pin_numpy_to_blenders_own() -> None:
    with_numpy = {target.python: target.blender()["numpy"] for target in wheel_locks.TARGETS}
    assert with_numpy == {"3.11": "1.26.4", "3.13": "2.3.4"}
    assert not [wheel for target in wheel_locks.TARGETS for wheel in target.wheels() if wheel.name == "numpy"]


@pytest.fixture
def small_lock(
    blender: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> tuple[wheel_locks.Target, Path]:
    """A lock of one small wheel for that Blender's Python, and the cache that has the wheel."""
    (tmp_path / "cache").mkdir()
    wheel = write_wheel(tmp_path / "cache" / "curecon_probe-1.0-py3-none-any.whl", {"curecon_probe.py": "VALUE = 7\n"})
    (tmp_path / "requirements.txt").write_text("numpy==1.26.4\ncurecon-probe==1.0\n", encoding="utf-8")
    monkeypatch.setattr(wheel_locks, "LOCKS", tmp_path)
    monkeypatch.setattr(wheel_locks, "REQUIREMENTS", tmp_path / "requirements.txt")
    monkeypatch.setattr(wheel_locks, "worker_imports", lambda: {"curecon_probe"})
    target = wheel_locks.Target("linux-x64", "3.11" if blender == Path(sys.executable) else "3.13")
    wheel_locks.write(target, [wheel_locks.read_wheel(wheel, target)])
    return target, tmp_path / "cache"


def test_a_repository_of_zips_with_wheels_installs_and_updates(
    blender: Path, small_lock: tuple[wheel_locks.Target, Path], archive: Path, tmp_path: Path,
) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("the small zip is for Linux")
    target, cache = small_lock
    repository = tmp_path / "repository"
    (built,) = build_extension.build_with_wheels(archive, [target], cache, repository)
    build_extension.build_repository(repository)
    (offered,) = json.loads((repository / "index.json").read_text(encoding="utf-8"))["data"]
    assert offered["archive_url"] == f"./{built.name}" and offered["platforms"] == ["linux-x64"]

    # The next release, of which nothing but the version is new.
    light, newer = tmp_path / "curecon_blender-9.0.0.zip", tmp_path / "newer"
    with zipfile.ZipFile(archive) as old, zipfile.ZipFile(light, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == build_extension.MANIFEST:
                data = re.sub(rb'(?m)^version = .*$', b'version = "9.0.0"', data)
            new.writestr(entry, data)
    build_extension.build_with_wheels(light, [target], cache, newer)
    build_extension.build_repository(newer)
    run_script(blender, "check_wheels.py", repository, newer, resources=tmp_path / "user")


def test_a_zip_with_another_wheel_than_the_locked_one_is_refused(
    small_lock: tuple[wheel_locks.Target, Path], archive: Path, tmp_path: Path,
) -> None:
    target, cache = small_lock
    (wheel,) = cache.iterdir()
    write_wheel(wheel, {"curecon_probe.py": "VALUE = 8\n"})
    with pytest.raises(SystemExit, match="not as locked"):
        build_extension.build_with_wheels(archive, [target], cache, tmp_path / "repository")


def test_a_wheel_is_packed_so_that_windows_can_unpack_it(tmp_path: Path) -> None:
    info = "curecon_probe-1.0.dist-info"
    deep = f"{info}/licenses/" + "third_party/" * 12 + "LICENSE.txt"
    files = {"curecon_probe.py": "", deep: "Do as you like."}
    wheel = write_wheel(tmp_path / "curecon_probe-1.0-py3-none-any.whl", files)
    assert windows_paths.too_long(wheel) == [deep]
    short = tmp_path / "short.whl"
    windows_paths.shorten(wheel, short)
    assert windows_paths.too_long(short) == [] and windows_paths.is_shortened(short)
    assert not windows_paths.is_shortened(wheel)
    with zipfile.ZipFile(short) as packed:
        gathered = packed.read(f"{info}/{windows_paths.GATHERED}").decode()
        assert deep in gathered and "Do as you like." in gathered
    code = write_wheel(tmp_path / "curecon_probe-2.0-py3-none-any.whl", {"curecon_probe/" * 12 + "code.py": ""})
    with pytest.raises(SystemExit, match="too long for Windows"):
        windows_paths.shorten(code, short)


def write_wheel(path: Path, files: dict[str, str]) -> Path:
    """A wheel with these files, its metadata and its record."""
    name, version, *_ = path.name.split("-")
    info = f"{name}-{version}.dist-info"
    files = files | {
        f"{info}/METADATA": f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\nLicense-Expression: MIT\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    with zipfile.ZipFile(path, "w") as archive:
        for entry, text in files.items():
            archive.writestr(entry, text)
        archive.writestr(f"{info}/RECORD", "".join(f"{entry},,\n" for entry in [*files, f"{info}/RECORD"]))
    return path


def test_core_imports_without_blender() -> None:
    program = "import sys, curecon_blender.core.run.pipeline, curecon_blender.job; sys.exit('bpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)

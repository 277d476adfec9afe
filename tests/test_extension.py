# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on inside Blender 4.5 LTS and, where there is one, 5.2 LTS; and the zip that installs it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
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
    work = tmp_path / "work"
    work.mkdir()
    run_script(blender, "check_import.py", work, resources=tmp_path / "user")


def test_bad_input_is_an_error_in_words(blender: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    run_script(blender, "check_errors.py", work, resources=tmp_path / "user")


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="this Python has no torch for the worker")
def test_the_photo_check_and_presets(blender: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    photos = ROOT / "samples" / "tulou" / "photos"
    run_script(blender, "check_photo_check.py", photos, work, Path(sys.executable), resources=tmp_path / "user")


def test_the_zip_installs_and_is_enabled(blender: Path, archive: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    run_script(blender, "check_install.py", archive, work, resources=tmp_path / "user")


def test_the_zip_holds_the_extension_and_nothing_else(archive: Path) -> None:
    names = zipfile.ZipFile(archive).namelist()
    tops = {name.partition("/")[0] for name in names}
    assert {"blender_manifest.toml", "__init__.py", "curecon_blender"} <= tops
    assert tops <= {"blender_manifest.toml", "__init__.py", "curecon_blender", "LICENSE"}, tops
    assert "curecon_blender/core/pipeline.py" in names and "curecon_blender/scene/points.py" in names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]


def test_the_zip_holds_every_file_of_the_package(archive: Path) -> None:
    packed = {name for name in zipfile.ZipFile(archive).namelist() if name.startswith("curecon_blender/")}
    listed = subprocess.run(
        ["git", "ls-files", "curecon_blender"], cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()
    assert set(listed) <= packed, set(listed) - packed


def test_core_imports_without_blender() -> None:
    program = "import sys, curecon_blender.core.pipeline, curecon_blender.job; sys.exit('bpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zips with Blender's own packager, and validate and check each.

    python scripts/build_extension.py                 the light zip, for those who name a Worker Python: dist/*.zip
    python scripts/build_extension.py --with-wheels   a self-contained zip for each platform and Python, with an index
                                                      that makes their folder an extension repository: dist/repository/

`scripts/wheel_locks.py fetch` brings the wheels first. `--platform linux-x64 --python 3.11` builds some of them only.
Needs the bpy wheel in this Python for its packager (or BLENDER_EXT naming a blender_ext.py); starts no Blender.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

import wheel_locks
import windows_paths
from wheel_locks import Target

ROOT = Path(__file__).resolve().parent.parent
MANIFEST = "blender_manifest.toml"
# The Blenders that have this Python: from the first version up to, but without, the second.
BLENDERS = {"3.11": ("4.5.0", "5.1.0"), "3.13": ("5.1.0", None)}


def packager() -> Path:
    """Blender's blender_ext.py, a plain script."""
    if "BLENDER_EXT" in os.environ:
        return Path(os.environ["BLENDER_EXT"])
    spec = importlib.util.find_spec("bpy")  # finds the wheel without loading it
    if spec is None or spec.origin is None:
        raise SystemExit("This Python has no bpy. Install it, or set BLENDER_EXT to Blender's blender_ext.py.")
    found = sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        raise SystemExit(f"{Path(spec.origin).parent} has no blender_ext.py. Set BLENDER_EXT to Blender's.")
    return found[-1]


def run_packager(*arguments: str | Path) -> None:
    subprocess.run([sys.executable, str(packager()), *map(str, arguments)], check=True)


def build_light(output: Path) -> Path:
    """Build the zip without wheels into the folder `output` and validate it; returns its path."""
    manifest = tomllib.loads((ROOT / MANIFEST).read_text(encoding="utf-8"))
    output.mkdir(parents=True, exist_ok=True)
    archive = output / f"{manifest['id']}-{manifest['version']}.zip"
    run_packager("build", "--source-dir", ROOT, "--output-filepath", archive)
    run_packager("validate", archive)
    return archive


def build_with_wheels(light: Path, targets: list[Target], cache: Path, output: Path) -> list[Path]:
    """Build one zip a target out of the light one and the cache's wheels. The targets share a Python: Blender's
    packager tells platforms apart by the wheels' tags, and each zip is then held against its own lock."""
    (python,) = {target.python for target in targets}
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output) as folder:
        source = Path(folder)
        with zipfile.ZipFile(light) as archive:
            archive.extractall(source)
        shutil.rmtree(source / "wheels")  # its locks tell the add-on that there are no libraries in the zip
        (source / "wheels").mkdir()
        for target in targets:
            wheel_locks.fetch(target, cache)
            for wheel in target.wheels():
                _put(cache / wheel.file, source / "wheels" / wheel.file, target)
        names = sorted(path.name for path in (source / "wheels").iterdir())
        manifest = source / MANIFEST
        manifest.write_text(with_wheels(manifest.read_text(encoding="utf-8"), targets, names), encoding="utf-8")
        named = f"{light.stem}-py{python.replace('.', '')}"
        run_packager("build", "--split-platforms", "--source-dir", source, "--output-filepath", output / f"{named}.zip")
    built = [output / f"{named}-{target.platform.replace('-', '_')}.zip" for target in targets]
    for target, archive in zip(targets, built, strict=True):
        run_packager("validate", archive)
        if wrong := check_archive(archive, target):
            raise SystemExit("\n".join([f"{archive.name}:", *wrong]))
    return built


def _put(wheel: Path, place: Path, target: Target) -> None:
    if target.platform == "windows-x64" and windows_paths.too_long(wheel):
        windows_paths.shorten(wheel, place)
    elif not place.exists():
        try:
            os.link(wheel, place)
        except OSError:  # the cache lies on another disk
            shutil.copyfile(wheel, place)


def with_wheels(manifest: str, targets: list[Target], names: list[str]) -> str:
    """The manifest's text, for these platforms and the Blenders of their Python, with the list of wheels."""
    first, end = BLENDERS[targets[0].python]
    lines = [f'blender_version_min = "{first}"', *([f'blender_version_max = "{end}"'] if end else [])]
    lines += [f"platforms = {[target.platform for target in targets]}".replace("'", '"')]
    lines += ["wheels = [", *(f'  "./wheels/{name}",' for name in names), "]"]
    text, count = re.subn(r"(?m)^blender_version_min = .*$", "\n".join(lines), manifest)
    if count != 1:
        raise SystemExit(f"{MANIFEST} must have one line blender_version_min.")
    return text


def check_archive(archive: Path, target: Target) -> list[str]:
    """What is wrong with a zip of the target, in words: its wheels against the lock, its manifest, its paths."""
    wrong = wheel_locks.check_lock(target)
    locked = {f"wheels/{wheel.file}": wheel for wheel in target.wheels()}
    with zipfile.ZipFile(archive) as packed:
        names = {name for name in packed.namelist() if name.startswith("wheels/")}
        manifest = tomllib.loads(packed.read(MANIFEST).decode())
        generated = manifest["build"]["generated"]
        if generated["platforms"] != [target.platform]:
            wrong.append(f"the manifest is for {generated['platforms']}")
        if (manifest["blender_version_min"], manifest.get("blender_version_max")) != BLENDERS[target.python]:
            wrong.append("the manifest names other Blenders than those with this Python")
        if not names == set(locked) == {name.removeprefix("./") for name in generated["wheels"]}:
            wrong.append(f"its wheels differ from the lock's: {sorted(names ^ set(locked))}")
        for name in names & set(locked):
            with packed.open(name) as file:
                whole = hashlib.file_digest(file, "sha256").hexdigest() == locked[name].sha256
            if target.platform == "windows-x64":
                with packed.open(name) as file:
                    wrong += [f"{name}: {path} is too long for Windows" for path in windows_paths.too_long(file)]
                    whole = whole or windows_paths.is_shortened(file)
            if not whole:
                wrong.append(f"{name} is not the file that the lock names")
    return wrong


def build_repository(folder: Path) -> None:
    """Write the index that makes a folder of zips an extension repository."""
    run_packager("server-generate", "--repo-dir", folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zips (default: dist)")
    parser.add_argument("--with-wheels", action="store_true", help="build the self-contained zips too")
    wheel_locks.add_target_arguments(parser)
    options = parser.parse_args()
    light = build_light(options.output)
    print(f"{light} {light.stat().st_size / 1e6:.1f} MB")
    if not options.with_wheels:
        return
    repository = options.output / "repository"
    targets = wheel_locks.chosen_targets(options)
    for python in options.python:
        same = [target for target in targets if target.python == python]
        for archive in build_with_wheels(light, same, options.cache, repository):
            print(f"{archive} {archive.stat().st_size / 1e6:.1f} MB")
    build_repository(repository)


if __name__ == "__main__":
    main()

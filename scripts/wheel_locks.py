# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's libraries as wheels: which ones, for each platform and Python that Blender has.

    python scripts/wheel_locks.py lock  [--cache FOLDER]     requirements.txt to wheels/PLATFORM-pyXY.toml
    python scripts/wheel_locks.py fetch [--cache FOLDER]     what the locks name, into the cache; verifies all of it
    python scripts/wheel_locks.py table                      the locks as a table

`--platform linux-x64 --python 3.11` limits each to some of the locks. pip downloads; its own settings say from where.
`lock` keeps what a lock names already and still fits: delete the file to choose anew. The locks for NVIDIA cards,
of which no zip is made, are meant only where `--platform linux-x64-cuda` names them.
"""

from __future__ import annotations

import argparse
import ast
import email.parser
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

ROOT = Path(__file__).resolve().parent.parent
LOCKS = ROOT / "wheels"
REQUIREMENTS = ROOT / "curecon_blender" / "requirements.txt"
CACHE = ROOT / "dist" / "wheels"

PYTHONS = ("3.11", "3.13")  # of Blender 4.5 LTS and 5.2 LTS
# The newest system of each kind that a wheel may ask for. Blender for Linux runs from glibc 2.28 on.
PLATFORMS = {
    "linux-x64": ["manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_26_x86_64", "manylinux_2_24_x86_64",
                  "manylinux_2_17_x86_64", "manylinux2014_x86_64", "manylinux2010_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": ["macosx_14_0_arm64"],
}
# For Get Libraries alone, where there is an NVIDIA card; no zip brings these.
CARD = "linux-x64-cuda"
PLATFORMS[CARD] = [*PLATFORMS["linux-x64"], "manylinux_2_25_x86_64", "manylinux_2_18_x86_64", "manylinux_2_12_x86_64",
                   "manylinux_2_5_x86_64", "manylinux1_x86_64"]
ZIPPED = tuple(name for name in PLATFORMS if name != CARD)
MARKERS = {
    "linux-x64": {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "x86_64",
                  "os_name": "posix"},
    "windows-x64": {"sys_platform": "win32", "platform_system": "Windows", "platform_machine": "AMD64",
                    "os_name": "nt"},
    "macos-arm64": {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64",
                    "os_name": "posix"},
}
MARKERS[CARD] = MARKERS["linux-x64"]
# A user's own Python brings them: requirements-dask.txt; the grids of countries; requirements-e57.txt.
OPTIONAL = {"distributed", "pyproj", "pye57"}
# Blender brings its own, in its own process too: a wheel of it would come first on Blender's path and replace it.
BLENDER_BRINGS = ("numpy",)
# PyPI's torch for Linux is for NVIDIA cards, with three gigabytes of CUDA libraries. PyTorch's own index has the same
# version for processors; pip must be shown it (PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu).
LOCAL_VERSIONS = {("linux-x64", "torch"): "=={}+cpu", (CARD, "torch"): "==={}"}
# llvmlite's wheels for Windows and macOS leave out what those for Linux say.
UNSAID_LICENSES = {"llvmlite": "BSD-2-Clause AND Apache-2.0 WITH LLVM-exception"}
# May be shipped with a program under GPL-3.0-or-later.
LICENSES = re.compile(r"(MIT|BSD|Apache|Unlicense|PSF|ISC|BSL|HPND|Zlib)", re.IGNORECASE)


@dataclass(frozen=True)
class Wheel:
    """One wheel as a lock names it. `requires` are the requirements that hold on the lock's platform and Python;
    `modules` the names that it can be imported by."""

    name: str
    version: str
    file: str
    sha256: str
    size: int  # bytes
    license: str
    modules: tuple[str, ...]
    requires: tuple[str, ...]


@dataclass(frozen=True)
class Target:
    """A platform, in Blender's words, and a Python."""

    platform: str
    python: str

    @property
    def tag(self) -> str:
        return "py" + self.python.replace(".", "")

    @property
    def lock(self) -> Path:
        return LOCKS / f"{self.platform}-{self.tag}.toml"

    def holds(self, requirement: Requirement, extras: Iterable[str] = ()) -> bool:
        """Whether the requirement's marker is true there, with or without one of the extras."""
        environment = {**MARKERS[self.platform], "python_version": self.python, "implementation_name": "cpython",
                       "python_full_version": f"{self.python}.0", "platform_python_implementation": "CPython"}
        return requirement.marker is None or any(
            requirement.marker.evaluate({**environment, "extra": extra}) for extra in ("", *extras))

    def requirements(self) -> list[Requirement]:
        """requirements.txt, for this target."""
        lines = [line.partition("#")[0].strip() for line in REQUIREMENTS.read_text(encoding="utf-8").splitlines()]
        return [found for line in lines if line and self.holds(found := Requirement(line))]

    def blender(self) -> dict[str, str]:
        """Versions of what Blender brings there, as requirements.txt says."""
        return {found.name: next(iter(found.specifier)).version for found in self.requirements()
                if found.name in BLENDER_BRINGS}

    def wheels(self) -> list[Wheel]:
        """What the lock names; nothing when there is none yet."""
        if not self.lock.is_file():
            return []
        entries = tomllib.loads(self.lock.read_text(encoding="utf-8"))["wheel"]
        return [Wheel(**entry | {"modules": tuple(entry["modules"]), "requires": tuple(entry["requires"])})
                for entry in entries]


TARGETS = tuple(Target(*choice) for choice in product(PLATFORMS, PYTHONS))


def read_wheel(path: Path, target: Target, extras: Iterable[str] = ()) -> Wheel:
    """The record of a wheel's file, with what its extras need."""
    name, version, *_ = parse_wheel_filename(path.name)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        (metadata,) = (entry for entry in names if re.fullmatch(r"[^/]+\.dist-info/METADATA", entry))
        said = email.parser.BytesParser().parsebytes(archive.read(metadata), headersonly=True)
    requires = [Requirement(line) for line in said.get_all("Requires-Dist", [])]
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Wheel(
        name=name, version=str(version), file=path.name, sha256=digest, size=path.stat().st_size,
        license=_license(said) or UNSAID_LICENSES.get(name, ""), modules=_modules(names),
        requires=tuple(sorted(_line(found) for found in requires if target.holds(found, extras))),
    )


def _license(said: email.message.Message) -> str:
    if expression := said["License-Expression"]:
        return str(expression)
    first = str(said["License"] or "").strip().partition("\n")[0]  # some put their whole licence there
    if first and not first.startswith("Copyright"):
        return first
    named = [line.rpartition(" :: ")[2] for line in said.get_all("Classifier", []) if line.startswith("License ::")]
    return ", ".join(named)


def _line(requirement: Requirement) -> str:
    extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
    return f"{canonicalize_name(requirement.name)}{extras}{requirement.specifier}"


def _modules(names: list[str]) -> tuple[str, ...]:
    """Top-level packages and modules, those of the interpreter's own kind included."""
    found = set()
    for name in names:
        top, _, rest = name.partition("/")
        if rest and name.endswith((".py", ".so", ".pyd")) and "." not in top:
            found.add(top)
        elif not rest and name.endswith((".py", ".so", ".pyd")):
            found.add(top.partition(".")[0])
    return tuple(sorted(found))


def check_lock(target: Target) -> list[str]:
    """What is wrong with a lock, in words; needs no wheel."""
    wheels = {wheel.name: wheel for wheel in target.wheels()}
    wrong = []
    versions = target.blender() | {name: wheel.version for name, wheel in wheels.items()}
    asked = [("requirements.txt", found) for found in target.requirements()]
    asked += [(wheel.name, Requirement(line)) for wheel in wheels.values() for line in wheel.requires]
    for who, requirement in asked:
        version = versions.get(canonicalize_name(requirement.name))
        if version is None:
            wrong.append(f"{who} needs {requirement}, which no wheel brings")
        elif not requirement.specifier.contains(version, prereleases=True):
            wrong.append(f"{who} needs {requirement}, and the lock has {version}")
    importable = {*sys.stdlib_module_names, *BLENDER_BRINGS}.union(*(wheel.modules for wheel in wheels.values()))
    missing = worker_imports() - importable - OPTIONAL
    wrong += [f"the worker imports {name}, which no wheel brings" for name in sorted(missing)]
    needed = {canonicalize_name(requirement.name) for _, requirement in asked}
    allowed = {_python_tag(target), "py3", "py2"}
    for wheel in wheels.values():
        name, version, _, tags = parse_wheel_filename(wheel.file)
        if (name, str(version)) != (wheel.name, wheel.version):
            wrong.append(f"{wheel.file} is not {wheel.name} {wheel.version}")
        if not any((tag.interpreter in allowed or tag.abi == "abi3") and _fits(tag.platform, target) for tag in tags):
            wrong.append(f"{wheel.file} is not for {target.platform} and Python {target.python}")
        if wheel.name in BLENDER_BRINGS:
            wrong.append(f"{wheel.name} would replace Blender's own")
        if wheel.name not in needed:
            wrong.append(f"{wheel.name} is needed by nothing")
        if target.platform in ZIPPED and not LICENSES.search(wheel.license):
            wrong.append(f"{wheel.name}: licence '{wheel.license}' is not known to go with the GPL")
        if not re.fullmatch(r"[0-9a-f]{64}", wheel.sha256) or wheel.size <= 0:
            wrong.append(f"{wheel.name} has no hash or size")
    return wrong


def worker_imports() -> set[str]:
    """The top-level modules that the worker's code names in its imports, its own package aside."""
    found = set()
    for path in (ROOT / "curecon_blender" / "core").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).partition(".")[0])
    return found


def _python_tag(target: Target) -> str:
    return "cp" + target.python.replace(".", "")


def _fits(platform: str, target: Target) -> bool:
    if platform == "any" or platform in PLATFORMS[target.platform]:
        return True
    found = re.fullmatch(r"macosx_(\d+)_\d+_(arm64|universal2)", platform)
    return target.platform == "macos-arm64" and found is not None and int(found[1]) <= 14


def lock(target: Target, cache: Path) -> None:
    """Write the target's lock; what pip has to look for lands in the cache."""
    kept = {wheel.name: wheel for wheel in target.wheels()}
    chosen: dict[str, Wheel] = {}
    open_requirements = target.requirements()
    while open_requirements:
        missing = []
        for requirement in open_requirements:
            name = canonicalize_name(requirement.name)
            if name in BLENDER_BRINGS or name in chosen:
                continue
            if name in kept and requirement.specifier.contains(kept[name].version):
                chosen[name] = kept[name]
            else:
                missing.append(_local(requirement, target))
        chosen |= {wheel.name: wheel for wheel in _download(missing, target, cache)}
        open_requirements = [
            found for wheel in chosen.values() for line in wheel.requires
            if canonicalize_name((found := Requirement(line)).name) not in {*chosen, *BLENDER_BRINGS}
        ]
    write(target, sorted(chosen.values(), key=lambda wheel: wheel.name))


def _local(requirement: Requirement, target: Target) -> Requirement:
    """The requirement, for the build that the target takes."""
    form = LOCAL_VERSIONS.get((target.platform, requirement.name))
    if form is None:
        return requirement
    return Requirement(requirement.name + form.format(next(iter(requirement.specifier)).version))


def _extras(requirements: list[Requirement]) -> dict[str, set[str]]:
    """The extras that are asked of each library."""
    return {canonicalize_name(found.name): found.extras for found in requirements if found.extras}


def write(target: Target, wheels: list[Wheel]) -> None:
    """Write a target's lock."""
    lines = [
        "# Written by scripts/wheel_locks.py lock from curecon_blender/requirements.txt.",
        f'platform = "{target.platform}"', f'python = "{target.python}"', "", "[blender]  # brought by Blender itself",
        *(f'{name} = "{version}"' for name, version in target.blender().items()),
    ]
    for wheel in wheels:
        lines += ["", "[[wheel]]"]
        lines += [f"{key} = {json.dumps(value)}" for key, value in asdict(wheel).items()]
    LOCKS.mkdir(exist_ok=True)
    target.lock.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _download(requirements: list[Requirement], target: Target, cache: Path) -> list[Wheel]:
    """Let pip fetch these, without what they need in turn: pip would read their markers for this computer."""
    if not requirements:
        return []
    cache.mkdir(parents=True, exist_ok=True)
    platforms = [part for name in PLATFORMS[target.platform] for part in ("--platform", name)]
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:",
                   "--dest", folder, "--implementation", "cp", "--python-version", target.python, *platforms]
        named = [_line(requirement) for requirement in requirements]
        if subprocess.run([*command, *named], check=False).returncode:
            raise SystemExit(f"pip cannot bring {', '.join(named)} for {target.platform} and Python "
                             f"{target.python}. wheels/README.md says what it needs.")
        found, extras = [], _extras(requirements)
        for path in sorted(Path(folder).iterdir()):
            name = canonicalize_name(path.name.partition("-")[0])
            found.append(read_wheel(path, target, extras.get(name, ())))
            os.replace(path, cache / path.name)
    return found


def fetch(target: Target, cache: Path) -> None:
    """Bring what the lock names into the cache, and hold every file against the lock."""
    wheels = target.wheels()
    missing = [Requirement(f"{wheel.name}==={wheel.version}") for wheel in wheels
               if not (cache / wheel.file).is_file()]
    _download(missing, target, cache)
    extras = _extras([Requirement(line) for wheel in wheels for line in wheel.requires])
    wrong = [wheel.file for wheel in wheels if not (cache / wheel.file).is_file()
             or read_wheel(cache / wheel.file, target, extras.get(wheel.name, ())) != wheel]
    if wrong:
        raise SystemExit(f"{target.lock.name}: not as locked: {', '.join(wrong)}")


def chosen_targets(options: argparse.Namespace) -> list[Target]:
    return [target for target in TARGETS if target.platform in options.platform and target.python in options.python]


def add_target_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--platform", nargs="+", choices=PLATFORMS, default=list(ZIPPED))
    parser.add_argument("--python", nargs="+", choices=PYTHONS, default=list(PYTHONS))
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the wheels (default: dist/wheels)")


def table(targets: list[Target]) -> str:
    """Sizes and licences, one row a library."""
    rows = ["| library | version | licence | " + " | ".join(f"{target.platform} {target.python}" for target in targets)
            + " |", "|---" * (3 + len(targets)) + "|"]
    wheels = {target: {wheel.name: wheel for wheel in target.wheels()} for target in targets}
    for name in sorted({name for found in wheels.values() for name in found}):
        named = [wheels[target][name] for target in targets if name in wheels[target]]
        sizes = [f"{wheels[target][name].size / 1e6:.1f}" if name in wheels[target] else "" for target in targets]
        versions = sorted({wheel.version for wheel in named})
        rows.append(f"| {name} | {', '.join(versions)} | {named[0].license} | {' | '.join(sizes)} |")
    totals = [f"{sum(wheel.size for wheel in wheels[target].values()) / 1e6:.1f}" for target in targets]
    return "\n".join([*rows, f"| together, MB | | | {' | '.join(totals)} |"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("lock", "fetch", "table"))
    add_target_arguments(parser)
    options = parser.parse_args()
    targets = chosen_targets(options)
    if options.command == "table":
        print(table(targets))
        return
    for target in targets:
        {"lock": lock, "fetch": fetch}[options.command](target, options.cache)
        if wrong := check_lock(target):
            raise SystemExit("\n".join([f"{target.lock.name}:", *wrong]))
        total = sum(wheel.size for wheel in target.wheels())
        print(f"{target.lock.name}: {len(target.wheels())} wheels, {total / 1e6:.0f} MB", flush=True)


if __name__ == "__main__":
    main()

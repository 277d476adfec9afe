# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's libraries fetched from a package index, here one of two small wheels on this computer."""

from __future__ import annotations

import functools
import hashlib
import http.server
import importlib.util
import platform
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_extension import blender, run_script, write_wheel  # noqa: F401

from curecon_blender.core.base.errors import Cancelled, SetupError
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.run import libraries, nvidia

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec("pip") is None, reason="this Python has no pip"),
    pytest.mark.usefixtures("no_card"),
]
NAMES = ("curecon_first", "curecon_second")


class Index:
    """A package index: a folder a project, as http.server lists them. `asked` are the paths that were asked for; what
    `held` names is not answered before `release`."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.asked, self.held, self.release = folder, [], "", threading.Event()
        outer = self

        class Handler(http.server.SimpleHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.asked.append(self.path)
                if outer.held and outer.held in self.path and self.path.endswith(".whl"):
                    outer.release.wait(60)
                super().do_GET()

            def log_message(self, *_: object) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.server_port}/"

    def wheels_asked(self) -> list[str]:
        return [path.rpartition("/")[2] for path in self.asked if path.endswith(".whl")]


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Index]:
    for name in ("PIP_FIND_LINKS", "PIP_EXTRA_INDEX_URL", "PIP_NO_INDEX"):
        monkeypatch.delenv(name, raising=False)
    found = Index(tmp_path / "index")
    yield found
    found.release.set()
    found.server.shutdown()
    found.server.server_close()


@pytest.fixture
def locks(tmp_path: Path, index: Index) -> Path:
    """A folder with the lock of this system and Python, and its wheels in the index."""
    system = libraries.PLATFORMS.get((sys.platform, platform.machine().lower()))
    if system is None:
        pytest.skip("there are no locks for this system")
    lines = []
    for name in NAMES:
        place = index.folder / name.replace("_", "-")
        place.mkdir(parents=True)
        wheel = write_wheel(place / f"{name}-1.0-py3-none-any.whl", {
            f"{name}/__init__.py": "VALUE = 7\n", f"{name}-1.0.data/purelib/{name}_too.py": "VALUE = 8\n",
            f"{name}-1.0.data/scripts/{name}": "no module\n",
        })
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        lines += ["[[wheel]]", f'name = "{name}"', 'version = "1.0"', f'file = "{wheel.name}"',
                  f'sha256 = "{digest}"', f"size = {wheel.stat().st_size}"]
    folder = tmp_path / "locks"
    folder.mkdir()
    tag = f"py{sys.version_info.major}{sys.version_info.minor}"
    (folder / f"{system}-{tag}.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder


@pytest.fixture
def no_card(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(nvidia, "QUERY", [str(tmp_path / "no such program")])


def make(folder: Path, locks: Path, index: Index, reporter: Reporter | None = None, **choice: bool) -> None:
    libraries.make(folder, locks, (index.address,), reporter or Reporter(), **choice)


def driver_says(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    """Stands in for NVIDIA's own program: prints these lines."""
    monkeypatch.setattr(nvidia, "QUERY", [sys.executable, "-c", f"print({chr(10).join(lines)!r})"])


@pytest.fixture
def card_lock(locks: Path, index: Index) -> Path:
    """A lock for NVIDIA cards, whose first library is another build of the same version, in the same index."""
    (lock,) = locks.iterdir()
    wheel = write_wheel(index.folder / "curecon-first" / "curecon_first-1.0+card-py3-none-any.whl", {
        "curecon_first/__init__.py": "VALUE = 70\n"})
    text = lock.read_text(encoding="utf-8")
    old = libraries.wheels_of(lock)[0]
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    for before, after in (('"1.0"', '"1.0+card"'), (old.file, wheel.name), (old.sha256, digest),
                          (f"= {old.size}", f"= {wheel.stat().st_size}")):
        text = text.replace(before, after, 1)
    path = lock.with_name(lock.name.replace("-py", f"{libraries.CARD}-py"))
    path.write_text(text, encoding="utf-8")
    return path


def test_what_the_lock_names_can_be_imported_and_is_fetched_once(tmp_path: Path, locks: Path, index: Index) -> None:
    folder, said = tmp_path / "made", list[Message]()
    make(folder, locks, index, Reporter(said.append))
    program = "import curecon_first, curecon_second_too; print(curecon_first.VALUE + curecon_second_too.VALUE)"
    environment = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "15"
    assert sorted(path.name for path in folder.iterdir() if not path.name.endswith(".dist-info")) == [
        "curecon.json", "curecon_first", "curecon_first_too.py", "curecon_second", "curecon_second_too.py"]
    progress = [message.overall for message in said if isinstance(message, Progress)]
    assert progress == sorted(progress)
    fetched = len(index.asked)
    make(folder, locks, index)
    assert len(index.asked) == fetched


@pytest.mark.parametrize(("said", "processor", "value"), [
    ((), False, 7), (("NVIDIA H200, 580.82.07, 9.0",), False, 70), (("NVIDIA H200, 580.82.07, 9.0",), True, 7),
    (("GeForce RTX 3060, 551.61, 8.6",), False, 7), (("GeForce GTX 1080, 580.65, 6.1",), False, 7),
    (("GeForce GTX 1080, 580.65, 6.1", "RTX A2000, Laptop, 581.1, 8.6"), False, 70),
    (("Tesla, [N/A], [N/A]", "what is this"), False, 7),
])
def test_a_card_that_they_can_use_gets_its_own_libraries(
    tmp_path: Path, locks: Path, index: Index, card_lock: Path, monkeypatch: pytest.MonkeyPatch,
    said: tuple[str, ...], processor: bool, value: int,
) -> None:
    driver_says(monkeypatch, *said)
    make(tmp_path / "made", locks, index, processor=processor)
    assert f"VALUE = {value}\n" == (tmp_path / "made" / "curecon_first" / "__init__.py").read_text()
    assert libraries.is_made(tmp_path / "made", card_lock) == (value == 70)


def test_a_build_for_the_card_that_is_not_the_locked_one_is_refused(
    tmp_path: Path, locks: Path, index: Index, card_lock: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver_says(monkeypatch, "NVIDIA H200, 580.82.07, 9.0")
    write_wheel(index.folder / "curecon-first" / "curecon_first-1.0+card-py3-none-any.whl", {
        "curecon_first/__init__.py": "VALUE = 'evil'\n"})
    with pytest.raises(SetupError, match="is not the file"):
        make(tmp_path / "made", locks, index)
    assert not (tmp_path / "made" / "curecon_first").exists()


def test_a_driver_that_does_not_answer_is_no_card(monkeypatch: pytest.MonkeyPatch, no_card: None) -> None:
    assert nvidia.find_card() is None
    monkeypatch.setattr(nvidia, "QUERY", [sys.executable, "-c", "import sys; sys.exit(9)"])
    assert nvidia.find_card() is None


def test_a_file_that_is_not_the_locked_one_is_refused(tmp_path: Path, locks: Path, index: Index) -> None:
    wheel = index.folder / "curecon-second" / "curecon_second-1.0-py3-none-any.whl"
    write_wheel(wheel, {"curecon_second/__init__.py": "VALUE = 'evil'\n"})
    with pytest.raises(SetupError, match="is not the file") as raised:
        make(tmp_path / "made", locks, index)
    assert "curecon_second" in raised.value.message and "Nothing of it was used" in raised.value.remedy
    assert not list((tmp_path / "made").rglob("*second*.whl")) and not list(tmp_path.rglob("curecon_second/*.py"))


def test_a_cancelled_fetch_goes_on_where_it_stopped(tmp_path: Path, locks: Path, index: Index) -> None:
    index.held = "curecon_second"
    reporter = Reporter(cancelled=lambda: index.wheels_asked()[-1:] == ["curecon_second-1.0-py3-none-any.whl"])
    with pytest.raises(Cancelled):
        make(tmp_path / "made", locks, index, reporter)
    assert not libraries.is_made(tmp_path / "made", libraries.lock_for_this_python(locks, card=False))
    index.held, index.asked = "", []
    index.release.set()
    make(tmp_path / "made", locks, index)
    assert index.wheels_asked() == ["curecon_second-1.0-py3-none-any.whl"]
    assert (tmp_path / "made" / "curecon_first" / "__init__.py").is_file()


def test_an_index_that_has_them_not_is_told(tmp_path: Path, locks: Path, index: Index) -> None:
    for wheel in index.folder.rglob("*.whl"):
        wheel.unlink()
    with pytest.raises(SetupError, match="does not have curecon_first") as raised:
        make(tmp_path / "made", locks, index)
    assert "Package Index" in raised.value.remedy


def test_another_python_is_told_which_has_libraries(tmp_path: Path, index: Index) -> None:
    with pytest.raises(SetupError, match=f"no libraries for Python {sys.version_info.major}"):
        make(tmp_path / "made", tmp_path, index)


def test_one_press_brings_them_into_blender_and_one_takes_them_away(
    blender: Path, tmp_path: Path, locks: Path, index: Index  # noqa: F811
) -> None:
    run_script(blender, "check_libraries.py", locks, Path(sys.executable), Path(index.address),
               resources=tmp_path / "user")

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that does the work, for a person, a script or the add-on.

A person sees a progress bar, a pipe sees plain lines, and the add-on (`--messages`) gets one JSON message a line and
may write `cancel` to standard input; when standard input closes, the parent is gone and the worker ends.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

from ..base import messages
from ..base.errors import CuReconError, OutOfMemory, SetupError, ran_out_of_memory
from ..base.language import Text
from ..base.messages import Message, Reporter
from ..base.options import (
    COMPARE,
    CONTROL,
    EXPORT,
    FRAMES,
    GAPS,
    LIBRARIES,
    MASK,
    PLAN,
    PUBLISH,
    TOKEN_VARIABLE,
    UPLOAD,
)
from .command_line import about_of, choices_of, options_of, parser

NEEDED = ("numpy", "PIL", "pillow_heif", "rawpy", "psutil", "cv2", "safetensors", "scipy", "torch", "pycolmap",
          "xatlas", "fast_simplification", "numba")
REQUIREMENTS = Path(__file__).resolve().parents[2] / "requirements.txt"
PLAIN_LINE_EVERY = 10.0  # seconds between progress lines in a pipe
ORPHAN_GRACE = 3.0  # seconds a worker may take to stop by itself once its parent is gone; a restart waits for it


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    options = parser().parse_args(arguments)
    out = _private_stdout()
    cancel = threading.Event()
    if options.messages:
        threading.Thread(target=_listen, args=(cancel,), daemon=True).start()
        sink: Callable[[Message], None] = _MessageSink(out)
    else:
        sink = _Terminal(sys.stderr)
    reporter = Reporter(sink, cancel.is_set)

    def fail(error: CuReconError) -> int:
        sink(messages.failure(error))
        if options.json:
            print(json.dumps({"error": error.message, "kind": error.kind, "remedy": error.remedy,
                              "path": error.path, "exit_code": error.exit_code}), file=out, flush=True)
        return error.exit_code

    try:
        if options.command != LIBRARIES:
            _require_libraries(NEEDED, by_hand=not options.messages)
        # After the libraries: pycolmap's logging installs handlers of its own when it is imported.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: cancel.set())
        summary = _run(options, reporter)
    except CuReconError as error:
        return fail(error)
    except Exception as error:  # the boundary of the process: a fault must reach the user, whatever it is
        traceback.print_exc(file=sys.stderr)
        if ran_out_of_memory(error):
            return fail(OutOfMemory())
        sink(messages.Failure(
            kind="fault", message=Text("CU-Recon failed: {}: {}", type(error).__name__, Text(str(error))),
            remedy="Please report this with the log; running again goes on from the last finished photo.",
        ))
        return 1
    reporter.result(summary)
    if options.json:
        print(json.dumps(summary), file=out, flush=True)
    return 0


def _run(options: argparse.Namespace, reporter: Reporter) -> dict[str, object]:
    if options.command == LIBRARIES:
        from .libraries import make

        return make(options.folder.absolute(), options.locks, tuple(options.index), reporter,
                    processor=options.processor)
    from . import pipeline

    if options.command == "self-check":
        from .self_check import self_check

        return self_check(options.device, reporter)
    if options.command == CONTROL:
        from .control import run_control

        return run_control(options.workspace, options.imported, options.system, options.find_targets,
                           options.dictionary, options.export, reporter)
    if options.command == FRAMES:
        from ..photos.video import take_frames

        reporter.begin({"photos": 1.0})
        reporter.stage("photos")
        return {"frames": take_frames(options.photos.absolute(), reporter), "warnings": reporter.warnings}
    if options.command in (PLAN, GAPS, MASK):
        from . import gaps, mask, plan

        return {PLAN: plan.run_plan, GAPS: gaps.run_gaps, MASK: mask.run_mask}[options.command](options, reporter)
    if options.command == "check":
        return pipeline.check(options_of(options), options.thumbnails, reporter)
    if options.command == "report":
        from ..report.provenance import About
        from .report import report

        about = About(name=options.name, by=options.by, when=options.when)
        return report(options.workspace, about, options.language, options.font, reporter)
    if options.command == COMPARE:
        _require_libraries(("laspy", "lazrs"), by_hand=not options.messages)
        from ..compare.write import Wishes, compare

        wishes = Wishes(by=options.by, pairs=tuple(options.pairs), scaled=options.scale, names=tuple(options.names),
                        thresholds=tuple(sorted(options.thresholds)), minutes=tuple(options.minutes),
                        change=options.change, registration=options.registration)
        return compare(options.ours, options.others, options.truth, options.out.absolute(), wishes, reporter)
    if options.command == EXPORT:
        _require_libraries(("laspy", "lazrs"), by_hand=not options.messages)
        from .export import export

        return export(options.workspace, options.format, options.frame, options.to, choices_of(options), reporter)
    if options.command == PUBLISH:
        from .publish import publish

        return publish(options.workspace, options.folder, about_of(options), options.part, reporter)
    if options.command == UPLOAD:
        from ..publish.upload import Added, Atlas, upload

        added = Added(tags=options.tags, register=options.register, period=options.period)
        atlas = Atlas(options.to, os.environ.get(TOKEN_VARIABLE, ""), options.language, reporter)
        return upload(options.folder, options.site, added, atlas, reporter)
    return pipeline.reconstruct(options_of(options), reporter)


def _require_libraries(names: Sequence[str], *, by_hand: bool) -> None:
    """Raises SetupError for the first library that is missing; `by_hand` says how somebody at a command line brings it.
    """
    for name in names:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            remedy = "Press Get Libraries, or install the CU-Recon zip that is made for this system and this Blender."
            if by_hand:
                remedy = f"Run {sys.executable} -m pip install -r {REQUIREMENTS}"
            raise SetupError(
                Text("CU-Recon lacks a library that it computes with: {}.", error.name or name), remedy=remedy,
                path=sys.executable,
            ) from error
        except (ImportError, OSError) as error:  # it is there; torch raises OSError for a missing DLL
            missing = ("Install Microsoft's Visual C++ Redistributable (x64) and start Blender again"
                       if sys.platform == "win32" else "Install the CU-Recon zip again")
            raise SetupError(
                Text("The Python at {} cannot load {}: {}", sys.executable, name, Text(str(error))),
                remedy=Text("{}, or choose another Worker Python in the add-on's preferences.",
                            Text(missing)), path=sys.executable,
            ) from error


def _private_stdout() -> TextIO:
    """Standard output for this module alone: what anything else prints there, native libraries too, goes to stderr."""
    sys.stdout.flush()
    private = os.dup(sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.dup2(2, 1)
    return open(private, "w", encoding="utf-8", errors="backslashreplace")


def _listen(cancel: threading.Event) -> None:
    for line in sys.stdin:
        if line.strip() == "cancel":
            cancel.set()
    cancel.set()
    time.sleep(ORPHAN_GRACE)
    os._exit(130)


class _MessageSink:
    """Messages as JSON lines; a lock, since stages may report from several threads."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._lock = threading.Lock()

    def __call__(self, message: Message) -> None:
        with self._lock:
            print(messages.encode(message), file=self._out, flush=True)


class _Terminal:
    """Messages for a person: a bar that redraws itself on a terminal, a line now and then in a pipe."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._bar = out.isatty()
        self._drawn = False
        self._last = 0.0

    def __call__(self, message: Message) -> None:
        if isinstance(message, messages.Progress):
            self._progress(message)
            return
        if isinstance(message, messages.StageStarted):
            self._line(f"[{message.index + 1}/{message.count}] {message.stage}")
            self._last = time.monotonic()
        elif isinstance(message, messages.Warning):
            self._line(f"warning: {message.text}")
        elif isinstance(message, messages.Log):
            self._line(message.text)
        elif isinstance(message, messages.Failure):
            self._line(f"error: {message.message}\n{message.remedy}")
        else:
            self._line(_in_words(message.summary))

    def _progress(self, message: messages.Progress) -> None:
        left = "" if message.eta is None else f", {_duration(message.eta)} left"
        if self._bar:
            filled = round(30 * message.overall)
            self._out.write(f"\r{'█' * filled}{'░' * (30 - filled)} {message.overall:4.0%}  "
                            f"{message.stage} {message.done}/{message.total}{left}\033[K")
            self._out.flush()
            self._drawn = True
        elif time.monotonic() - self._last > PLAIN_LINE_EVERY:
            self._last = time.monotonic()
            self._line(f"{message.stage}: {message.done} of {message.total}{left}")

    def _line(self, text: str) -> None:
        if self._drawn:
            self._out.write("\n")
            self._drawn = False
        print(text, file=self._out, flush=True)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def _in_words(summary: dict[str, object]) -> str:
    """The few figures that a person wants at the end."""
    if "report" in summary:
        return "\n".join(dict(summary["report"]).values())  # type: ignore[call-overload]
    if "gaps" in summary:
        return "\n".join(photo["says"] for photo in summary["gaps"]["photos"])  # type: ignore[index]
    if "compare" in summary:
        return "\n".join(summary["files"])  # type: ignore[arg-type]
    if "deliverables" in summary:
        made: Any = summary["deliverables"]
        return "\n".join([*summary["words"], *(f"{one['file']}: {one['says']}" for one in made)])  # type: ignore[misc]
    if "published" in summary:
        return f"{summary['site']}\nServe {summary['published']} with any web server."
    if "uploaded" in summary:
        return f"The site is at {summary['uploaded']}: a moderator there decides on it."
    if "points" in summary:
        clouds = summary["paths"]["clouds"] if isinstance(summary["paths"], dict) else []
        where = f"\n{', '.join(clouds)}" if clouds else ""
        return f"{summary['registered']} of {summary['photos']} photos, {summary['points']:,} points{where}"
    return json.dumps(summary, indent=1, ensure_ascii=False)


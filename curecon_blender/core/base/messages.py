# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a worker tells its parent: a small closed set of messages, one JSON object a line.

A Text goes over as its message and values, so that whoever shows it can say it in another language.
"""

from __future__ import annotations

import json
import numbers
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from .errors import Cancelled, CuReconError
from .language import Text
from .reading import build, parse_json


@dataclass(frozen=True, kw_only=True)
class StageStarted:
    stage: str
    index: int  # of `count` stages, from 0
    count: int


@dataclass(frozen=True, kw_only=True)
class Progress:
    """`done` of `total` units in `stage`; `overall` in [0, 1] over the job; `eta` seconds left, if known."""

    stage: str
    done: int
    total: int
    overall: float
    eta: float | None


@dataclass(frozen=True, kw_only=True)
class Warning:
    text: str
    photo: str | None = None


@dataclass(frozen=True, kw_only=True)
class Log:
    text: str


@dataclass(frozen=True, kw_only=True)
class Result:
    """The job's JSON summary: the same that `--json` prints."""

    summary: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Failure:
    kind: str
    message: str
    remedy: str
    path: str | None = None
    exit_code: int = 1


Message = StageStarted | Progress | Warning | Log | Result | Failure
_KINDS: dict[str, type[Message]] = {
    "stage": StageStarted, "progress": Progress, "warning": Warning, "log": Log, "result": Result, "failure": Failure,
}
_NAMES = {cls: name for name, cls in _KINDS.items()}


def encode(message: Message) -> str:
    """One line of ASCII JSON, without the line end."""
    words = {field.name: _apart(getattr(message, field.name)) for field in fields(message)
             if isinstance(getattr(message, field.name), Text)}
    return json.dumps({"type": _NAMES[type(message)], **asdict(message), **words})


def _apart(value: object) -> object:
    """A value of a Text as JSON has it; a Text is its message before its values."""
    if isinstance(value, Text):
        return [value.message, *map(_apart, value.values)]
    if isinstance(value, numbers.Real):  # NumPy's among them
        return int(value) if isinstance(value, numbers.Integral) else float(value)
    return value if isinstance(value, str) else str(value)


def _together(value: object) -> object:
    """The reverse. Raises ValueError, TypeError, LookupError for what is no Text."""
    if not isinstance(value, list):
        return value
    message, *values = value
    return Text(build(str, message), *map(_together, values))


def decode(line: str) -> Message:
    """The message in a line. Raises ValueError for anything that is not one of the closed set."""
    try:
        told = {name: _together(value) for name, value in build(dict, parse_json(line)).items()}
        texts: dict[str, Any] = {name: value for name, value in told.items() if isinstance(value, Text)}
        told |= {name: str(text) for name, text in texts.items()}
        message: Message = build(_KINDS[build(str, told.pop("type"))], told)
        return replace(message, **texts)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise ValueError(f"not a worker message: {line[:200]!r}") from error


def failure(error: CuReconError) -> Failure:
    return Failure(
        kind=error.kind, message=error.message, remedy=error.remedy, path=error.path, exit_code=error.exit_code
    )


class Reporter:
    """Passes a job's messages to `sink` and carries the wish to cancel the other way.

    Stages call `progress` often: it also raises Cancelled when `cancelled` has come true, so that a stage needs no
    code of its own for it.
    """

    def __init__(
        self, sink: Callable[[Message], None] = lambda message: None, cancelled: Callable[[], bool] = lambda: False
    ) -> None:
        self._sink = sink
        self.cancelled = cancelled
        self._weights: dict[str, float] = {"": 1.0}
        self._stage = ""
        self._overall = 0.0
        self._started = time.monotonic()
        self._fresh_from = 0
        self._whole: dict[str, float] = {}  # seconds that each stage takes, as far as this run has shown
        self.resumed = False  # whether part of the stage was found finished from an earlier run
        self.warnings: list[str] = []

    def begin(self, weights: dict[str, float]) -> None:
        """Name the job's stages, in order, with how long each takes beside the others. Once more when more is known of
        that: what follows is then reckoned anew, and progress never goes back."""
        self._weights = weights
        if self._stage not in weights:
            self._stage = next(iter(weights))

    def stage(self, stage: str) -> None:
        """A stage begins; one that was not named is a job of its own."""
        self.check_cancelled()
        if stage not in self._weights:
            self.begin({stage: 1.0})
        self._stage, self._started, self._fresh_from, self.resumed = stage, time.monotonic(), 0, False
        self._sink(StageStarted(stage=stage, index=[*self._weights].index(stage), count=len(self._weights)))

    def progress(self, done: int, total: int, *, fresh: bool = True, left: float | None = None) -> None:
        """`fresh=False` for units found finished from an earlier run: they take no time, so no ETA comes of them.
        `left` is the seconds that the stage still takes, where it knows better than by the units so far."""
        self.check_cancelled()
        if not fresh:
            self._fresh_from, self._started, self.resumed = done, time.monotonic(), True
        weights = [*self._weights.values()]
        index = [*self._weights].index(self._stage)
        share = (sum(weights[:index]) + weights[index] * done / max(total, 1)) / sum(weights)
        self._overall = max(self._overall, share)
        eta = None
        elapsed = time.monotonic() - self._started
        if left is None and done > self._fresh_from:
            left = elapsed / (done - self._fresh_from) * (total - done)
        if left is not None:
            # As if nothing had been found finished.
            self._whole[self._stage] = (elapsed + left) * total / max(total - self._fresh_from, 1)
            shown = sum(self._weights.get(stage, 0.0) for stage in self._whole)
            eta = left + sum(self._whole.values()) * sum(weights[index + 1 :]) / shown
        self._sink(Progress(stage=self._stage, done=done, total=total, overall=self._overall, eta=eta))

    def warning(self, text: str, photo: str | None = None) -> None:
        self.warnings.append(text)
        self._sink(Warning(text=Text(text), photo=photo))

    def log(self, text: str) -> None:
        self._sink(Log(text=text))

    def result(self, summary: dict[str, Any]) -> None:
        self._sink(Result(summary=summary))

    def check_cancelled(self) -> None:
        if self.cancelled():
            raise Cancelled()

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The depth stage spread over the workers of a Dask cluster: a task a photo, each leaving its file in the workspace.

Processes, graphics cards and machines may take part that see the workspace and the weights under the same paths and
have this package on their Python path. A photo counts as done when its file is there, as it does in one process, so a
worker that dies costs the photo it was at, and a job may go on with other workers or none.

Dask runs whatever its peers send: a cluster belongs on a trusted network. Certificates are Dask's own configuration.
"""

from __future__ import annotations

import hashlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ..base.errors import DeviceError, SetupError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Component, View
from ..network import weights
from ..views import record as views_record
from .estimate import DepthEstimator, choose_device, make_depth, start_progress, tell_left_out, unfinished

if TYPE_CHECKING:
    import distributed

CORE = Path(__file__).resolve().parents[1]
REQUIREMENTS = CORE.parent / "requirements-dask.txt"
CONNECT_SECONDS = 10
POLL_SECONDS = 0.5
NO_WORKER_SECONDS = 60.0  # without any worker before the job gives up
WORKER_SHARE = 0.6  # of the memory that Dask allows a worker: above 0.8 it pauses it, above 0.95 it ends it


@contextmanager
def connect(address: str) -> Iterator[distributed.Client]:
    """A client of the scheduler at `address` ("tcp://host:8786"). Raises SetupError without Dask, DeviceError when
    nothing answers there, or not with this version of CU-Recon."""
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise SetupError(
            Text("The Python at {} has no {}: depth maps cannot be spread over a Dask cluster.", sys.executable,
                 error.name),
            remedy=Text("Run {} -m pip install -r {}, or leave the scheduler's address out.", sys.executable,
                        REQUIREMENTS),
            path=sys.executable,
        ) from error
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="CU-Recon")
    except (OSError, ValueError, TypeError) as error:  # no answer, no such host or scheme, no certificates
        raise DeviceError(
            Text("No Dask scheduler answers at {} ({}).", address, Text(str(error))),
            remedy='Start one with "dask scheduler" and give its address, such as tcp://192.168.1.5:8786; or leave the '
            "address out.",
        ) from error
    with client, client.as_current():
        # The scheduler reads the tasks too, and says of what it cannot read only that "environments differ".
        try:
            theirs = client.run_on_scheduler(code_digest)
        except Exception as error:  # whatever its Python raised
            raise _incompatible(f"scheduler at {address}", error) from error
        if theirs != code_digest():
            raise _incompatible(f"scheduler at {address}", "it has another version of CU-Recon")
        yield client


def spread_depths(
    components: list[Component], workspace: Path, options: Options, key: str, reporter: Reporter
) -> None:
    """`depth.estimate_depths` on the workers of the cluster at `options.scheduler`.

    Raises SetupError and DeviceError as `connect` does, and when no worker is there, one sees other files than this
    process, or a photo ends the workers that try it. Cancelled, no further photo is begun; those at work are finished.
    """
    with connect(options.scheduler) as client:
        workers = _checked_workers(client, workspace, options)
        left = unfinished(components, workspace, key)
        done, total = start_progress(components, left, reporter)
        futures: dict[distributed.Future, str] = {}
        left_out = 0
        for place, (view, _) in enumerate(left):
            # Photos next to each other share sources, whose features a process keeps. Dask may choose another worker
            # than the one named here, when that one is gone or behind.
            near = workers[place * len(workers) // len(left)]
            task = client.submit(_depth_of, view.name, workspace, options, key, key=f"depth-{key}-{view.name}",
                                 workers=[near], allow_other_workers=True, pure=False)
            futures[task] = view.name
        try:
            seen = time.monotonic()
            while futures:
                finished = _finished_of(futures)
                for task in finished:
                    left_out += _outcome(task, futures.pop(task))
                    done += 1
                    reporter.progress(done, total)
                reporter.check_cancelled()
                if finished or client.nthreads():
                    seen = time.monotonic()
                elif time.monotonic() - seen > NO_WORKER_SECONDS:
                    raise _no_workers(options.scheduler)
        finally:
            client.cancel(list(futures))
    tell_left_out(left_out, reporter)


def _finished_of(futures: dict[distributed.Future, str]) -> set[distributed.Future]:
    """Those that have ended, well or not; waits a moment for one."""
    import distributed

    with suppress(TimeoutError, CancelledError):  # none yet; or some are lost, which their states tell
        distributed.wait(list(futures), timeout=POLL_SECONDS, return_when="FIRST_COMPLETED")
    return {task for task in futures if task.status not in ("pending", "queued")}


def _outcome(task: distributed.Future, name: str) -> bool:
    """What `make_depth` told of a photo. Raises what it raised: a CuReconError, or what else it was."""
    import distributed

    try:
        return bool(task.result())
    except distributed.KilledWorker as error:
        raise DeviceError(
            Text("{} ended every worker that tried it (the last one: {}).", name, error.last_worker.address),
            remedy="They may be out of memory: start fewer workers on a machine, or lower the memory budget. Finished "
            "photos are kept.",
        ) from error
    except CancelledError as error:
        raise DeviceError(
            "The Dask scheduler is gone, or took the job's photos back.",
            remedy="Start it and its workers, then run it again: finished photos are kept.",
        ) from error


def _no_workers(address: str) -> DeviceError:
    return DeviceError(
        Text("The Dask scheduler at {} has no workers.", address),
        remedy=Text('Start some with "dask worker {} --nworkers 2 --nthreads 1", then run it again.', address),
    )


def _checked_workers(client: distributed.Client, workspace: Path, options: Options) -> list[str]:
    """The addresses of the cluster's workers, once each has said that it sees what this process sees."""
    ours = _seen_here(workspace, options)
    answers: dict[str, Any] = client.run(_seen_here, workspace, options, on_error="return")
    if not answers:
        raise _no_workers(options.scheduler)
    for address, answer in sorted(answers.items()):
        if isinstance(answer, Exception):
            raise _incompatible(f"worker {address}", answer) from answer
        for what, digest in ours.items():
            if answer[what] != digest:
                raise DeviceError(
                    Text("The Dask worker {} sees another {}, or none.", address, Text(what)),
                    remedy="Give all machines the workspace and CU-Recon under the same paths, then start the workers "
                    "again.",
                )
    return sorted(answers)


def _incompatible(who: str, why: object) -> DeviceError:
    """That a part of the cluster cannot take part; `why` may be an error with its own remedy."""
    return DeviceError(
        Text("The Dask {} cannot help with depth maps: {}", Text(who), Text(str(why))),
        remedy=getattr(why, "remedy", Text(
            "Start it with the same versions of CU-Recon's libraries and of Dask, and with the folder {} on its "
            "PYTHONPATH.", CORE.parents[1])),
    )


def code_digest(folder: Path = CORE) -> str:
    """A digest of all code in a folder and below, and of the files' places there."""
    files = {file.relative_to(folder).as_posix(): file for file in folder.rglob("*.py")}
    digest = hashlib.sha256()
    for place, file in sorted(files.items()):
        digest.update(f"{place} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def _seen_here(workspace: Path, options: Options) -> dict[str, str]:
    """Digests of what a task needs, by its name for people. Raises CuReconError when something is not there."""
    choose_device(options.device)
    views = workspace / views_record.FILE_NAME
    writable = views.is_file() and os.access(workspace, os.W_OK)
    return {
        f"workspace {workspace} (or may not write to it)": hashlib.sha256(views.read_bytes()).hexdigest()
        if writable else "",
        f"file of weights ({options.weights or 'the shipped one'})": weights.describe(options.weights)["sha256"],
        "version of CU-Recon": code_digest(),
    }


# ---- in the cluster's workers

_one_photo = threading.Lock()  # a worker with several threads still makes one photo at a time, within one budget


def _depth_of(name: str, workspace: Path, options: Options, key: str) -> bool:
    """Make the depth map of a photo and write its file, as `make_depth` does."""
    with _one_photo:
        estimator, views = _prepared(workspace, options, key)
        of_component = next(found for found in views if name in found)
        return make_depth(estimator, of_component[name], of_component, workspace, key)


@lru_cache(maxsize=1)
def _prepared(workspace: Path, options: Options, key: str) -> tuple[DepthEstimator, list[dict[str, View]]]:
    """The estimator of a job, with its features kept from photo to photo, and the components' views by name."""
    import distributed

    if choose_device(options.device).type == "cpu":
        # The digits of a convolution's sums follow the number of threads: one, whatever machine it is. Processes are
        # what shares out the cores.
        torch.set_num_threads(1)
        limit = distributed.get_worker().memory_manager.memory_limit
        if options.memory_gib is None and limit:
            options = replace(options, memory_gib=WORKER_SHARE * limit / 2**30)
    estimator = DepthEstimator(weights.load_network(options.weights), workspace, options)
    return estimator, [{v.name: v for v in component.views} for component in views_record.read(workspace)]

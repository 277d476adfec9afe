# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of rendered scenes, kept fresh by renderer processes while training reads from it."""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path
from types import TracebackType

import numpy as np

SIZE = (768, 576)  # width, height of the rendered photos


def _render(folder: Path, assets: Path, capacity: int, index: int, count: int, stop: Event) -> None:
    """Render seed after seed into the folder; beyond its capacity the oldest scene makes room."""
    from training.generator import Generator, save

    generator = Generator(assets)
    done = [int(p.stem) for p in folder.glob("*.npz")]
    seed = max([s for s in done if s % count == index], default=index - count) + count
    while not stop.is_set():
        save(generator.generate(seed, SIZE, views=None), folder / f"{seed}.npz")
        seed += count
        scenes = sorted(folder.glob("*.npz"), key=lambda p: int(p.stem))
        for old in scenes[: max(0, len(scenes) - capacity)]:
            old.unlink(missing_ok=True)


class ScenePool:
    """Starts the renderers on entry and stops them on exit. Scenes stay on disk for the next run."""

    def __init__(self, folder: Path, assets: Path, capacity: int, renderers: int) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        context = multiprocessing.get_context("spawn")
        self._stop = context.Event()
        self._renderers: list[BaseProcess] = [
            context.Process(target=_render, args=(folder, assets, capacity, i, renderers, self._stop), daemon=True)
            for i in range(renderers)
        ]

    def __enter__(self) -> ScenePool:
        for renderer in self._renderers:
            renderer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        for renderer in self._renderers:
            renderer.join(timeout=30)

    def pick(self, rng: np.random.Generator) -> Path:
        """A random scene of the pool; waits for the first one. Raises RuntimeError when all renderers have died."""
        while not (scenes := list(self.folder.glob("*.npz"))):
            if self._renderers and not any(r.is_alive() for r in self._renderers):
                raise RuntimeError("no scene could be rendered; the renderer's error is above")
            time.sleep(0.5)
        return scenes[int(rng.integers(len(scenes)))]

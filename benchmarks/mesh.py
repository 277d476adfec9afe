# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU seconds and peak memory of a mesh by step, of a workspace whose cloud is finished; the workspace stays as it is.

    python -m benchmarks.mesh WORKSPACE [--max-faces 250000] [--extent site] [--out FILE]

CPU seconds and memory are those of the process and of its children, Poisson's and the simplification's, together. The
memory of a step is the most that was held in it, libraries included. `--out` keeps the mesh.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

from curecon_blender.core.base.allocator import use_large_pages
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.cloud.edits import read_edited_cloud
from curecon_blender.core.run.peak_memory import PeakMemory
from curecon_blender.core.surface.build import SHARES, MeshOptions, build_mesh
from curecon_blender.core.surface.mesh import write_mesh
from curecon_blender.core.surface.sight import Sight
from curecon_blender.core.views import record

STEPS = ("points", "Poisson", "trimming", "simplifying", "marks")


class Steps(Reporter):
    """Takes the CPU time and the peak of memory at each step that is reported."""

    def __init__(self, peak: PeakMemory) -> None:
        super().__init__()
        self._peak, self._step, self._began, self.rows = peak, 0, _cpu(), list[tuple[str, float, float]]()

    def progress(self, done: int, total: int) -> None:
        step = sum(done >= sum(SHARES[: number + 1]) for number in range(len(SHARES)))
        if step > self._step:
            now = _cpu()
            self.rows.append((STEPS[self._step], now - self._began, self._peak.bytes / 2**30))
            self._step, self._began, self._peak.bytes = step, now, 0


def _cpu() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--max-faces", type=int, default=1_000_000)
    parser.add_argument("--extent", choices=("site", "building", "everything"), default="site")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    use_large_pages()
    component = record.read(arguments.workspace)[0]
    options = replace(MeshOptions(), max_faces=arguments.max_faces, extent=arguments.extent)
    with PeakMemory() as peak, tempfile.TemporaryDirectory() as scratch:
        steps = Steps(peak)
        cloud = read_edited_cloud(arguments.workspace / component.cloud)
        mesh = build_mesh(cloud, options, Path(scratch) / "mesh", steps,
                          Sight(component, arguments.workspace, Reporter()))
    for step, seconds, gib in steps.rows:
        print(f"{step:12} {seconds:7.1f} CPU s {gib:6.2f} GiB")
    print(f"{'all':12} {sum(row[1] for row in steps.rows):7.1f} CPU s {max(row[2] for row in steps.rows):6.2f} GiB   "
          f"{len(cloud):,} points, {len(mesh.faces):,} faces")
    if arguments.out is not None:
        write_mesh(arguments.out, mesh)


if __name__ == "__main__":
    main()

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame tools, measuring and cloud tools in Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

from pathlib import Path

from test_extension import blender, run_alone  # noqa: F401


def test_the_frame_tools_move_the_whole_site_and_are_kept(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_frame.py", tmp_path)


def test_what_is_shown_of_a_cloud_and_what_is_taken_out(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_cloud.py", tmp_path)


def test_a_sheet_states_the_scale_of_what_is_presented(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_presented.py", tmp_path)


def test_control_points_are_marked_kept_and_taken_back(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_control.py", tmp_path)


def test_parts_stand_by_their_gps_in_the_unit_of_the_scene(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_placing.py", tmp_path)


def test_what_is_linked_is_not_changed_and_nobody_is_told_so(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_linked.py", tmp_path)

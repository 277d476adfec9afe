# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is fuzzed: for each reader, sound files to start from, how they are spoiled, and the reading itself."""

from __future__ import annotations

from .flight_targets import (
    check_subtitles,
    check_track,
    drawn_cases,
    kml_cases,
    make_outline,
    make_subtitles,
    make_track,
    outline_reader,
    subtitles_cases,
    track_cases,
)
from .geometry_targets import (
    check_cloud,
    check_depth,
    check_mesh,
    check_patches,
    check_points,
    check_precision,
    check_removed,
    depth_cases,
    make_cloud,
    make_depth,
    make_mesh,
    make_patches,
    make_points,
    make_precision,
    ply_cases,
    points_cases,
    precision_cases,
    removed_cases,
)
from .model_targets import check_weights, make_model, make_weights, model_cases, model_reader, weights_cases
from .photo_targets import check_picture, check_raw, make_picture, make_raw, picture_cases, raw_cases
from .publish_targets import cases as publish_cases
from .publish_targets import check_catalogue, check_figures, check_film, check_notes, film_cases, make_film
from .publish_targets import make as make_published
from .result_targets import make_results, result_cases, result_reader
from .target import Target
from .workspace_targets import (
    check_accuracy,
    check_adjustment,
    check_control,
    check_control_file,
    check_falloff,
    check_frame,
    check_marker,
    check_message,
    check_photo_set,
    check_speeds,
    check_times,
    check_views,
    control_cases,
    json_cases,
    make_control_file,
    make_message,
    make_workspace,
    message_cases,
    speeds_cases,
)

TARGETS = {
    "pictures": Target(make_picture, picture_cases, check_picture),
    "raw": Target(make_raw, raw_cases, check_raw),
    "cloud": Target(make_cloud, ply_cases("cloud.ply"), check_cloud),
    "mesh": Target(make_mesh, ply_cases("mesh.ply"), check_mesh),
    "gaps": Target(make_patches, ply_cases("gaps.ply"), check_patches),
    "removed": Target(make_cloud, removed_cases, check_removed),
    "depth": Target(make_depth, depth_cases, check_depth),
    "points": Target(make_points, points_cases, check_points),
    "views": Target(make_workspace, json_cases("views.json"), check_views),
    "falloff": Target(make_workspace, json_cases("falloff.json"), check_falloff),
    "frame": Target(make_workspace, json_cases("sparse/0/frame.json"), check_frame),
    "accuracy": Target(make_workspace, json_cases("sparse/0/accuracy.json"), check_accuracy),
    "precision": Target(make_precision, precision_cases, check_precision),
    "adjustment": Target(make_workspace, json_cases("sparse/0/adjustment.json"), check_adjustment),
    "control": Target(make_workspace, json_cases("control.json"), check_control),
    "control_file": Target(make_control_file, control_cases, check_control_file),
    "photo_set": Target(make_workspace, json_cases("photos.json"), check_photo_set),
    "times": Target(make_workspace, json_cases("photos.json"), check_times),
    "workspace": Target(make_workspace, json_cases("workspace.json"), check_marker),
    "stage": Target(make_workspace, json_cases("stages/depth.json"), check_marker),
    "speeds": Target(make_workspace, speeds_cases, check_speeds),
    "messages": Target(make_message, message_cases, check_message),
    "model_binary": Target(make_model, model_cases("bin"), model_reader("bin")),
    "model_text": Target(make_model, model_cases("txt"), model_reader("txt")),
    "outline_geojson": Target(make_outline, drawn_cases, outline_reader("geojson")),
    "outline_kml": Target(make_outline, kml_cases, outline_reader("kml")),
    "subtitles": Target(make_subtitles, subtitles_cases, check_subtitles),
    "subtitle_track": Target(make_track, track_cases, check_track),
    "result_ply": Target(make_results, result_cases("a.ply", "b.ply"), result_reader("a.ply", "b.ply")),
    "result_las": Target(make_results, result_cases("a.las", "a.laz"), result_reader("a.las", "a.laz")),
    "result_mesh": Target(make_results, result_cases("a.obj", "a.glb"), result_reader("a.obj", "a.glb")),
    "result_text": Target(make_results, result_cases("a.xyz"), result_reader("a.xyz")),
    "weights": Target(make_weights, weights_cases, check_weights),
    "notes": Target(make_published, publish_cases("notes.json"), check_notes),
    "figures": Target(make_published, publish_cases("report.json"), check_figures),
    "film": Target(make_film, film_cases, check_film),
    "catalogue": Target(make_published, publish_cases("sites/gate/item.json"), check_catalogue),
}

# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models and weights, spoiled."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from .mutations import spoiled_bytes, spoiled_json, spoiled_words
from .workspace_targets import json_cases


def make_model(folder: Path) -> None:
    import pycolmap

    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, 4, 12
    model = pycolmap.synthesize_dataset(options)
    for kind in ("bin", "txt"):
        (folder / kind).mkdir()
    model.write_binary(folder / "bin")
    model.write_text(folder / "txt")


def model_cases(kind: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        strategies = []
        for file in sorted((folder / kind).iterdir()):
            content = file.read_bytes()
            spoiled = spoiled_bytes(content)
            if kind == "txt":
                spoiled = st.one_of(spoiled, spoiled_words(content), spoiled_words(content))
            strategies.append(st.tuples(st.just(f"{kind}/{file.name}"), spoiled))
        return st.one_of(*strategies)
    return cases


def model_reader(kind: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from curecon_blender.core.sparse import models as colmap_model
        from curecon_blender.core.views.undistortion import undistorted_camera

        for found in colmap_model.find_models(folder / kind):
            model = colmap_model.read_model(found)
            for image_id in model.reg_image_ids():
                image = model.image(image_id)
                assert np.isfinite(image.cam_from_world().matrix()).all()
                for point in image.get_observation_points2D():
                    assert np.isfinite(model.point3D(point.point3D_id).xyz).all()
                undistorted_camera(model.camera(image.camera_id))
            for point in model.points3D.values():
                for element in point.track.elements:
                    model.image(element.image_id).points2D[element.point2D_idx]
    return read


def make_weights(folder: Path) -> None:
    from curecon_blender.core.network import weights
    from curecon_blender.core.network.config import NetworkConfig
    from curecon_blender.core.network.model import LCMMVSNet

    config = NetworkConfig(channels=(2, 2, 2), groups=(2, 2, 2), regulariser_channels=2, context=0)
    weights.save_network(LCMMVSNet(config), folder / "own.safetensors", {"samples": 1})


def weights_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    content = (folder / "own.safetensors").read_bytes()
    size = 8 + int.from_bytes(content[:8], "little")
    return st.one_of(
        json_cases("own.json")(folder),
        st.tuples(st.just("own.safetensors"), st.one_of(
            spoiled_bytes(content[:size]).map(lambda header: header + content[size:]), spoiled_bytes(content),
            spoiled_json(json.loads(content[8:size])).map(
                lambda text: len(text).to_bytes(8, "little") + text + content[size:]),
        )),
    )


def check_weights(folder: Path) -> None:
    from curecon_blender.core.network import weights

    path = folder / "own.safetensors"
    record = path.with_suffix(".json")
    try:
        fields = json.loads(record.read_text())
        if "sha256" in fields:  # as whoever made both files would have it
            record.write_text(json.dumps({**fields, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}))
    except (ValueError, TypeError, RecursionError):
        pass  # it is for the reader to say so
    weights.load_network(path)

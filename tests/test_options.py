# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on asks of the worker arrives there, and what cannot be meant is refused."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest

from curecon_blender.core.base.options import CHECK, RUN, SURFACE, Options, arguments, declared
from curecon_blender.core.run.command_line import options_of, parser

OTHERS = Options(
    workspace=Path("work space"), photos=Path("photos"), until="texture", quality="ultra", model=Path("model"),
    max_image_size=900, views=3, speeds=Path("speeds.json"), memory_gib=1.5, half_memory=True, device="cpu",
    precision="fp32", scheduler="tcp://10.0.0.1:8786", mapper="global", matches="both",
    weights=Path("w.safetensors"),
    min_confidence=0.6, min_views=4, max_reprojection_error=0.5, max_depth_difference=0.02, fill_holes=False,
    extent="everything",
    max_faces=5000, region=(-1e-7, -2.5, 0.0, 1.0, 2.0, 3.0), region_turn=(1.0, 0.0, -1e-8, 0.0), texture_size=1024,
    texture_format="jpeg", detail=("20k", "1m"), surplus=True,
    control=(Path("gcp list.txt"), Path("marks.csv")), control_system="UTM 50N",
)


@pytest.mark.parametrize("command", [RUN, SURFACE, CHECK])
def test_every_option_that_a_command_takes_arrives(command: str) -> None:
    taken = {option.name for option, _ in declared(command)}
    assert all(getattr(OTHERS, name) != field.default for name in taken
               for field in fields(Options) if field.name == name)
    arrived = options_of(parser().parse_args(arguments(OTHERS, command)))
    for name in taken:
        assert getattr(arrived, name) == pytest.approx(getattr(OTHERS, name), abs=1e-6) if name.startswith("region") \
            else getattr(arrived, name) == getattr(OTHERS, name)
    assert arrived.workspace == OTHERS.workspace
    hash(arrived)  # Dask's workers keep what they prepared by the options


def test_defaults_need_no_arguments() -> None:
    plain = Options(workspace=Path("w"), photos=Path("p"))
    assert arguments(plain, RUN) == [RUN, "p", "--workspace", "w", "--until", "fusion"]
    assert options_of(parser().parse_args(arguments(plain, RUN))) == plain
    assert options_of(parser().parse_args(arguments(replace(plain, until="mesh"), SURFACE))).photos is None


@pytest.mark.parametrize(("flag", "value", "why"), [
    ("--memory", "0", "above 0"), ("--min-views", "0", "at least 1"), ("--min-confidence", "1.5", "more than 1"),
    ("--views", "many", "invalid int"), ("--max-depth-difference", "nan", "above 0"),
])
def test_a_number_out_of_range_is_refused(flag: str, value: str, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        parser().parse_args([RUN, "photos", "--workspace", "w", flag, value])
    assert refused.value.code == 2
    assert why in capsys.readouterr().err

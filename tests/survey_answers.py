# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A survey with known answers: 60 people rate three results, whose means and what satisfies people are planted."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

RESULTS = ("Ours", "Program B", "Program C")
ITEMS = ("clearness", "accuracy", "integrity", "authenticity", "operation", "satisfaction")
MEANS = (4.0, 3.3, 3.3)  # of the results; B and C are alike
ROLES = ("conservation", "design", "surveying")
BONUS = {"conservation": 0.0, "design": 0.0, "surveying": 1.2}  # of satisfaction


def table(people: int = 60, seed: int = 7) -> list[dict[str, str]]:
    """Rows by heading. Satisfaction is 0.6 clearness + 0.4 accuracy + the role's bonus + noise, integrity and
    authenticity say nothing, the first is harsh on everything by 0.5."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(people):
        role, lean = ROLES[person % 3], rng.normal(0, 0.5)
        row = {"respondent": f"p{person:02}", "consent": "yes", "seconds": str(200 + int(rng.integers(300))),
               "role": role, "software": ("never", "rarely", "often")[int(rng.integers(3))]}
        for result, mean in zip(RESULTS, MEANS, strict=True):
            said = {item: mean + lean + rng.normal(0, 0.6) for item in ITEMS}
            said["satisfaction"] = (0.6 * said["clearness"] + 0.4 * said["accuracy"] - 0.4 + BONUS[role]
                                    + rng.normal(0, 0.25))
            row |= {f"{result}: {item}": f"{int(np.clip(round(value), 1, 5))}" for item, value in said.items()}
        rows.append(row)
    return rows


def write(path: Path, rows: list[dict[str, str]], separator: str = ",", encoding: str = "utf-8") -> Path:
    with open(path, "w", newline="", encoding=encoding) as file:
        writer = csv.DictWriter(file, list(rows[0]), delimiter=separator)
        writer.writeheader()
        writer.writerows(rows)
    return path

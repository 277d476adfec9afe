# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A plan's folder: the page, the mission files of each flight, and all of it as JSON."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..base.files import atomic_write, disk_errors, write_json
from . import files
from .coverage import Seen
from .page import page
from .records import Plan


def facts(made: Plan, seen: Seen) -> dict[str, Any]:
    """The figures of a plan, as they stand in plan.json."""
    return {
        "kind": made.kind, "drone": made.drone.name, "photos": made.photos, "batteries": made.batteries,
        "pixel_mm": round(seen.usual_pixel, 1), "covered": round(seen.share, 3),
        "legs": [{"name": leg.name, "photos": len(leg), "distance": round(leg.distance, 1)} for leg in made.legs],
        "flights": [{"photos": flight.photos, "waypoints": len(flight.waypoints), "metres": round(flight.metres),
                     "minutes": round(flight.minutes, 1)} for flight in made.flights],
        "notes": list(made.notes),
    }


def write_plan(folder: Path, made: Plan, seen: Seen, name: str) -> list[str]:
    """Write a plan's files into a folder, which is made where it is missing; returns their names. Files of an earlier
    plan there are replaced. `name` heads the page.

    Mission files are written only where the building's position is known. Raises WorkspaceError.
    """
    with disk_errors(folder / "plan.json"):
        folder.mkdir(parents=True, exist_ok=True)
    written = []

    def path(file: str) -> Path:
        written.append(file)
        return folder / file

    for old in [*folder.glob("flight_*.kmz"), *folder.glob("flight_*_litchi.csv")]:
        old.unlink()  # of a plan that had more flights
    with atomic_write(path("plan.html")) as file:
        file.write(page(made, seen, name).encode())
    if made.building.origin is not None:
        created = int(time.time() * 1000)
        for n, flight in enumerate(made.flights, start=1):
            files.write_kmz(path(f"flight_{n}.kmz"), made, flight, created)
            files.write_litchi(path(f"flight_{n}_litchi.csv"), made, flight)
        files.write_kml(path("plan.kml"), made)
        files.write_gpx(path("plan.gpx"), made)
    write_json(path("plan.json"), {
        **facts(made, seen), "origin": asdict(made.building.origin) if made.building.origin else None,
        "waypoints": [[asdict(waypoint) for waypoint in flight.waypoints] for flight in made.flights],
    })
    return written

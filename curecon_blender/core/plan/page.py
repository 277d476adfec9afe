# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A plan on paper, for flying by hand: a map, each leg's heights, distances and angles, and what to keep in mind."""

from __future__ import annotations

from html import escape

import numpy as np

from .coverage import ENOUGH, Seen
from .records import Leg, Plan

COLOURS = ("#1b6ca8", "#c8553d", "#3a7d44", "#8e5ea2", "#b8860b", "#2f4b4b", "#a0522d", "#4b6cb7")
_SIZE = 640.0  # of the map, in its own units
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:860px;margin:24px auto;padding:0 16px;color:#222}
h1{font-size:22px}h2{font-size:17px;margin-top:24px}table{border-collapse:collapse;width:100%}
td,th{border-bottom:1px solid #ccc;padding:4px 8px;text-align:left}td.n,th.n{text-align:right}
svg{width:100%;height:auto;border:1px solid #ccc}i{display:inline-block;width:12px;height:12px;margin-right:6px}
@media print{body{margin:0}h2{break-after:avoid}table{break-inside:avoid}}
"""


def page(plan: Plan, seen: Seen, name: str) -> str:
    """The whole page as HTML, complete in itself. Its sentences are for a person who stands beside the drone."""
    flights = "".join(
        f"<tr><td>{n}</td><td class=n>{flight.photos}</td><td class=n>{len(flight.waypoints)}</td>"
        f"<td class=n>{flight.metres:.0f} m</td><td class=n>{flight.minutes:.0f} min</td></tr>"
        for n, flight in enumerate(plan.flights, start=1))
    legs = "".join(_leg_row(plan, n, leg) for n, leg in enumerate(plan.legs))
    notes = "".join(f"<li>{escape(note)}</li>" for note in plan.notes)
    wishes = plan.wishes
    batteries = "1 battery" if plan.batteries == 1 else f"{plan.batteries} batteries"
    missions = "1 flight" if len(plan.flights) == 1 else f"{len(plan.flights)} flights"
    minutes = sum(flight.minutes for flight in plan.flights)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{escape(name)}: flight plan</title><style>{_STYLE}</style></head><body>
<h1>{escape(name)}: flight plan</h1>
<p>{escape(plan.drone.name)}. {plan.photos} photos in {missions} on {batteries}, {minutes:.0f} minutes in the
air.
{100 * seen.share:.0f} % of walls and roofs will be in {ENOUGH} photos or more, at {seen.usual_pixel:.0f} mm a
pixel.</p>
{_map(plan)}
<h2>What to fly</h2>
<table><tr><th>part</th><th class=n>photos</th><th class=n>height above take-off</th><th class=n>camera</th>
<th class=n>distance to what is shown</th><th class=n>metres between photos</th></tr>{legs}</table>
<h2>Flights</h2>
<table><tr><th>flight</th><th class=n>photos</th><th class=n>waypoints</th><th class=n>way</th>
<th class=n>time</th></tr>
{flights}</table>
{_words(plan)}
<h2>Before take-off</h2>
<ul>{notes}
<li>Stay {wishes.clearance:.0f} m away from everything. The plan knows the building and what was measured, not wires,
new trees or cranes: look, and be ready to stop.</li>
<li>The plan stays below {wishes.ceiling:.0f} m above take-off. Fly only where it is allowed and with the owner's
permission.</li>
<li>Fix exposure, white balance and focus. No digital zoom. Light cloud is best.</li></ul>
</body></html>
"""


def _leg_row(plan: Plan, n: int, leg: Leg) -> str:
    heights = leg.places[:, 2] - plan.wishes.takeoff[2]
    steps = np.linalg.norm(np.diff(leg.places, axis=0), axis=1)
    apart = f"{np.median(steps):.1f}" if len(steps) else ""
    return (f'<tr><td><i style="background:{COLOURS[n % len(COLOURS)]}"></i>{escape(leg.name)}</td>'
            f"<td class=n>{len(leg)}</td><td class=n>{_span(heights, ' m')}</td>"
            f"<td class=n>{_camera(leg.pitches)}</td><td class=n>{leg.distance:.0f} m</td>"
            f"<td class=n>{apart}</td></tr>")


def _words(plan: Plan) -> str:
    """Where each photo is taken, in sentences, for legs that have them."""
    told = "".join(f"<li>{escape(word)}</li>" for leg in plan.legs for word in leg.words)
    return f"<h2>Photo by photo</h2>\n<ol>{told}</ol>" if told else ""


def _camera(pitches: np.ndarray) -> str:
    pitch = float(np.median(pitches))
    if pitch < -85:
        return "straight down"
    return "level" if abs(pitch) < 3 else f"{abs(pitch):.0f}° {'down' if pitch < 0 else 'up'}"


def _span(values: np.ndarray, unit: str) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.0f}{unit}" if high - low < 1 else f"{low:.0f} to {high:.0f}{unit}"


def _map(plan: Plan) -> str:
    """Outline, photos and ways seen from above, north up, with a bar of metres."""
    everything = np.concatenate([plan.building.outline, *(leg.places[:, :2] for leg in plan.legs),
                                 np.array([plan.wishes.takeoff[:2]])])
    low, high = everything.min(axis=0) - 5, everything.max(axis=0) + 5
    scale = _SIZE / (high - low).max()

    def at(places: np.ndarray) -> str:
        return " ".join(f"{(x - low[0]) * scale:.1f},{(high[1] - y) * scale:.1f}" for x, y in places[:, :2])

    parts = [f'<polygon points="{at(plan.building.outline)}" fill="#ddd" stroke="#555"/>']
    if plan.building.court is not None:
        parts.append(f'<polygon points="{at(plan.building.court)}" fill="#fff" stroke="#555"/>')
    for n, leg in enumerate(plan.legs):
        colour = COLOURS[n % len(COLOURS)]
        parts.append(f'<polyline points="{at(leg.places)}" fill="none" stroke="{colour}" opacity=".6"/>')
        dots = "".join(f'<circle cx="{place.split(",")[0]}" cy="{place.split(",")[1]}" r="2"/>'
                       for place in at(leg.places).split())
        parts.append(f'<g fill="{colour}">{dots}</g>')
    x, y = at(np.array([plan.wishes.takeoff[:2]])).split(",")
    parts.append(f'<circle cx="{x}" cy="{y}" r="6" fill="none" stroke="#000"/><text x="{float(x) + 9:.0f}" y="{y}" '
                 'font-size="12">take-off</text>')
    width, height = (high - low) * scale
    bar = 10.0 if (high - low).max() < 150 else 50.0
    parts.append(f'<path d="M10 {height - 12:.0f}h{bar * scale:.1f}" stroke="#000" stroke-width="3"/>'
                 f'<text x="10" y="{height - 18:.0f}" font-size="12">{bar:.0f} m</text>'
                 f'<path d="M{width - 20:.0f} 40v-28l-5 9m5-9l5 9" fill="none" stroke="#000"/>'
                 f'<text x="{width - 24:.0f}" y="54" font-size="12">N</text>')
    return f'<svg viewBox="0 0 {width:.0f} {height:.0f}">{"".join(parts)}</svg>'

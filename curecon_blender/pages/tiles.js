// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A catalogue of more sites than one file holds, in tiles: one names its sites, or tells how many are in each of its 64
// parts. A tile's key is its quadkey; levels are three apart.

const STEP = 3;
const DEEPEST = 12;

/** West, south, east and north of a quadkey's square, in degrees. */
function square(key) {
  let [x, y] = [0, 0];
  for (const digit of key) {
    x = 2 * x + (digit & 1);
    y = 2 * y + (digit >> 1);
  }
  const side = 2 ** key.length;
  const latitude = (row) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * row) / side))) * 180) / Math.PI;
  return [(360 * x) / side - 180, latitude(y + 1), (360 * (x + 1)) / side - 180, latitude(y)];
}

function seen(key, view) {
  const [west, south, east, north] = square(key);
  return south <= view.getNorth() && north >= view.getSouth() &&
    [-360, 0, 360].some((turn) => west + turn <= view.getEast() && east + turn >= view.getWest());
}

export class Tiles {
  constructor(pattern, base) {
    this.pattern = pattern;
    this.base = base;
    this.kept = new Map();
  }

  fetch(key) {
    if (!this.kept.has(key)) {
      const address = this.pattern.replace("{level}", key.length).replace("{key}", key || "world");
      const asked = fetch(new URL(address, this.base)).then((answer) => (answer.ok ? answer.json() : { sites: [] }));
      asked.catch(() => this.kept.delete(key)); // asked again with the next view
      this.kept.set(key, asked);
    }
    return this.kept.get(key);
  }

  /** The sites and the counts of a view: {sites, parts}, each part [key, count, longitude, latitude]. */
  async within(view, zoom) {
    const wanted = Math.min(DEEPEST, STEP * Math.floor(Math.max(zoom, 0) / STEP));
    const found = { sites: [], parts: [] };
    const visit = async (key) => {
      const tile = await this.fetch(key);
      if (tile.sites) found.sites.push(...tile.sites);
      else if (key.length >= wanted) found.parts.push(...tile.parts);
      else await Promise.all(tile.parts.filter(([part]) => seen(part, view)).map(([part]) => visit(part)));
    };
    await visit("");
    return found;
  }
}

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// Two places are clicked: their distance, how far apart they are in plan, and in height.

import { BufferGeometry, Float32BufferAttribute, Line, LineBasicMaterial, Points, PointsMaterial } from "./vendor/three.js";
import { element, say } from "./words.js";

const STILL = 6; // pixels: a pointer that moved farther has turned the view

export function length(site, value) {
  return `${value.toFixed(2)} ${site.metres ? "m" : say("units")}`;
}

export class Measuring {
  constructor(stage, site, said, changed) {
    Object.assign(this, { stage, site, said, changed, on: false, places: [], off: 0, missed: false });
    const look = { color: "#b3441e", depthTest: false, transparent: true };
    this.geometry = new BufferGeometry();
    const drawn = [new Line(this.geometry, new LineBasicMaterial(look)),
                   new Points(this.geometry, new PointsMaterial({ ...look, size: 8, sizeAttenuation: false }))];
    drawn.forEach((one) => Object.assign(one, { renderOrder: 1, frustumCulled: false }));
    stage.scene.add(...drawn);
    let from = null;
    stage.canvas.addEventListener("pointerdown", (event) => (from = [event.clientX, event.clientY]));
    stage.canvas.addEventListener("pointerup", (event) => {
      const moved = from && Math.hypot(event.clientX - from[0], event.clientY - from[1]);
      if (this.on && from && moved < STILL) this.pick(event.clientX, event.clientY);
      from = null;
    });
  }

  turn(on) {
    if (on !== this.on) this.set([]);
    this.on = on;
    this.stage.canvas.classList.toggle("picking", on);
    if (on) this.tell();
    else this.said.hidden = true;
  }

  pick(x, y) {
    const found = this.stage.pick(x, y);
    this.missed = !found;
    if (found) {
      const begins = this.places.length !== 1;
      this.places = begins ? [found.place] : [...this.places, found.place];
      this.off = Math.max(begins ? 0 : this.off, found.off);
    }
    this.put();
  }

  set(places) {
    Object.assign(this, { places, off: 0, missed: false });
    this.put();
  }

  put() {
    this.geometry.setAttribute("position", new Float32BufferAttribute(this.places.flat(), 3));
    this.stage.draw();
    this.tell();
    this.changed();
  }

  state() {
    return this.on ? this.places : [];
  }

  tell() {
    if (!this.on) return;
    const lines = this.site.metres ? [] : [say("noScale")];
    if (this.missed) lines.push(say("missed"));
    const [first, second] = this.places;
    if (!first) lines.push(say("pick"));
    else if (!second) lines.push(say("pickSecond", length(this.site, first[2])));
    else {
      const [x, y, z] = second.map((value, axis) => value - first[axis]);
      lines.push(say("measured", ...[Math.hypot(x, y, z), Math.hypot(x, y), Math.abs(z)].map((value) => length(this.site, value))));
    }
    if (first && this.off > 0) lines.push(say("coarse", length(this.site, this.off)));
    this.said.replaceChildren(...lines.map((line) => element("p", line)));
    this.said.hidden = false;
  }
}

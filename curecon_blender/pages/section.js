// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A plane that cuts the site: level, seen from above; or upright, facing a direction.

import { Plane, Vector3 } from "./vendor/three.js";
import { length } from "./measuring.js";
import { say } from "./words.js";

export class Section {
  constructor(stage, site, form, changed) {
    Object.assign(this, { stage, site, form, changed, on: false });
    [this.place, this.turned] = ["cut-place", "cut-turn"].map((id) => form.querySelector(`#${id}`));
    form.addEventListener("input", () => this.cut());
  }

  get kind() {
    return this.form.querySelector("input:checked").value;
  }

  turn(on) {
    this.on = on;
    this.form.hidden = !on;
    this.cut();
  }

  /** How far along the plane's normal the site reaches. */
  reach(normal) {
    const [low, high] = this.site.box;
    const corners = [...Array(8).keys()].map((n) => new Vector3(...[0, 1, 2].map((axis) => ((n >> axis) & 1 ? high : low)[axis])));
    const along = corners.map((corner) => corner.dot(normal));
    return [Math.min(...along), Math.max(...along)];
  }

  normal() {
    if (this.kind === "level") return new Vector3(0, 0, 1);
    // A direction counts clockwise from y, as a bearing does.
    const angle = (this.turned.value * Math.PI) / 180;
    return new Vector3(Math.sin(angle), Math.cos(angle), 0);
  }

  cut() {
    const normal = this.normal();
    const [low, high] = this.reach(normal);
    this.at = low + ((high - low) * this.place.value) / 1000;
    this.form.querySelector("#cut-turn-label").hidden = this.kind === "level";
    this.stage.cut(this.on ? [new Plane(normal.negate(), this.at)] : []);
    this.tell();
    this.changed();
  }

  tell() {
    const at = length(this.site, this.at);
    this.form.querySelector("#cut-said").textContent =
      this.kind === "level" ? say("cutLevel", at) : say("cutUpright", at, this.turned.value);
  }

  state() {
    return this.on ? [this.kind, this.at, Number(this.turned.value)] : null;
  }

  set(wanted) {
    if (!wanted) return;
    const [kind, at, turned] = wanted;
    this.form.querySelector(`[value=${kind}]`).checked = true;
    this.turned.value = turned;
    const [low, high] = this.reach(this.normal());
    this.place.value = (1000 * (at - low)) / Math.max(high - low, 1e-9);
    this.cut();
  }
}

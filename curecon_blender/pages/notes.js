// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What somebody noted on the site: numbered pins that stay on their places as the view turns.

import { element } from "./words.js";

export class Notes {
  constructor(stage, site, pins, told) {
    Object.assign(this, { stage, site, told });
    this.pins = site.notes.map((note, number) => {
      const pin = element("button", number + 1, { type: "button", "aria-label": note.title, title: note.title });
      pin.addEventListener("click", () => this.open(number));
      return pin;
    });
    pins.append(...this.pins);
    stage.after.push(() => this.put());
  }

  put() {
    this.pins.forEach((pin, number) => {
      const at = this.stage.onScreen(this.site.notes[number].place);
      pin.hidden = !at;
      if (at) pin.style.transform = `translate(${at[0] - 15}px, ${at[1] - 15}px)`;
    });
  }

  /** Show a note, from where it was seen when it was made. */
  open(number) {
    const note = this.site.notes[number];
    if (!note) return;
    if (note.eye) this.stage.look(note.eye, note.place);
    this.told(number);
  }
}

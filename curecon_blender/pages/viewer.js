// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A site's page: its tiles, and what one does with them. Everything is in the site frame, Z up, in its own unit.

import { about } from "./about.js";
import { read, write } from "./link.js";
import { Measuring } from "./measuring.js";
import { Notes } from "./notes.js";
import { Section } from "./section.js";
import { Stage, hasWebGL } from "./stage.js";
import { say, speak } from "./words.js";

const $ = (id) => document.getElementById(id);

function alarm(word) {
  $("alert").textContent = say(word);
  $("alert").hidden = false;
}

/** The buttons of the bar that are on or off, each with its key. */
const SWITCHES = { measure: "m", section: "s", filled: "f", kind: "c", about: "i" };

class Page {
  constructor(site) {
    this.site = site;
    this.stage = new Stage($("view"), site, { changed: () => this.rested(), failed: () => alarm("failed") });
    this.section = new Section(this.stage, site, $("cut"), () => this.rested());
    this.measuring = new Measuring(this.stage, site, $("said"), () => this.rested());
    this.notes = new Notes(this.stage, site, $("pins"), (number) => this.told(number));
    for (const id of Object.keys(SWITCHES)) $(id).addEventListener("click", () => this.turn(id, !this.isOn(id)));
    $("kind").hidden = !(site.surface && site.cloud);
    $("filled").hidden = !(site.surface && site.surface.filled + site.surface.unseen > 0);
    $("home").addEventListener("click", () => this.stage.home());
    $("link").addEventListener("click", () => this.copyLink());
    addEventListener("keydown", (event) => this.pressed(event));
    addEventListener("hashchange", () => this.follow());
    this.follow();
  }

  isOn(id) {
    return $(id).getAttribute("aria-pressed") === "true";
  }

  turn(id, on) {
    $(id).setAttribute("aria-pressed", on);
    if (id === "measure") {
      this.measuring.turn(on);
      $("pins").inert = on; // what is under a pin can be picked
    }
    if (id === "section") this.section.turn(on);
    if (id === "filled") this.stage.markFilled(on);
    if (id === "kind") this.stage.show(on ? "cloud" : "surface");
    if (id === "about") $("panel").hidden = !on;
    this.rested();
  }

  /** Say in words what the page's language has changed. */
  speak() {
    about(this.site, $("panel"), (number) => this.notes.open(number));
    this.measuring.tell();
    this.section.tell();
    $("alert").hidden = true;
  }

  told(number) {
    const note = this.site.notes[number];
    $("said").replaceChildren(...[note.title, note.text].filter(Boolean).map((text, line) => {
      const made = document.createElement(line ? "p" : "strong");
      made.textContent = text;
      return made;
    }));
    $("said").hidden = false;
  }

  rested() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => {
      this.own = write({
        view: this.stage.view(), cloud: this.isOn("kind"), filled: this.isOn("filled"),
        section: this.section.state(), measured: this.measuring.state(),
      });
      if (location.hash !== this.own) history.replaceState(null, "", this.own);
    }, 300);
  }

  follow() {
    if (location.hash && location.hash === this.own) return;
    const wanted = read(location.hash);
    this.turn("kind", wanted.cloud && !$("kind").hidden);
    this.turn("filled", wanted.filled);
    this.turn("section", Boolean(wanted.section));
    this.section.set(wanted.section);
    this.turn("measure", wanted.measured.length > 0);
    this.measuring.set(wanted.measured);
    if (wanted.view) this.stage.look(...wanted.view);
    else this.stage.home();
    if (wanted.note !== null) this.notes.open(wanted.note);
  }

  async copyLink() {
    this.rested();
    await new Promise((done) => setTimeout(done, 350));
    $("said").hidden = false;
    try {
      await navigator.clipboard.writeText(location.href);
      $("said").textContent = say("copied");
    } catch {
      $("said").textContent = `${say("linkHere")} ${location.href}`; // a browser that lets no page write there
    }
  }

  pressed(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input") && event.key !== "Escape") return;
    const step = 5;
    const turns = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const key = event.key.toLowerCase();
    const chosen = Object.keys(SWITCHES).find((id) => SWITCHES[id] === key && !$(id).hidden);
    if (turns[event.key]) this.stage.orbit(...turns[event.key]);
    else if (key === "+" || key === "=") this.stage.nearer(0.85);
    else if (key === "-") this.stage.nearer(1 / 0.85);
    else if (key === "h") this.stage.home();
    else if (key === "escape") this.end();
    else if (chosen) this.turn(chosen, !this.isOn(chosen));
    else return;
    event.preventDefault();
  }

  end() {
    for (const id of ["measure", "section", "about"]) if (this.isOn(id)) this.turn(id, false);
    $("said").hidden = true;
  }
}

async function start() {
  const response = await fetch("site.json");
  if (!response.ok) throw new Error(response.statusText);
  const site = await response.json();
  document.title = site.title;
  $("title").textContent = site.title;
  if (hasWebGL()) return new Page(site);
  about(site, $("panel"), () => {});
  $("panel").hidden = false;
  $("tools").hidden = true;
  alarm("noWebGL");
  return null;
}

let page = null;
speak(() => page?.speak());
try {
  page = await start();
  page?.speak();
} catch (error) {
  console.error(error);
  alarm("noSite");
}

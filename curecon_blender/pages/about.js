// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// The panel that tells whose a record is, what it shows and how exact it is.

import { element, say } from "./words.js";

const whole = (number) => number.toLocaleString("en").replaceAll(",", "\u202f");

function millimetres(site, value) {
  if (!site.metres) return `${value.toPrecision(3)} ${say("units")}`;
  return value < 1 ? `${(1000 * value).toFixed(value < 0.01 ? 1 : 0)} mm` : `${value.toFixed(2)} m`;
}

function where(site) {
  const shown = site.geometry || site.location === "hidden" ? say(site.location) : say("unknown");
  const at = site.geometry?.type === "Point" ? site.geometry.coordinates.toReversed().map((one) => one.toFixed(5)).join(", ") : "";
  return [site.place, shown, at].filter(Boolean).join(" · ");
}

function rows(pairs) {
  const table = element("dl");
  for (const [name, text] of pairs) if (text) table.append(element("dt", name), element("dd", text));
  return table;
}

function figures(site) {
  const found = site.figures;
  const given = (name, text) => (name in found ? text(found[name]) : "");
  return rows([
    [say("pixel"), given("pixel", (value) => millimetres(site, value))],
    [say("reprojection"), given("reprojection", (value) => say("pixels", value.toFixed(2)))],
    [say("sigma"), "sigma_height" in found
      ? say("sigmaSaid", millimetres(site, found.sigma_plan), millimetres(site, found.sigma_height)) : ""],
    [say("seen"), given("seen_well", (value) => `${(100 * value).toFixed(0)} %`)],
    [say("check"), given("check", (value) => millimetres(site, value))],
    [say("control"), given("control", (value) => millimetres(site, value))],
  ]);
}

function marked(site) {
  const kinds = ["filled", "weak", "unseen"].filter((kind) => site.surface[kind] > 0);
  const said = kinds.map((kind) => {
    const share = 100 * site.surface[kind];
    return say(`${kind}Said`, share < 0.1 ? "< 0.1" : share.toFixed(1));
  });
  return said.length ? said.join(" ") : say("nothingFilled");
}

/** What an atlas adds to a site: its versions, and how others show it. */
function inAtlas(site) {
  const parts = [];
  if (site.versions?.length > 1) {
    const list = element("ul");
    for (const one of site.versions) {
      const entry = element("li");
      entry.append(element("a", say("version", one.taken ?? one.number, one.day), { href: one.href }));
      list.append(entry);
    }
    parts.push(element("h2", say("versions")), list);
  }
  if (site.address) {
    const field = element("textarea", "", { readonly: "", rows: "3", "aria-label": say("embed") });
    const frame = element("iframe", "", { src: site.address, title: site.title, width: "800", height: "500" });
    field.value = frame.outerHTML;
    parts.push(element("h2", say("embed")), field);
  }
  return parts;
}

/** Fill the panel; `opened` is called with a note's number. */
export function about(site, panel, opened) {
  const parts = [element("h2", site.title)];
  if (site.newest) {
    const older = element("p", `${say("older")} `, { class: "doubt" });
    older.append(element("a", say("newest"), { href: site.newest }));
    parts.push(older);
  }
  if (site.text) parts.push(element("p", site.text));
  if (!site.metres) parts.push(element("p", say("noScale"), { class: "doubt" }));
  if (site.doubt) parts.push(element("p", say("doubt"), { class: "doubt" }));
  parts.push(rows([
    [say("register"), site.register], [say("period"), site.period?.join(" – ")], [say("tags"), site.tags?.join(", ")],
    [say("credit"), site.credit], [say("licence"), site.licence], [say("taken"), site.taken], [say("where"), where(site)],
    [say("size"), site.surface ? say("faces", whole(site.surface.faces)) : ""],
    [say("points"), site.cloud ? say("pointsOf", whole(site.cloud.points), whole(site.cloud.of)) : ""],
  ]));
  if (site.surface) {
    parts.push(element("p", marked(site)));
    if (!site.surface.textured) parts.push(element("p", say("vertexColours")));
  } else parts.push(element("p", say("noSurface")));
  parts.push(element("h2", say("exactness")));
  parts.push(Object.keys(site.figures).length ? figures(site) : element("p", say("noFigures")));
  if (site.report) parts.push(element("a", say("report"), { href: site.report }));
  if (site.notes.length) {
    const list = element("ol");
    for (const [number, note] of site.notes.entries()) {
      const button = element("button", note.title, { type: "button" });
      button.addEventListener("click", () => opened(number));
      const entry = element("li");
      entry.append(button);
      list.append(entry);
    }
    parts.push(element("h2", say("notes")), list);
  }
  if (site.pictures.length) {
    parts.push(element("h2", say("pictures")));
    for (const address of site.pictures) {
      const link = element("a", "", { href: address });
      link.append(element("img", "", { src: address, alt: site.title, loading: "lazy" }));
      parts.push(link);
    }
  }
  if (site.film) {
    parts.push(element("h2", say("film")), element("video", "", { src: site.film, controls: "", playsinline: "", preload: "none", poster: "thumbnail.jpg" }));
  }
  parts.push(...inAtlas(site));
  const keys = element("p");
  keys.append(element("kbd", "← → ↑ ↓"), ` ${say("keysSaid")}`);
  parts.push(element("h2", say("keys")), keys);
  const licences = element("a", say("licences"), { href: "../../pages/vendor/LICENCES.txt" });
  const made = element("p", `${say("madeBy")} · `);
  made.append(licences);
  panel.replaceChildren(...parts, made);
}

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A view of a site as the part of its address behind the #, and back. What cannot be read is as if it were not there.

const fixed = (numbers) => numbers.map((number) => Number(number.toFixed(3))).join(",");

/** `view` is [eye, target], `section` [kind, place, turn] or null, `measured` a list of places. */
export function write({ view, cloud, filled, section, measured }) {
  const parts = [`view=${fixed(view.flat())}`];
  if (cloud) parts.push("cloud=1");
  if (!filled) parts.push("filled=0");
  if (section) parts.push(`section=${section[0]},${fixed(section.slice(1))}`);
  if (measured.length) parts.push(`measured=${fixed(measured.flat())}`);
  return `#${parts.join("&")}`;
}

function numbers(text) {
  const found = (text ?? "").split(",").filter(Boolean).map(Number);
  return found.every((one) => Number.isFinite(one) && Math.abs(one) < 1e9) ? found : [];
}

function triples(text) {
  const found = numbers(text);
  return Array.from({ length: Math.floor(found.length / 3) }, (_, number) => found.slice(3 * number, 3 * number + 3));
}

export function read(hash) {
  const given = new URLSearchParams(hash.slice(1));
  const view = triples(given.get("view"));
  const [kind, ...cut] = (given.get("section") ?? "").split(",");
  const note = Number.parseInt(given.get("note"), 10);
  return {
    view: view.length === 2 ? view : null,
    cloud: given.get("cloud") === "1",
    filled: given.get("filled") !== "0",
    section: ["level", "upright"].includes(kind) && numbers(cut.join(",")).length === 2 ? [kind, ...numbers(cut.join(","))] : null,
    measured: triples(given.get("measured")).slice(0, 2),
    note: Number.isInteger(note) ? note - 1 : null,
  };
}

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// The pages of people with an account: their sites, uploads, moderation. One room at a time, named behind the #.

import "./words.js";
import { element, say, speak } from "../pages/words.js";
import { ask, Refusal } from "./asking.js";
import { send, sitesOf } from "./sending.js";

const room = document.getElementById("room");
const said = document.getElementById("said");
let me = null;
let invitation = new URLSearchParams(location.hash.slice(1)).get("join") ?? "";
if (invitation) history.replaceState(null, "", location.pathname); // it is not to stay in the history

const day = (seconds) => new Date(1000 * seconds).toISOString().slice(0, 10);
const moment = (seconds) => new Date(1000 * seconds).toISOString().slice(0, 19).replace("T", " ");
const megabytes = (bytes) => (bytes / 1e6).toFixed(1);

function tell(text, wrong = false) {
  said.textContent = text;
  said.className = wrong ? "wrong" : "";
}

function told(error) {
  if (error instanceof Refusal) return error.message;
  console.error(error);
  return say("cut");
}

/** Do something that may be refused, and say so. */
async function attempt(work) {
  try {
    await work();
    return true;
  } catch (error) {
    tell(told(error), true);
    if (error.status === 401) await start();
    return false;
  }
}

function field(word, facts = {}, kind = "input") {
  const label = element("label", say(word));
  const input = element(kind, "", { name: word, ...facts });
  label.append(input);
  return label;
}

function form(button, fields, work) {
  const made = element("form");
  made.append(...fields, element("button", say(button), { class: "main" }));
  made.addEventListener("submit", async (event) => {
    event.preventDefault();
    const pressed = made.querySelector("button.main");
    pressed.disabled = true;
    await attempt(() => work(Object.fromEntries(new FormData(made)), made));
    pressed.disabled = false;
  });
  return made;
}

function button(word, work, kind = "") {
  const made = element("button", say(word), { type: "button", class: kind });
  made.addEventListener("click", work);
  return made;
}

function card(...parts) {
  const made = element("li", "", { class: "card" });
  made.append(...parts);
  return made;
}

function buttons(...parts) {
  const made = element("div", "", { class: "buttons" });
  made.append(...parts);
  return made;
}

function section(word, ...parts) {
  const made = element("section");
  made.append(element("h2", say(word)), ...parts);
  return made;
}

/** Ask before something is done that cannot be undone. */
function asking(made, question, work, ...fields) {
  if (made.querySelector("form")) return;
  const asked = form("yes", [element("p", say(question), { class: "doubt" }), ...fields], work);
  asked.append(button("no", () => asked.remove()));
  made.append(asked);
  asked.querySelector("input, button").focus();
}

const cards = (list) => {
  const made = element("ul");
  made.append(...list);
  return list.length ? made : element("p", say("nothingYet"), { class: "soft" });
};

// ---- rooms

function door() {
  const name = field("name", { required: "", autocomplete: "username", maxlength: "60" });
  if (invitation) {
    const fresh = field("password", { type: "password", required: "", minlength: "10", autocomplete: "new-password" });
    return section("join", element("p", say("joinSaid")), form("join", [name, fresh], async (given) => {
      await ask("POST", "api/join", { token: invitation, name: given.name, password: given.password });
      invitation = "";
      await start();
    }));
  }
  const password = field("password", { type: "password", required: "", autocomplete: "current-password" });
  return section("signIn", form("signIn", [name, password], async (given) => {
    await ask("POST", "api/session", { name: given.name, password: given.password });
    await start();
  }), element("p", say("invitedOnly"), { class: "soft" }));
}

async function mine() {
  const found = await ask("GET", "api/mine");
  const sites = found.sites.map((site) => {
    const made = card(element("strong", site.title || site.name), element("div", say(site.state), { class: "soft" }));
    if (site.why) made.append(element("p", site.why));
    if (site.state === "public") {
      made.append(buttons(element("a", say("view"), { href: `../sites/${site.name}/` }), button("takeDown", () => takeDown(made, site.name))));
    }
    return made;
  });
  const versions = found.versions.filter((one) => ["held", "refused"].includes(one.state)).map((one) => {
    const made = card(element("strong", one.title), element("div", `${day(one.made)} · ${say(one.state)}`, { class: "soft" }));
    if (one.why) made.append(element("p", one.why));
    if (one.state === "held") {
      made.append(buttons(element("a", say("view"), { href: `../held/sites/${one.id}/index.html` }),
        button("withdraw", () => attempt(async () => { await ask("DELETE", `api/versions/${one.id}`); await draw(); }))));
    }
    return made;
  });
  const uploads = found.uploads.map((one) => card(
    element("div", `${say("open")} · ${day(one.made)} · ${say("mb", megabytes(one.bytes))}`),
    buttons(button("giveUp", () => attempt(async () => { await ask("DELETE", `api/uploads/${one.id}`); await draw(); })))));
  return section("mine", cards([...uploads, ...versions, ...sites]));
}

function takeDown(made, name) {
  asking(made, "takeDownAsked", async (given) => {
    await ask("POST", `api/sites/${name}/remove`, { why: given.why });
    tell(say("done"));
    await draw();
  }, field("why", { maxlength: "2000" }));
}

function upload() {
  let sites = new Map();
  const chosen = field("choose", { type: "file", webkitdirectory: "", multiple: "", required: "" });
  const which = field("whichSite", { required: "" }, "select");
  which.hidden = true;
  const progress = element("progress", "", { max: "1", value: "0", "aria-label": say("sending", 0, 0) });
  progress.hidden = true;
  chosen.querySelector("input").addEventListener("change", (event) => {
    sites = sitesOf(event.target.files);
    which.hidden = sites.size < 2;
    which.querySelector("select").replaceChildren(...[...sites.keys()].map((name) => element("option", name, { value: name })));
    if (!sites.size) tell(say("noSiteThere"), true);
  });
  const period = element("div", "", { class: "pair" });
  period.append(field("from", { type: "number", min: "-10000", max: "2200" }), field("to", { type: "number", min: "-10000", max: "2200" }));
  const place = element("div", "", { class: "pair" });
  place.append(field("latitude", { type: "number", step: "any", min: "-90", max: "90" }), field("longitude", { type: "number", step: "any", min: "-180", max: "180" }));
  place.hidden = true;
  const tick = element("label", "", { class: "tick" });
  const officials = element("input", "", { type: "checkbox", name: "officials" });
  tick.append(officials, element("span", say("officials")));
  officials.addEventListener("change", () => (place.hidden = !officials.checked));
  const fields = [chosen, which, field("register", { maxlength: "80" }), field("tags"), period, ...(me.places ? [tick, place] : []), progress];
  return section("upload", form("send", fields, async (given) => {
    const files = sites.get(given.whichSite) ?? [...sites.values()][0];
    if (!files) return tell(say("noSiteThere"), true);
    const number = (text) => (text === "" ? null : Number(text));
    const added = {
      tags: given.tags.split(/[,，、]/).map((tag) => tag.trim()).filter(Boolean), register: given.register.trim(),
      period_from: number(given.from), period_to: number(given.to),
      exact: officials.checked ? { latitude: Number(given.latitude), longitude: Number(given.longitude) } : null,
    };
    progress.hidden = false;
    await send(files, added, (what, done, total) => {
      progress.value = done / total;
      tell(say(what, megabytes(done), megabytes(total)));
    });
    location.hash = "#mine";
    tell(say("sent"));
  }));
}

async function people() {
  const { accounts } = await ask("GET", "api/accounts");
  const made = element("div");
  made.append(element("h2", say("accounts")), cards(accounts.map((one) => {
    const shown = card(element("span", `${one.name} · ${say(one.role)} · ${day(one.made)}`));
    const close = () => asking(shown, "closeAsked", async () => {
      await ask("DELETE", `api/accounts/${one.id}`);
      tell(say("done"));
      await draw();
    });
    if (one.id !== me.id) shown.append(buttons(button("close", close)));
    return shown;
  })));
  return made;
}

async function moderate() {
  const { held } = await ask("GET", "api/held");
  return section("moderate", cards(held.map((one) => {
    const made = card(element("strong", one.title),
      element("div", [day(one.made), say("by", one.by), say("mb", megabytes(one.bytes)), say(one.location)].join(" · "), { class: "soft" }));
    for (const doubt of one.doubts) made.append(element("p", doubt, { class: "doubt" }));
    const decide = async (path, value) => {
      if (await attempt(() => ask("POST", `api/versions/${one.id}/${path}`, value))) tell(say("done"));
      await draw();
    };
    made.append(buttons(
      button("look", () => {
        const shown = made.querySelector("iframe");
        if (shown) shown.remove();
        else made.append(element("iframe", "", { src: `../held/sites/${one.id}/index.html`, title: one.title }));
      }),
      button("accept", () => decide("accept", {}), "main"),
      button("refuse", () => {
        if (made.querySelector("form")) return;
        const asked = form("refuse", [field("whyAsked", { required: "", maxlength: "2000" })], (given) => decide("refuse", { why: given.whyAsked }));
        made.append(asked);
        asked.querySelector("input").focus();
      })));
    return made;
  })), invite(), await people());
}

function invite() {
  const role = field("role", {}, "select");
  role.querySelector("select").append(...["contributor", "moderator", "official"].map((name) => element("option", say(name), { value: name })));
  const made = element("div");
  made.append(element("h2", say("invite")), form("invite", [role], async (given) => {
    const { link } = await ask("POST", "api/invitations", { role: given.role });
    made.querySelector("p")?.remove();
    const shown = element("p", say("inviteLink"));
    shown.append(element("br"), element("code", link));
    made.append(shown);
  }));
  return made;
}

async function audit() {
  const table = element("table");
  const head = element("tr");
  head.append(...["when", "who", "what"].map((word) => element("th", say(word), { scope: "col" })));
  table.append(head);
  const more = async (before) => {
    const { lines } = await ask("GET", `api/audit${before ? `?before=${before}` : ""}`);
    for (const line of lines) {
      const row = element("tr");
      row.append(element("td", moment(line.at)), element("td", line.by), element("td", [say(`did_${line.action}`), line.subject, line.detail].filter(Boolean).join(" · ")));
      table.append(row);
    }
    return lines.at(-1)?.id ?? before;
  };
  let last = await more(0);
  return section("audit", table, button("older", () => attempt(async () => { last = await more(last); })));
}

async function account() {
  const { tokens } = await ask("GET", "api/tokens");
  const given = element("p");
  const list = cards(tokens.map((one) => card(element("span", `${one.label || "–"} · ${say("until", day(one.ends))}`),
    buttons(button("end", () => attempt(async () => { await ask("DELETE", `api/tokens/${one.id}`); await draw(); }))))));
  const parts = [section("tokens", list, form("newToken", [field("label", { maxlength: "80" })], async (asked) => {
    const { token } = await ask("POST", "api/tokens", { label: asked.label });
    given.replaceChildren(say("tokenSaid"), element("br"), element("code", token));
  }), given)];
  if (me.role === "official") {
    const shown = element("p");
    parts.push(section("place", form("place", [field("placeAsked", { required: "" })], async (asked) => {
      const found = await ask("GET", `api/sites/${encodeURIComponent(asked.placeAsked)}/place`);
      shown.textContent = say("exactPlace", found.latitude, found.longitude);
    }), shown));
  }
  parts.push(section("account", element("p", `${me.name} · ${say(me.role)}`), form("change", [
    field("oldPassword", { type: "password", required: "", autocomplete: "current-password" }),
    field("newPassword", { type: "password", required: "", minlength: "10", autocomplete: "new-password" }),
  ], async (asked) => {
    await ask("POST", "api/password", { old: asked.oldPassword, new: asked.newPassword });
    await start();
    tell(say("changed"));
  }), button("signOut", () => attempt(async () => { await ask("DELETE", "api/session"); await start(); }))));
  const made = element("div");
  made.append(...parts);
  return made;
}

const ROOMS = { mine, upload, moderate, audit, account };

let drawn = 0;

async function draw() {
  const number = ++drawn;
  document.body.dataset.desk = "loading";
  const name = location.hash.slice(1) in ROOMS ? location.hash.slice(1) : "mine";
  for (const link of document.querySelectorAll("#rooms a")) {
    link.hidden = Boolean(link.dataset.role) && link.dataset.role !== me?.role;
    link.toggleAttribute("aria-current", link.hash === `#${name}`);
  }
  document.getElementById("rooms").hidden = !me;
  try {
    const made = me ? await ROOMS[name]() : door();
    if (number === drawn) room.replaceChildren(made);
  } catch (error) {
    tell(told(error), true);
    if (error.status === 401) {
      me = null;
      room.replaceChildren(door());
    } else room.replaceChildren();
  }
  document.title = say(me ? name : "desk");
  document.body.dataset.desk = "drawn";
}

async function start() {
  try {
    me = await ask("GET", "api/me");
  } catch (error) {
    me = null;
    if (error.status !== 401) tell(told(error), true);
  }
  await draw();
}

addEventListener("hashchange", () => {
  const joined = new URLSearchParams(location.hash.slice(1)).get("join");
  if (joined) return location.reload();
  tell("");
  return draw();
});
speak(() => {
  if (document.body.dataset.desk === "drawn") draw();
});
await start();

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// Questions to the server, with what shows it that they come from this page.

import { say } from "../pages/words.js";

let guard = "";

export class Refusal extends Error {
  constructor(status, answer) {
    super(answer.said ?? say("answered", status));
    this.status = status;
    this.answer = answer;
  }
}

/** Ask for JSON; `value` is sent as JSON, `body` as it is. Throws Refusal, in the page's language, or TypeError where nobody
    answers. */
export async function ask(method, path, value, body) {
  const headers = { "X-Atlas-Guard": guard, "Accept-Language": document.documentElement.lang };
  if (value !== undefined) headers["Content-Type"] = "application/json";
  const answer = await fetch(new URL(`../${path}`, document.baseURI), {
    method, headers, body: value === undefined ? body : JSON.stringify(value), credentials: "same-origin",
  });
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Refusal(answer.status, said);
  if (said.guard) guard = said.guard;
  return said;
}

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A published folder, chosen in the browser, to the atlas in chunks. The same files sent again go on from where they were.

import { ask, Refusal } from "./asking.js";

const TAKEN = /^(site\.json|thumbnail\.jpg|film\.mp4|pictures\/\d+\.jpg|(surface|cloud)\/(tileset\.json|earth\.json|\d+\.glb))$/;
const ATTEMPTS = 5;

/** The published sites among files of a folder: by their names, each a map of files by their paths in it. */
export function sitesOf(files) {
  const found = new Map();
  const roots = [...files].filter((file) => /(^|\/)site\.json$/.test(file.webkitRelativePath || file.name))
    .map((file) => file.webkitRelativePath.slice(0, -"site.json".length));
  for (const root of roots) {
    const own = new Map();
    for (const file of files) {
      const path = file.webkitRelativePath;
      if (path.startsWith(root) && TAKEN.test(path.slice(root.length))) own.set(path.slice(root.length), file);
    }
    found.set(root.replace(/\/$/, "").split("/").pop(), own);
  }
  return found;
}

async function hash(file) {
  const digest = await crypto.subtle.digest("SHA-256", await file.arrayBuffer());
  return [...new Uint8Array(digest)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

const pause = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

/** What an asking answers; again where the connection breaks or the server cannot answer now. */
async function patiently(asking) {
  for (let attempt = 1; ; attempt++) {
    try {
      return await asking();
    } catch (error) {
      if ((error instanceof Refusal && error.status < 500) || attempt === ATTEMPTS) throw error;
      await pause(attempt);
    }
  }
}

/** Where the file's next chunk begins. */
async function sendChunk(address, part, start) {
  try {
    return (await patiently(() => ask("PUT", `${address}?start=${start}`, undefined, part))).received;
  } catch (error) {
    if (error instanceof Refusal && error.status === 409 && Number.isInteger(error.answer.offset)) return error.answer.offset;
    throw error;
  }
}

/** Send a site's files; `told` is called with (what, done, total). */
export async function send(files, added, told) {
  told("hashing", 0, 1);
  const listed = [];
  for (const [path, file] of files) listed.push({ path, size: file.size, sha256: await hash(file) });
  const begun = await ask("POST", "api/uploads", { files: listed, added });
  const total = begun.files.reduce((sum, one) => sum + one.size, 0);
  let done = begun.files.reduce((sum, one) => sum + one.received, 0);
  for (const [number, one] of begun.files.entries()) {
    const file = files.get(one.path);
    for (let start = one.received; start < one.size; ) {
      const end = await sendChunk(`api/uploads/${begun.upload}/${number}`, file.slice(start, start + begun.chunk), start);
      done += end - start;
      start = end;
      told("sending", done, total);
    }
  }
  told("checking", total, total);
  return patiently(() => ask("POST", `api/uploads/${begun.upload}/finish`, {}));
}

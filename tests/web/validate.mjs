// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What Khronos's validator says of the GLB files of a folder, errors and warnings, as one line of JSON.
//     node validate.mjs FOLDER

import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import validator from "../../web/node_modules/gltf-validator/index.js";

const folder = process.argv[2];
const files = readdirSync(folder, { recursive: true }).filter((name) => name.endsWith(".glb"));
const wrong = [];
for (const name of files) {
  const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(join(folder, name))));
  wrong.push(...issues.messages.filter(({ severity }) => severity < 2).map((one) => `${name}: ${one.code} ${one.message} ${one.pointer}`));
}
console.log(JSON.stringify({ files: files.length, wrong }));

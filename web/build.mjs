// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// Makes curecon_blender/pages/vendor: the libraries of the published pages, as few files, with their licences.
//     npm ci --prefix web && npm run build --prefix web
// A folder as argument is written instead, for the test that the one in the repository is what this makes.

import { build } from "esbuild";
import { copyFileSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const here = import.meta.dirname;
const target = process.argv[2] ?? join(here, "..", "curecon_blender", "pages", "vendor");
const modules = join(here, "node_modules");
mkdirSync(target, { recursive: true });

const options = { absWorkingDir: here, bundle: true, minify: true, format: "esm", legalComments: "none", charset: "utf8" };
await build({ ...options, entryPoints: ["libraries.mjs"], outfile: join(target, "three.js") });
await build({ ...options, stdin: { contents: 'export { feature } from "topojson-client";', resolveDir: here },
              outfile: join(target, "topojson.js") });
// As they are: MapLibre's worker is a file of its own, which a strict Content-Security-Policy wants. Its names end in
// .js, as not every web server knows what .mjs is.
for (const [from, to] of [["maplibre-gl.mjs", "maplibre.js"], ["maplibre-gl-worker.mjs", "maplibre-worker.js"], ["maplibre-gl.css", "maplibre.css"]]) {
  const text = readFileSync(join(modules, "maplibre-gl", "dist", from), "utf8");
  writeFileSync(join(target, to), text.replace(/\n?\/\/# sourceMappingURL=.*\n?$/, "\n"));
}
copyFileSync(join(modules, "world-atlas", "land-50m.json"), join(target, "world.json"));

const packages = ["three", "3d-tiles-renderer", "maplibre-gl", "topojson-client", "world-atlas"];
const said = packages.map((name) => {
  const about = JSON.parse(readFileSync(join(modules, name, "package.json"), "utf8"));
  const file = ["LICENSE", "LICENSE.txt", "LICENSE.md"].find((one) => {
    try {
      return readFileSync(join(modules, name, one));
    } catch {
      return false;
    }
  });
  return `${name} ${about.version} (${about.license})\n\n${readFileSync(join(modules, name, file), "utf8").trim()}\n`;
});
writeFileSync(join(target, "LICENCES.txt"), `${said.join(`\n${"-".repeat(100)}\n\n`)}
${"-".repeat(100)}

world.json is made of Natural Earth's land, which is in the public domain.
`);

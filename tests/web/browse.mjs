// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// Goes through a published folder as a visitor does, and prints what it found as one line of JSON.
//     node browse.mjs CHROMIUM ADDRESS SITE PLACES FOLDER
// SITE is the site's id; PLACES are two places of it, x, y, z each, as JSON; pictures go to FOLDER.

import { join } from "node:path";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";

const [program, address, site, given, folder] = process.argv.slice(2);
const places = JSON.parse(given);
const host = new URL(address).host;
const PATIENCE = 90000; // milliseconds: software draws slowly
const wrong = [];
const found = {};

const browser = await chromium.launch({
  executablePath: program,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"],
});

async function open(path, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, locale: "en-GB", ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  page.on("console", (said) => ["error", "warning"].includes(said.type()) && !/GPU stall|GL Driver Message|versions at 1.1 or higher have limited/.test(said.text()) &&
    wrong.push(`console: ${said.text()}`));
  page.on("pageerror", (error) => wrong.push(`page: ${error}`));
  page.on("request", (one) => {
    const at = new URL(one.url());
    if (!["data:", "blob:"].includes(at.protocol) && at.host !== host) wrong.push(`another host: ${one.url()}`);
  });
  page.on("requestfailed", (one) => wrong.push(`failed: ${one.url()} ${one.failure()?.errorText}`));
  page.on("response", (one) => one.status() >= 400 && wrong.push(`${one.status()}: ${one.url()}`));
  await page.goto(new URL(path, address).href);
  return page;
}

const drawn = (page) => page.waitForFunction(() => document.body.dataset.tiles === "complete", null, { polling: 100 });
const text = (page, selector) => page.locator(selector).innerText();
const picture = (page, name) => page.screenshot({ path: join(folder, `${name}.png`) });

/** Where a place is on the picture of a camera that stands at `eye` and looks at `target`, Z up, 45 degrees high. */
function onScreen(place, eye, target, width, height) {
  const minus = (a, b) => a.map((value, axis) => value - b[axis]);
  const dot = (a, b) => a.reduce((sum, value, axis) => sum + value * b[axis], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((value) => value / Math.hypot(...a));
  const forward = unit(minus(target, eye));
  const right = unit(cross(forward, [0, 0, 1]));
  const up = cross(right, forward);
  const way = minus(place, eye);
  const scale = height / 2 / Math.tan(Math.PI / 8) / dot(way, forward);
  return [width / 2 + scale * dot(way, right), height / 2 - scale * dot(way, up)];
}

async function onMap() {
  const page = await open("index.html");
  await page.waitForFunction(() => document.body.dataset.map === "drawn", null, { polling: 100 });
  found.marks = await page.locator(".pin, .cluster").count();
  found.list = await page.locator("#list li").count();
  await picture(page, "map");
  await page.fill("#search", "no such site");
  found.none = await page.locator("#list li").count();
  await page.fill("#search", "");
  if (found.marks) {
    await page.locator("#list button").first().click();
    await page.waitForSelector(".maplibregl-popup a");
    found.popup = await text(page, ".maplibregl-popup a");
    await page.waitForTimeout(1500);
    await picture(page, "cell");
  }
  await page.click("#language");
  found.chinese = await text(page, "h1");
  await page.locator(`#list a[href*="${site}"]`).click();
  await page.waitForURL("**/sites/**");
  await drawn(page);
  found.followed = await page.title();
  await page.context().close();
}

async function onSite() {
  const middle = [0, 1, 2].map((axis) => (places[0][axis] + places[1][axis]) / 2);
  const apart = Math.hypot(...[0, 1, 2].map((axis) => places[0][axis] - places[1][axis]));
  const eye = [middle[0] + 0.1 * apart, middle[1] - 1.2 * apart, middle[2] + 1.6 * apart];
  const page = await open(`sites/${site}/index.html`);
  await drawn(page);
  await picture(page, "site");
  await page.evaluate((hash) => (location.hash = hash), `view=${[...eye, ...middle].join(",")}`);
  await page.waitForTimeout(500);
  await drawn(page);
  await page.keyboard.press("m");
  found.asked = await text(page, "#said");
  for (const place of places) await page.mouse.click(...onScreen(place, eye, middle, 1280, 800));
  found.measured = await text(page, "#said");
  await picture(page, "measured");
  await page.waitForTimeout(600);
  found.link = new URL(page.url()).hash;
  await page.keyboard.press("Escape");
  await page.click("#home");
  await page.click("#section");
  await page.locator("#cut-place").fill("450");
  found.cut = await text(page, "#cut-said");
  await drawn(page);
  await picture(page, "section");
  await page.locator("[value=upright]").check();
  await drawn(page);
  await picture(page, "upright");
  await page.keyboard.press("Escape");
  await page.click("#section");
  await page.click("#section");
  await page.click("#about");
  found.about = await text(page, "#panel");
  await picture(page, "about");
  found.film = await page.evaluate(async () => {
    const film = document.querySelector("#panel video");
    film.muted = true;
    await film.play();
    return film.videoWidth;
  });
  if (await page.locator("#pins button").count()) {
    await page.click("#about");
    await page.locator("#pins button").first().click();
    found.note = await text(page, "#said");
    await drawn(page);
    await picture(page, "note");
  }
  if (await page.locator("#kind").isVisible()) {
    await page.click("#kind");
    await page.waitForTimeout(300);
    await drawn(page);
    await picture(page, "cloud");
  }
  for (const key of ["ArrowLeft", "ArrowUp", "+", "-", "h", "f", "f"]) await page.keyboard.press(key);
  await page.context().close();
  // The link that was kept opens the same view with the same distance.
  const again = await open(`sites/${site}/index.html${found.link}`);
  await drawn(again);
  found.again = await text(again, "#said");
  await again.context().close();
}

async function onPhone() {
  const page = await open(`sites/${site}/index.html`, {
    viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true, locale: "zh-CN",
  });
  await drawn(page);
  found.phone = await text(page, "#measure");
  found.wide = await page.evaluate(() => document.documentElement.scrollWidth);
  await picture(page, "phone");
  await page.tap("#about");
  await picture(page, "phone_about");
  await page.tap("#about");
  await page.tap("#measure");
  await page.touchscreen.tap(195, 420);
  await picture(page, "phone_measure");
  await page.context().close();
  const map = await open("index.html", { viewport: { width: 390, height: 844 }, isMobile: true, hasTouch: true });
  await map.waitForFunction(() => document.body.dataset.map === "drawn", null, { polling: 100 });
  await picture(map, "phone_map");
  await map.context().close();
}

try {
  await onMap();
  await onSite();
  await onPhone();
} catch (error) {
  wrong.push(`tour: ${error}`);
} finally {
  await browser.close();
}
console.log(JSON.stringify({ ...found, wrong }));

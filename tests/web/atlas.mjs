// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// A contributor, a moderator and a visitor at an atlas, in a browser: what they do, as one line of JSON of what they saw.
//     node atlas.mjs CHROMIUM ADDRESS CONTRIBUTORS_LINK MODERATORS_LINK PUBLISHED_FOLDER FOLDER
// `wrong` lists faults of the pages and every request to another host. Pictures go to FOLDER.

import { join } from "node:path";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";

const [program, address, contributors, moderators, published, folder] = process.argv.slice(2);
const host = new URL(address).host;
const PATIENCE = 40000; // milliseconds: software draws slowly
const PHONE = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true, locale: "zh-CN" };
const wrong = [];
const found = {};

const browser = await chromium.launch({
  executablePath: program,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"],
});

async function somebody(options = {}) {
  return browser.newContext({ viewport: { width: 1280, height: 800 }, locale: "en-GB", ...options });
}

async function open(context, path) {
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  page.on("console", (said) => ["error", "warning"].includes(said.type()) && !/GPU stall|GL Driver Message|versions at 1.1 or higher|status of 40[13]/.test(said.text()) &&
    wrong.push(`console: ${said.text()}`));
  page.on("pageerror", (error) => wrong.push(`page: ${error}`));
  page.on("request", (one) => {
    const at = new URL(one.url());
    if (!["data:", "blob:"].includes(at.protocol) && at.host !== host) wrong.push(`another host: ${one.url()}`);
  });
  page.on("response", (one) => one.status() >= 400 && !/api\/(me|held|session)$/.test(one.url()) && wrong.push(`${one.status()}: ${one.url()}`));
  await page.goto(new URL(path, address).href);
  return page;
}

const drawn = (page) => page.waitForFunction(() => document.body.dataset.tiles === "complete", null, { polling: 100 });
const mapped = (page) => page.waitForFunction(() => document.body.dataset.map === "drawn", null, { polling: 100 });
const atDesk = (page) => page.waitForFunction(() => document.body.dataset.desk === "drawn", null, { polling: 100 });
const picture = (page, name) => page.screenshot({ path: join(folder, `${name}.png`) });
const wide = (page) => page.evaluate(() => document.documentElement.scrollWidth);

async function joined(context, link, name) {
  const page = await open(context, link);
  await page.fill("[name=name]", name);
  await page.fill("[name=password]", "correct horse battery");
  await picture(page, `join_${name}`);
  await page.keyboard.press("Enter");
  await page.waitForSelector("#rooms:not([hidden])");
  await atDesk(page);
  return page;
}

async function contributor() {
  const context = await somebody();
  const page = await joined(context, contributors, "Conrad");
  await page.click("a[href='#upload']");
  await page.waitForSelector("[name=choose]");
  await page.setInputFiles("[name=choose]", published);
  await page.fill("[name=register]", "CN-1113");
  await page.fill("[name=tags]", "earth, 圆楼");
  await page.fill("[name=from]", "1700");
  await page.fill("[name=to]", "1750");
  await page.check("[name=officials]");
  await page.fill("[name=latitude]", "24.658307");
  await page.fill("[name=longitude]", "117.052089");
  await picture(page, "upload");
  await page.click("button.main");
  await page.waitForFunction(() => location.hash === "#mine");
  await page.waitForFunction(() => /moderator/.test(document.getElementById("room").innerText), null, { polling: 100 });
  found.mine = await page.locator("#room").innerText();
  await picture(page, "mine");
  await page.click("#language");
  await page.click("a[href='#account']");
  await page.waitForSelector("[name=label]");
  await atDesk(page);
  await picture(page, "account_chinese");
  found.cookies = (await context.cookies()).map(({ httpOnly, sameSite }) => [httpOnly, sameSite]);
  const [answer] = await Promise.all([page.waitForResponse("**/api/held"), page.evaluate(() => (location.hash = "#moderate"))]);
  found.forbidden = answer.status();
  await atDesk(page);
  await context.close();
}

async function moderator() {
  const context = await somebody();
  const page = await joined(context, moderators, "Moira");
  await page.click("a[href='#moderate']");
  await page.waitForSelector("li.card:has(button.main)");
  await page.locator("li.card:has(button.main) button").first().click();
  const frame = await (await page.waitForSelector("iframe")).contentFrame();
  await frame.waitForFunction(() => document.body?.dataset.tiles === "complete", null, { polling: 100 });
  await page.waitForTimeout(500);
  await picture(page, "moderate");
  found.held = await page.locator("li.card:has(button.main)").innerText();
  await page.locator("li.card button.main").click();
  await page.waitForFunction(() => !document.querySelector("li.card button.main"));
  await page.click("a[href='#audit']");
  await page.waitForSelector("td");
  await picture(page, "audit");
  await context.close();
  const phone = await somebody(PHONE);
  const small = await open(phone, "desk/");
  await small.fill("[name=name]", "Moira");
  await small.fill("[name=password]", "wrong horse battery");
  await small.keyboard.press("Enter");
  await small.waitForSelector("#said.wrong");
  found.refusal = await small.locator("#said").innerText();
  await picture(small, "phone_sign_in");
  await small.fill("[name=password]", "correct horse battery");
  await small.keyboard.press("Enter");
  await small.waitForSelector("#rooms:not([hidden])");
  await small.tap("a[href='#audit']");
  await small.waitForSelector("td");
  await picture(small, "phone_audit");
  await small.tap("a[href='#moderate']");
  await small.waitForSelector("[name=role]");
  await picture(small, "phone_moderate");
  await small.tap("a[href='#upload']");
  await small.waitForSelector("[name=choose]");
  await picture(small, "phone_upload");
  found.wide = await wide(small);
  await phone.close();
}

async function visitor() {
  const context = await somebody();
  let page = await open(context, "index.html");
  await mapped(page);
  for (let attempt = 0; attempt < 40 && !(await page.locator("#list li").count()); attempt++) {
    await page.waitForTimeout(250);
    await page.reload();
    await mapped(page);
  }
  await page.waitForSelector(".pin");
  await picture(page, "map");
  found.list = await page.locator("#list li").count();
  await page.fill("#search", "圆楼");
  await page.waitForFunction(() => /1/.test(document.getElementById("count").textContent));
  await picture(page, "search");
  await page.fill("#search", "nothing like it");
  await page.waitForFunction(() => !document.querySelector("#list li"));
  await page.fill("#search", "");
  await page.waitForSelector("#list li");
  await page.fill("#from", "1751");
  await page.waitForFunction(() => !document.querySelector("#list li"));
  await page.fill("#from", "1750");
  await page.waitForSelector("#list li");
  await picture(page, "search_years");
  await page.fill("#from", "");
  // By keyboard alone: from the search to the site's page.
  await page.focus("#search");
  for (let step = 0; step < 9; step++) {
    await page.keyboard.press("Tab");
    if (await page.evaluate(() => document.activeElement.matches("#list a"))) break;
  }
  await page.keyboard.press("Enter");
  await page.waitForURL("**/sites/**");
  await drawn(page);
  await page.keyboard.press("i");
  found.about = await page.locator("#panel").innerText();
  found.embed = await page.locator("#panel textarea").inputValue();
  await picture(page, "site");
  const phone = await somebody(PHONE);
  page = await open(phone, "index.html");
  await mapped(page);
  await page.waitForSelector(".pin");
  await picture(page, "phone_map_chinese");
  found.chinese = await page.locator("h1").innerText();
  await page.locator("#list a").first().click();
  await drawn(page);
  await picture(page, "phone_site_chinese");
  found.visitors = [...await context.cookies(), ...await phone.cookies()].length;
  await context.close();
  await phone.close();
}

try {
  await contributor();
  await moderator();
  await visitor();
} catch (error) {
  wrong.push(`tour: ${error}`);
} finally {
  await browser.close();
}
console.log(JSON.stringify({ ...found, wrong }));

// Opens the built site in a headless Chromium: no error in the console, nothing that is loaded from elsewhere, formulas
// are drawn, pages do not scroll sideways, search finds pages. Leaves pictures of five pages at two widths to be looked at.
//
//     make docs-check
//     node docs/site/check.mjs build/docs/html build/docs/pictures
//
// Needs playwright-core, which the make target installs beside the site, and a Chromium: CHROMIUM, or /usr/bin/chromium.

import { createServer } from "node:http";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { extname, join, relative, resolve } from "node:path";

const [site, pictures] = process.argv.slice(2).map((path) => resolve(path));
const { chromium } = createRequire(join(site, "../node_modules/"))("playwright-core");
const LOOKED_AT = ["index", "how_to/shapes", "reference/bsdfs", "theory/motion", "tutorials/cornell_box"];
const WIDTHS = [1440, 420];
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };

const server = createServer((request, response) => {
  try {
    const path = join(site, decodeURIComponent(new URL(request.url, "http://site").pathname));
    const body = readFileSync(path);
    response.writeHead(200, { "content-type": TYPES[extname(path)] ?? "application/octet-stream" }).end(body);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const root = `http://127.0.0.1:${server.address().port}/`;

const htmlFiles = (folder) =>
  readdirSync(folder, { withFileTypes: true }).flatMap((entry) => {
    const path = join(folder, entry.name);
    if (entry.isDirectory()) return entry.name.startsWith("_") ? [] : htmlFiles(path);
    return path.endsWith(".html") ? [path] : [];
  });

const flags = "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
  + "--disable-component-update --disable-sync";
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", headless: true, args: flags.split(" "),
});
const wrong = [];
const external = new Map();
mkdirSync(pictures, { recursive: true });

async function open(width, name) {
  const page = await browser.newPage({ viewport: { width, height: 900 } });
  const say = (what) => wrong.push(`${name} (${width}): ${what}`);
  page.on("console", (message) => message.type() === "error" && say(`${message.text()} ${message.location().url}`));
  page.on("pageerror", (error) => say(String(error)));
  page.on("request", (request) => request.url().startsWith(root) || request.url().startsWith("data:") || say(`asks for ${request.url()}`));
  await page.goto(`${root}${name}.html`, { waitUntil: "load" });
  if (await page.locator(".math").count()) {
    await page.waitForSelector("mjx-container", { timeout: 60000 }).catch(() => say("formulas are not drawn"));
    await page.evaluate(() => window.MathJax?.startup?.promise);
    const bad = await page.locator("mjx-merror, mjx-container [data-mjx-error], .math:not(:has(mjx-container))").count();
    if (bad) say(`${bad} formulas are wrong`);
  }
  const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  if (over > 1) say(`scrolls sideways by ${over} pixels`);
  return { page, say };
}

for (const file of htmlFiles(site)) {
  const name = relative(site, file).replace(/\.html$/, "");
  const { page } = await open(WIDTHS[0], name);
  const links = await page.evaluate(() => [...document.querySelectorAll("a[href]")].map((a) => a.href));
  for (const link of links) {
    if (!link.startsWith(root) && /^https?:/.test(link)) external.set(link.split("#")[0], name);
  }
  await page.close();
}
for (const name of LOOKED_AT) {
  for (const width of WIDTHS) {
    const { page } = await open(width, name);
    await page.screenshot({ path: join(pictures, `${name.replaceAll("/", "-")}-${width}.png`) });
    await page.close();
  }
}
for (const [words, expected] of [["roughconductor", "reference/bsdfs"], ["roulette", "theory"], ["checkpoint", "tutorials/"]]) {
  const { page, say } = await open(WIDTHS[0], `search`);
  await page.goto(`${root}search.html?q=${words}`);
  await page.waitForSelector("#search-results ul.search li a", { timeout: 30000 }).catch(() => say(`no results of ${words}`));
  await page.waitForTimeout(1000);
  const found = await page.locator("#search-results ul.search li a").evaluateAll((all) => all.map((a) => a.getAttribute("href")));
  if (!found.some((href) => href.includes(expected))) say(`${words} does not find ${expected}`);
  await page.screenshot({ path: join(pictures, `search-${words}.png`) });
  await page.close();
}
await browser.close();
server.close();

writeFileSync(join(pictures, "external_links.txt"), [...external].sort().map(([link, page]) => `${link}\t${page}\n`).join(""));
console.log(`${external.size} links lead elsewhere: ${join(pictures, "external_links.txt")}`);
for (const line of wrong) console.error(line);
process.exit(wrong.length ? 1 : 0);

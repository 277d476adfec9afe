// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// The map and list of all sites, from items.json, a GeoJSON collection of STAC items. Where that says so in its links, it
// is the first of several pages, the map has tiles of its own, and a server searches.

import * as maplibre from "./vendor/maplibre.js";
import { feature } from "./vendor/topojson.js";
import { Tiles } from "./tiles.js";
import { element, say, speak } from "./words.js";

const list = document.getElementById("list");
const search = document.getElementById("search");
const years = document.getElementById("years"); // where a server searches
const here = new URL(".", import.meta.url);
const root = new URL("../", here);
const read = async (address) => (await fetch(new URL(address, root))).json();
const link = (page, rel) => page.links?.find((one) => one.rel === rel)?.href;
const catalogue = await read("items.json");
const searched = link(catalogue, "search");
const tiles = link(catalogue, "tiles") && new Tiles(link(catalogue, "tiles"), root);
const all = { items: catalogue.features, next: link(catalogue, "next"), count: catalogue.numberMatched ?? catalogue.features.length };
const known = new Map(all.items.map((item) => [item.id, item]));
years.hidden = !searched;
let listing = all; // what the list shows, and the map where it is of a search
let map = null;
let marks = [];

/** Where a site's mark stands, longitude and latitude: in the middle of what is shown of its place. */
function middle(item) {
  if (!item.geometry) return null;
  const places = item.geometry.type === "Point" ? [item.geometry.coordinates] : item.geometry.coordinates[0].slice(0, -1);
  return [0, 1].map((axis) => places.reduce((sum, place) => sum + place[axis], 0) / places.length);
}

/** The sites of this page that have what is searched for. */
function local(wanted) {
  const items = all.items.filter(({ properties: said }) =>
    [said.title, said.description, said["curecon:place"], said.providers?.[0].name].join("\n").toLowerCase().includes(wanted.toLowerCase()));
  return { items, count: items.length };
}

/** A page of what a server found, which finds nothing where it refuses to search. */
function page({ features = [], numberMatched = 0, page = 1, pages = 1 }, wanted) {
  const next = page < pages ? `${searched}?${wanted}&page=${page + 1}` : null;
  return { items: features, next, count: numberMatched, wanted };
}

/** What a server is asked for, as an address has it; empty for nothing. */
function query() {
  const given = [["q", search.value.trim()], ...[...years.children].filter((one) => one.validity.valid).map((one) => [one.id, one.value])];
  return String(new URLSearchParams(given.filter(([, text]) => text)));
}

async function more() {
  const answer = await read(listing.next);
  listing.next = listing.wanted ? page(answer, listing.wanted).next : link(answer, "next");
  listing.items.push(...answer.features);
  draw();
}

function about(item) {
  const said = item.properties;
  const where = item.geometry || said["curecon:location"] === "hidden" ? say(said["curecon:location"]) : say("unknown");
  const date = said["curecon:date_of"] === "photos" ? said.datetime.slice(0, 10) : "";
  return [said["curecon:place"], where, date].filter(Boolean).join(" · ");
}

function draw() {
  const shown = listing.items;
  for (const item of shown) known.set(item.id, item);
  document.getElementById("count").textContent =
    listing.count === 1 ? say("one") : listing.count ? say("many", listing.count) : say("nothing");
  list.replaceChildren(...shown.map((item) => {
    const entry = element("li");
    const words = element("div");
    entry.append(element("img", "", { src: item.assets.thumbnail.href, alt: "", loading: "lazy" }), words);
    words.append(element("a", item.properties.title, { href: item.assets.page.href }), element("p", about(item)));
    if (item.geometry) {
      const button = element("button", say("onMap"), { type: "button" });
      button.addEventListener("click", () => show(item));
      words.append(button);
    }
    return entry;
  }));
  if (listing.next) {
    const entry = element("li", "", { class: "more" });
    const button = element("button", say("more"), { type: "button" });
    button.addEventListener("click", more);
    entry.append(button);
    list.append(entry);
  }
  lay();
}

/** Lay on the map what a search found, or else all sites: by their tiles, where there are more than the list has. */
async function lay() {
  if (!map?.getSource("sites")) return;
  const seen = tiles && listing === all ? await tiles.within(map.getBounds(), map.getZoom()) : { sites: listing.items, parts: [] };
  for (const item of seen.sites) if (!known.has(item.id)) known.set(item.id, item);
  map.getSource("sites").setData(points(seen));
  map.getSource("cells").setData(cells(seen.sites));
}

const collected = (features) => ({ type: "FeatureCollection", features });
const point = (coordinates, properties) => ({ type: "Feature", geometry: { type: "Point", coordinates }, properties });
const cells = (items) => collected(items.filter((item) => item.geometry?.type === "Polygon")
  .map(({ geometry }) => ({ type: "Feature", geometry, properties: {} })));

function points({ sites, parts }) {
  return collected([
    ...sites.filter(middle).map((item) => point(middle(item), { id: item.id, count: 1 })),
    ...parts.map(([id, count, longitude, latitude]) => point([longitude, latitude], { id, count })),
  ]);
}

function show(item) {
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  map.easeTo({ center: middle(item), zoom: item.geometry.type === "Point" ? 9 : 11, duration: still ? 0 : 800 });
  const content = element("div");
  content.append(element("a", item.properties.title, { href: item.assets.page.href }), element("p", about(item)));
  new maplibre.Popup({ offset: 14 }).setLngLat(middle(item)).setDOMContent(content).addTo(map);
}

/** Sites that lie together on the screen are one mark with their number. */
function mark() {
  marks.forEach((one) => one.remove());
  const seen = new Set();
  marks = map.querySourceFeatures("sites").flatMap(({ geometry, properties }) => {
    const key = properties.cluster ? `c${properties.cluster_id}` : `${properties.count}/${properties.id}`;
    if (seen.has(key)) return [];
    seen.add(key);
    const count = properties.cluster ? properties.sites : properties.count;
    const single = count === 1 && !properties.cluster;
    const button = element("button", single ? "" : count, {
      type: "button", class: single ? "pin" : "cluster",
      "aria-label": single && known.has(properties.id) ? known.get(properties.id).properties.title : say("many", count),
    });
    button.addEventListener("click", async (event) => {
      event.stopPropagation();
      if (single && known.has(properties.id)) return show(known.get(properties.id));
      const zoom = properties.cluster ? await map.getSource("sites").getClusterExpansionZoom(properties.cluster_id) : map.getZoom() + 2;
      return map.easeTo({ center: geometry.coordinates, zoom });
    });
    return [new maplibre.Marker({ element: button }).setLngLat(geometry.coordinates).addTo(map)];
  });
  document.body.dataset.map = "drawn";
}

// Land on the sphere, for a flat map: a ring that crosses 180 degrees goes on beyond it, and one round a pole is closed there.
function flat(land) {
  const ring = (places) => {
    let turn = 0, turns = 0;
    const laid = places.map(([longitude, latitude], i) => {
      const step = i ? longitude - places[i - 1][0] : 0;
      turn += step > 180 ? -360 : step < -180 ? 360 : 0;
      turns += turn;
      return [longitude + turn, latitude];
    });
    if (turn) {
      const pole = places[0][1] < 0 ? -90 : 90;
      laid.push([laid.at(-1)[0], pole], [laid[0][0], pole], laid[0]);
    }
    const most = turn ? 0 : 360 * Math.round(turns / places.length / 360); // where most of it lay, there it stays
    return laid.map(([longitude, latitude]) => [longitude - most, latitude]);
  };
  const polygons = ({ type, coordinates }) => (type === "Polygon" ? [coordinates] : coordinates).map((rings) => rings.map(ring));
  return collected((land.features ?? [land]).map(({ geometry }) =>
    ({ type: "Feature", properties: {}, geometry: { type: "MultiPolygon", coordinates: polygons(geometry) } })));
}

async function start() {
  const world = await (await fetch(new URL("vendor/world.json", here))).json();
  maplibre.setWorkerUrl(new URL("vendor/maplibre-worker.js", here).href);
  map = new maplibre.Map({
    container: "map", attributionControl: false, maxZoom: 12, dragRotate: false, renderWorldCopies: true,
    style: {
      version: 8,
      sources: {
        land: { type: "geojson", data: flat(feature(world, world.objects.land)), tolerance: 0.2 },
        cells: { type: "geojson", data: cells(all.items) },
        sites: { type: "geojson", data: points({ sites: tiles ? [] : all.items, parts: [] }), cluster: true, clusterRadius: 45,
          clusterMaxZoom: 11, clusterProperties: { sites: ["+", ["get", "count"]] } },
      },
      layers: [
        { id: "sea", type: "background", paint: { "background-color": "#c9d8e6" } },
        { id: "land", type: "fill", source: "land", paint: { "fill-color": "#f4f1ea", "fill-outline-color": "#9aa7b3" } },
        { id: "cells", type: "fill", source: "cells", paint: { "fill-color": "#b3441e", "fill-opacity": 0.25, "fill-outline-color": "#b3441e" } },
        { id: "sites", type: "circle", source: "sites", paint: { "circle-opacity": 0 } }, // its marks are elements
      ],
    },
  });
  const places = all.items.map(middle).filter(Boolean);
  if (places.length) {
    const bounds = new maplibre.LngLatBounds();
    places.forEach((place) => bounds.extend(place));
    map.fitBounds(bounds, { padding: 80, maxZoom: 4, duration: 0 });
  }
  map.addControl(new maplibre.NavigationControl({ showCompass: false }));
  if (tiles) {
    map.once("load", lay);
    map.on("moveend", lay);
  }
  map.on("moveend", mark);
  map.on("idle", mark);
}

function listUp(found) {
  listing = found;
  draw();
}

let asked = 0;
let waiting = 0;
document.querySelector("aside").addEventListener("input", () => {
  clearTimeout(waiting);
  const number = ++asked;
  const wanted = query();
  if (!wanted) return listUp(all);
  if (!searched) return listUp(local(search.value.trim()));
  waiting = setTimeout(async () => {
    const found = page(await read(`${searched}?${wanted}`), wanted);
    if (number === asked) listUp(found); // no other letter was typed meanwhile
  }, 250);
});
speak(draw);
await start();

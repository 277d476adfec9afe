// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// The map and list of all sites, from items.json, a GeoJSON collection of STAC items.

import * as maplibre from "./vendor/maplibre.js";
import { feature } from "./vendor/topojson.js";
import { element, say, speak } from "./words.js";

const list = document.getElementById("list");
const search = document.getElementById("search");
const here = new URL(".", import.meta.url);
const items = (await (await fetch(new URL("../items.json", here))).json()).features;
let map = null;
let marks = [];

/** Where a site's mark stands, longitude and latitude: in the middle of what is shown of its place. */
function middle(item) {
  if (!item.geometry) return null;
  const places = item.geometry.type === "Point" ? [item.geometry.coordinates] : item.geometry.coordinates[0].slice(0, -1);
  return [0, 1].map((axis) => places.reduce((sum, place) => sum + place[axis], 0) / places.length);
}

function found() {
  const wanted = search.value.trim().toLowerCase();
  return items.filter(({ properties: said }) =>
    [said.title, said.description, said["curecon:place"], said.providers?.[0].name].join("\n").toLowerCase().includes(wanted));
}

function about(item) {
  const said = item.properties;
  const where = item.geometry || said["curecon:location"] === "hidden" ? say(said["curecon:location"]) : say("unknown");
  const date = said["curecon:date_of"] === "photos" ? said.datetime.slice(0, 10) : "";
  return [said["curecon:place"], where, date].filter(Boolean).join(" · ");
}

function draw() {
  const shown = found();
  document.getElementById("count").textContent =
    shown.length === 1 ? say("one") : shown.length ? say("many", shown.length) : say("nothing");
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
  map?.getSource("sites")?.setData(points(shown));
}

function points(shown) {
  return {
    type: "FeatureCollection",
    features: shown.filter(middle).map((item) => ({
      type: "Feature", geometry: { type: "Point", coordinates: middle(item) }, properties: { number: items.indexOf(item) },
    })),
  };
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
    const key = properties.cluster ? `c${properties.cluster_id}` : properties.number;
    if (seen.has(key)) return [];
    seen.add(key);
    const button = element("button", properties.cluster ? properties.point_count : "", {
      type: "button", class: properties.cluster ? "cluster" : "pin",
      "aria-label": properties.cluster ? say("many", properties.point_count) : items[properties.number].properties.title,
    });
    button.addEventListener("click", async (event) => {
      event.stopPropagation();
      if (!properties.cluster) return show(items[properties.number]);
      const zoom = await map.getSource("sites").getClusterExpansionZoom(properties.cluster_id);
      return map.easeTo({ center: geometry.coordinates, zoom });
    });
    return [new maplibre.Marker({ element: button }).setLngLat(geometry.coordinates).addTo(map)];
  });
  document.body.dataset.map = "drawn";
}

async function start() {
  const world = await (await fetch(new URL("vendor/world.json", here))).json();
  maplibre.setWorkerUrl(new URL("vendor/maplibre-worker.js", here).href);
  const cells = { type: "FeatureCollection", features: items.filter((item) => item.geometry?.type === "Polygon") };
  map = new maplibre.Map({
    container: "map", attributionControl: false, maxZoom: 12, dragRotate: false, renderWorldCopies: true,
    style: {
      version: 8,
      sources: {
        land: { type: "geojson", data: feature(world, world.objects.land), tolerance: 0.2 },
        cells: { type: "geojson", data: cells },
        sites: { type: "geojson", data: points(found()), cluster: true, clusterRadius: 45, clusterMaxZoom: 11 },
      },
      layers: [
        { id: "sea", type: "background", paint: { "background-color": "#c9d8e6" } },
        { id: "land", type: "fill", source: "land", paint: { "fill-color": "#f4f1ea", "fill-outline-color": "#9aa7b3" } },
        { id: "cells", type: "fill", source: "cells", paint: { "fill-color": "#b3441e", "fill-opacity": 0.25, "fill-outline-color": "#b3441e" } },
        { id: "sites", type: "circle", source: "sites", paint: { "circle-opacity": 0 } }, // its marks are elements
      ],
    },
  });
  const places = items.map(middle).filter(Boolean);
  if (places.length) {
    const bounds = new maplibre.LngLatBounds();
    places.forEach((place) => bounds.extend(place));
    map.fitBounds(bounds, { padding: 80, maxZoom: 4, duration: 0 });
  }
  map.addControl(new maplibre.NavigationControl({ showCompass: false }));
  map.on("moveend", mark);
  map.on("idle", mark);
}

search.addEventListener("input", draw);
speak(draw);
await start();

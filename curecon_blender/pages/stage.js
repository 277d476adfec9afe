// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What is drawn: the tiles of a surface and of a cloud, seen by one camera, whenever something has changed.

import {
  Color, OrbitControls, PerspectiveCamera, Raycaster, Scene, TilesRenderer, Vector2, Vector3, WebGLRenderer,
} from "./vendor/three.js";

const GROUND = "#e7ebf0";
const MARKS = { filled: new Color("#ff9a3c"), unseen: new Color("#b06cff") };
const WHITE = new Color("white");
const FOV = 45;
const TOWARDS = new Vector3(0.45, -0.75, 0.55).normalize();
const MEGABYTE = 1 << 20;
const POINT = 2; // pixels

export function hasWebGL() {
  return Boolean(document.createElement("canvas").getContext("webgl2"));
}

export class Stage {
  constructor(canvas, site, { changed, failed }) {
    this.site = site;
    this.canvas = canvas;
    this.changed = changed;
    this.failed = failed;
    this.small = matchMedia("(pointer: coarse)").matches || Math.min(screen.width, screen.height) < 700;
    this.planes = [];
    this.marked = true;
    this.tiles = {};
    this.after = [];
    const [low, high] = site.box.map((corner) => new Vector3(...corner));
    this.middle = low.clone().add(high).divideScalar(2);
    this.size = Math.max(high.distanceTo(low), 1e-6);
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.small, powerPreference: "high-performance" });
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, this.small ? 1.5 : 2));
    this.scene = new Scene();
    this.scene.background = new Color(GROUND);
    this.camera = new PerspectiveCamera(FOV, 1, this.size / 1000, this.size * 20);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.maxPolarAngle = 0.55 * Math.PI;
    this.controls.minDistance = this.size / 500;
    this.controls.maxDistance = this.size * 8;
    this.controls.addEventListener("change", () => this.draw());
    this.controls.addEventListener("end", changed);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.home();
    this.resize();
    this.show(site.surface ? "surface" : "cloud");
  }

  /** Show the surface or the cloud; its tiles are loaded when it is first shown. */
  show(kind) {
    this.kind = this.site[kind] ? kind : kind === "cloud" ? "surface" : "cloud";
    if (!this.tiles[this.kind]) this.tiles[this.kind] = this.load(this.site[this.kind].tileset);
    for (const [name, tiles] of Object.entries(this.tiles)) tiles.group.visible = name === this.kind;
    this.draw();
  }

  load(address) {
    const tiles = new TilesRenderer(new URL(address, document.baseURI).href);
    tiles.errorTarget = this.small ? 2 : 1; // pixels: see tiles.py on what a tile's error is
    tiles.lruCache.maxBytesSize = (this.small ? 200 : 600) * MEGABYTE;
    tiles.lruCache.minBytesSize = (this.small ? 150 : 450) * MEGABYTE;
    tiles.downloadQueue.maxJobsPerOrigin = 6;
    tiles.setCamera(this.camera);
    tiles.addEventListener("load-model", ({ scene }) => scene.traverse((one) => this.prepare(one)));
    for (const event of ["needs-update", "tiles-load-end", "load-root-tileset"]) tiles.addEventListener(event, () => this.draw());
    tiles.addEventListener("load-error", ({ error }) => {
      console.error(error);
      this.failed();
    });
    this.scene.add(tiles.group);
    return tiles;
  }

  prepare(one) {
    if (!one.material) return;
    one.material.clippingPlanes = this.planes;
    if (one.isPoints) Object.assign(one.material, { size: POINT * this.renderer.getPixelRatio(), sizeAttenuation: false });
    if (one.material.name in MARKS) one.material.color.copy(this.marked ? MARKS[one.material.name] : WHITE);
  }

  markFilled(on) {
    this.marked = on;
    this.tiles.surface?.forEachLoadedModel((scene) => scene.traverse((one) => this.prepare(one)));
    this.draw();
  }

  /** Planes that cut away what lies behind them. */
  cut(planes) {
    this.planes.splice(0, this.planes.length, ...planes);
    this.draw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.asked ??= requestAnimationFrame(() => {
      this.asked = null;
      this.frame();
    });
  }

  frame() {
    this.controls.update();
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = Math.max(distance / 200, this.size / 20000);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    const tiles = this.tiles[this.kind];
    tiles.setResolutionFromRenderer(this.camera, this.renderer);
    tiles.update();
    this.renderer.render(this.scene, this.camera);
    this.after.forEach((told) => told());
    const { downloading, parsing, queued, visible } = tiles.stats;
    const busy = downloading + parsing + queued > 0 || !tiles.root;
    document.body.dataset.tiles = busy ? (visible ? "shown" : "loading") : visible ? "complete" : "loading";
    Object.assign(document.body.dataset, { calls: this.renderer.info.render.calls, triangles: this.renderer.info.render.triangles });
    const progress = document.getElementById("progress");
    if (visible) progress.value = tiles.loadProgress;
    if (busy || !visible) this.draw();
  }

  view() {
    return [this.camera.position.toArray(), this.controls.target.toArray()];
  }

  look(eye, target) {
    this.camera.position.set(...eye);
    this.controls.target.set(...target);
    this.draw();
    this.changed();
  }

  home() {
    // As far off as the narrower side of the picture asks for.
    const narrow = Math.min(1, this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1));
    const far = (0.42 * this.size) / Math.tan((FOV * Math.PI) / 360) / Math.max(narrow, 0.3);
    this.look(this.middle.clone().addScaledVector(TOWARDS, far).toArray(), this.middle.toArray());
  }

  orbit(across, down) {
    const way = this.camera.position.clone().sub(this.controls.target);
    const length = way.length();
    const polar = Math.acos(way.z / length) + (down * Math.PI) / 180;
    const turn = Math.atan2(way.y, way.x) + (across * Math.PI) / 180;
    const kept = Math.min(Math.max(polar, 0.01), this.controls.maxPolarAngle);
    way.set(Math.sin(kept) * Math.cos(turn), Math.sin(kept) * Math.sin(turn), Math.cos(kept)).multiplyScalar(length);
    this.look(this.controls.target.clone().add(way).toArray(), this.controls.target.toArray());
  }

  nearer(factor) {
    const way = this.camera.position.clone().sub(this.controls.target).multiplyScalar(factor);
    this.look(this.controls.target.clone().add(way).toArray(), this.controls.target.toArray());
  }

  /** Where a place of the site is on the page, in pixels; null behind the camera. */
  onScreen(place) {
    const at = new Vector3(...place).project(this.camera);
    if (at.z > 1) return null;
    return [((at.x + 1) / 2) * this.canvas.clientWidth, ((1 - at.y) / 2) * this.canvas.clientHeight];
  }

  /** What is seen at a place of the page: its place on the site, and how far the tile there may be off; null for none. */
  pick(x, y) {
    const raycaster = new Raycaster();
    const box = this.canvas.getBoundingClientRect();
    raycaster.setFromCamera(new Vector2((2 * (x - box.left)) / box.width - 1, 1 - (2 * (y - box.top)) / box.height), this.camera);
    const far = this.camera.position.distanceTo(this.controls.target);
    raycaster.params.Points.threshold = (3 * POINT * far * Math.tan((FOV * Math.PI) / 360)) / box.height;
    const hits = raycaster.intersectObject(this.tiles[this.kind].group, true);
    const hit = hits.find(({ point }) => this.planes.every((plane) => plane.distanceToPoint(point) >= 0));
    if (!hit) return null;
    const tile = hit.object.userData.tile;
    return { place: hit.point.toArray(), off: tile?.children?.length ? tile.geometricError : 0 };
  }
}

// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What the viewer page uses of its libraries; build.mjs makes one file of it.
export {
  BufferGeometry, Color, Float32BufferAttribute, Line, LineBasicMaterial, PerspectiveCamera, Plane, Points,
  PointsMaterial, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { TilesRenderer } from "3d-tiles-renderer/three";

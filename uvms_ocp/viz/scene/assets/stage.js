"use strict";
// Drives meshcat's viewer: light, water, sea floor, camera, time line. World axes of the data: z up; three.js: y up.
const THREE = MeshCat.THREE;
const byId = (id) => document.getElementById(id);
const [COMMANDS, given] = ["commands", "details"].map((id) => JSON.parse(byId(id).textContent));
const none = (...names) => Object.fromEntries(names.map((name) => [name, []]));
const DETAILS = { // what is not given is not there: nothing moves by itself
  known: "", duration: 0, speed: 1, times: [0], start_view: "mission", floor: null, relief: null, witness: null, live: null,
  ...none("speeds", "labels", "phases", "faults", "health", "alarms", "trails", "arrows", "legend", "readouts", "annotations", "joints"),
  ...given,
};
const ADDRESS = new URLSearchParams(location.hash.slice(1));

// Where the processor draws, for want of graphics, edges and shadows are left rough, but in a film.
function rendererIn(pane) {
  const canvas = document.createElement("canvas"), plain = canvas.getContext("webgl2", {alpha: true, antialias: false, stencil: true});
  const named = plain?.getExtension("WEBGL_debug_renderer_info");
  const by = named ? plain.getParameter(named.UNMASKED_RENDERER_WEBGL) : "";
  const rough = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(by) && !ADDRESS.has("film");
  if (!rough) plain?.getExtension("WEBGL_lose_context")?.loseContext();
  const made = new THREE.WebGLRenderer(rough ? {canvas, context: plain} : {antialias: true, alpha: true});
  made.shadowMap.enabled = true;
  made.shadowMap.type = rough ? THREE.BasicShadowMap : THREE.PCFSoftShadowMap;
  pane.appendChild(made.domElement);
  return {renderer: made, rough};
}

const {renderer, rough} = rendererIn(byId("meshcat-pane"));
const viewer = new MeshCat.Viewer(byId("meshcat-pane"), false, renderer); // drawn by `advance`, once all is there
window.onload = null; // which would draw all again
const WATER = {light: 0x7cc4d8, haze: 0x2a7089, dark: 0x0a2c42};
const PHASE_COLOURS = ["#2b7bba", "#c8741a", "#2c9467", "#a8518a", "#6b7680", "#8a7a1f"];
const toThree = (p) => new THREE.Vector3(p[0], p[2], -p[1]);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const nodeAt = (path) => viewer.scene_tree.find(path).object;

const reach = Math.max(...DETAILS.points.map((p) => Math.hypot(...p)), DETAILS.size) + DETAILS.size;

// A dome whose colour at the horizon is the haze's, so that the far sea floor melts into it.
function fillWater() {
  const haze = new THREE.Color(WATER.haze), dome = new THREE.SphereGeometry(14 * reach, 48, 32), colours = [];
  for (let i = 0; i < dome.attributes.position.count; i++) {
    const up = dome.attributes.position.getY(i) / (14 * reach);
    const colour = haze.clone().lerp(new THREE.Color(up > 0 ? WATER.light : WATER.dark), Math.min(1, 1.6 * Math.abs(up)));
    colours.push(colour.r, colour.g, colour.b);
  }
  dome.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
  const paint = {vertexColors: true, side: THREE.BackSide, fog: false, depthWrite: false};
  const mesh = new THREE.Mesh(dome, new THREE.MeshBasicMaterial(paint));
  mesh.rotation.x = Math.PI / 2;
  viewer.set_object(["Water"], mesh);
  viewer.scene.fog = new THREE.Fog(WATER.haze, 1.8 * reach, 8 * reach);
  viewer.hide_background();
  for (const name of ["Grid", "Axes"]) viewer.set_property([name], "visible", false);
}

function light() {
  for (const name of ["PointLightNegativeX", "PointLightPositiveX", "FillLight", "AmbientLight", "SpotLight"])
    viewer.set_property(["Lights", name], "visible", false);
  viewer.set_object(["Lights", "Water"], new THREE.HemisphereLight(0xcfefff, 0x7d8578, 0.7));
  const sun = new THREE.DirectionalLight(0xfff6e0, 0.72);
  const d = DETAILS.direction;
  sun.position.set(2 * d[0] - 0.9 * d[1], 2 * d[1] + 0.9 * d[0], 4.5).normalize().multiplyScalar(4 * reach);
  sun.castShadow = true;
  sun.shadow.mapSize.setScalar(rough ? 1024 : 2048);
  Object.assign(sun.shadow.camera, {left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 9 * reach});
  sun.shadow.bias = -0.0008;
  viewer.set_object(["Lights", "Sun"], sun);
  const fill = new THREE.DirectionalLight(0x9fd4ff, 0.25);
  fill.position.set(-d[0], -d[1], 0.6);
  viewer.set_object(["Lights", "Fill"], fill);
}

function sandTexture(metres) {
  const n = rough ? 512 : 1024, canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  canvas.width = canvas.height = n;
  const image = context.createImageData(n, n);
  let seed = 7;
  const random = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
  // Ripples sin(3 x + sin y) + sin(2 y - x) around the tile, by sines of sums: none is worked out for a pixel.
  const table = (of, times) => Float64Array.from({length: n}, (_, k) => of((2 * Math.PI * times * k) / n));
  const [sin1, cos1, sin3, cos3] = [1, 3].flatMap((times) => [table(Math.sin, times), table(Math.cos, times)]);
  for (let row = 0, i = 0; row < n; row++) {
    const a = 2 * Math.PI * sin1[row], b = (4 * Math.PI * row) / n;
    const [sinA, cosA, sinB, cosB] = [Math.sin(a), Math.cos(a), Math.sin(b), Math.cos(b)];
    for (let k = 0; k < n; k++, i += 4) {
      const wave = sin3[k] * cosA + cos3[k] * sinA + sinB * cos1[k] - cosB * sin1[k];
      const shade = 1 + 0.05 * wave + 0.13 * (random() - 0.5);
      image.data[i] = 148 * shade;
      image.data[i + 1] = 152 * shade;
      image.data[i + 2] = 134 * shade;
      image.data[i + 3] = 255;
    }
  }
  context.putImageData(image, 0, 0);
  context.strokeStyle = "rgba(20, 44, 54, 0.5)";
  context.lineWidth = n / 640;
  for (let k = 0; k <= metres; k++) {
    const x = (k * n) / metres;
    context.beginPath();
    context.moveTo(x, 0); context.lineTo(x, n); context.moveTo(0, x); context.lineTo(n, x);
    context.stroke();
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = rough ? 2 : renderer.capabilities.getMaxAnisotropy();
  return texture;
}

function layFloor() {
  if (DETAILS.floor === null) return;
  const tile = 8, tiles = 2 * Math.ceil((11 * reach) / tile), texture = sandTexture(tile);
  texture.repeat.set(tiles, tiles);
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(tiles * tile, tiles * tile),
    new THREE.MeshLambertMaterial({map: texture}));
  floor.position.z = DETAILS.floor;
  floor.receiveShadow = true;
  viewer.set_object(["Sea floor"], floor);
  if (DETAILS.relief !== null) layRelief(DETAILS.relief, sandTexture(tile), tile);
}

// A floor that is not flat: a grid of measured heights, a little above the plane that goes on around it.
function layRelief({x, y, z}, texture, tile) {
  const geometry = new THREE.PlaneGeometry(1, 1, x.length - 1, y.length - 1);
  const place = geometry.attributes.position, uv = geometry.attributes.uv;
  y.forEach((v, row) => x.forEach((u, column) => {
    const k = (y.length - 1 - row) * x.length + column;
    place.setXYZ(k, u, v, z[row][column] + 0.01);
    uv.setXY(k, u / tile, v / tile);
  }));
  geometry.computeVertexNormals();
  const relief = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({map: texture}));
  relief.castShadow = relief.receiveShadow = true;
  viewer.set_object(["Sea floor relief"], relief);
}

// Trails, goals, ghosts and the altimeter's beam are annotations: they cast no shadow. Materials that differ where nothing is
// seen of it would each be a program that takes long to compile: flat colours know no shadow, and bodies one sees through are closed.
function simplify() {
  for (const name of DETAILS.annotations)
    nodeAt(["meshcat", "scene", name]).traverse((object) => { object.castShadow = object.receiveShadow = false; });
  viewer.scene.traverse((object) => {
    const {material} = object;
    if (!material || material.side !== THREE.DoubleSide || !(material.isMeshBasicMaterial || material.transparent)) return;
    material.side = THREE.FrontSide;
    object.receiveShadow = object.receiveShadow && !material.isMeshBasicMaterial;
  });
}

// A page has room for 16 scenes that hold a context of WebGL: who is out of sight leaves it, and takes it again when seen.
function leaveContextUnseen() {
  const extension = renderer.getContext().getExtension("WEBGL_lose_context");
  let seen = true, lost = false;
  const settle = () => {
    if (seen === !lost || !extension) return;
    if (lost) extension.restoreContext(); else extension.loseContext();
  };
  renderer.domElement.addEventListener("webglcontextlost", () => { lost = true; setTimeout(settle); });
  renderer.domElement.addEventListener("webglcontextrestored", () => { lost = false; viewer.set_dirty(); settle(); });
  new IntersectionObserver((changes) => { seen = changes.pop().isIntersecting; settle(); }).observe(byId("meshcat-pane"));
}

"use strict";
// Drives meshcat's viewer: light, water, sea floor, camera, time line. World axes of the data: z up; three.js: y up.
const THREE = MeshCat.THREE;
const byId = (id) => document.getElementById(id);
const [COMMANDS, DETAILS] = ["commands", "details"].map((id) => JSON.parse(byId(id).textContent));
const viewer = new MeshCat.Viewer(byId("meshcat-pane"));
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
  sun.shadow.mapSize.set(2048, 2048);
  Object.assign(sun.shadow.camera, {left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 9 * reach});
  sun.shadow.bias = -0.0008;
  viewer.set_object(["Lights", "Sun"], sun);
  const fill = new THREE.DirectionalLight(0x9fd4ff, 0.25);
  fill.position.set(-d[0], -d[1], 0.6);
  viewer.set_object(["Lights", "Fill"], fill);
}

function sandTexture(metres) {
  const n = 1024, canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  canvas.width = canvas.height = n;
  const image = context.createImageData(n, n);
  let seed = 7;
  const random = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
  const wave = (x, y) => Math.sin(6.2832 * (3 * x + Math.sin(6.2832 * y))) + Math.sin(6.2832 * (2 * y - x));
  for (let i = 0; i < n * n; i++) {
    const shade = 1 + 0.05 * wave((i % n) / n, Math.floor(i / n) / n) + 0.13 * (random() - 0.5);
    image.data.set([148 * shade, 152 * shade, 134 * shade, 255], 4 * i);
  }
  context.putImageData(image, 0, 0);
  context.strokeStyle = "rgba(20, 44, 54, 0.5)";
  context.lineWidth = 1.6;
  for (let k = 0; k <= metres; k++) {
    const x = (k * n) / metres;
    context.beginPath();
    context.moveTo(x, 0); context.lineTo(x, n); context.moveTo(0, x); context.lineTo(n, x);
    context.stroke();
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = viewer.renderer.capabilities.getMaxAnisotropy();
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

// Trails, goals and the altimeter's beam are annotations: they cast no shadow.
function dropShadowsOfAnnotations() {
  for (const name of ["trails", "goals", "beam"])
    nodeAt(["meshcat", "scene", name]).traverse((object) => { object.castShadow = object.receiveShadow = false; });
}

// Camera: "mission" frames everything, "vehicle" and "tool" travel along.
const camera = viewer.camera, controls = viewer.controls;
const direction = new THREE.Vector3();
const view = {name: "mission", anchor: new THREE.Vector3()};

function project(points, target, distance) {
  camera.position.copy(target).addScaledVector(direction, distance);
  camera.lookAt(target);
  camera.updateMatrixWorld();
  return new THREE.Box3().setFromPoints(points.map((p) => p.clone().project(camera)));
}

function distanceThatFits(points, target) {
  let near = DETAILS.size, far = 20 * reach;
  for (let i = 0; i < 24; i++) {
    const middle = (near + far) / 2, box = project(points, target, middle);
    const fits = box.min.x > -0.92 && box.max.x < 0.92 && box.min.y > -0.76 && box.max.y < 0.86 && box.max.z < 1;
    if (fits) far = middle; else near = middle;
  }
  return far;
}

// Shift the target until the points sit in the middle of the free part of the picture.
function frame(points) {
  const target = new THREE.Box3().setFromPoints(points).getCenter(new THREE.Vector3());
  for (let i = 0; i < 4; i++) {
    const distance = distanceThatFits(points, target), box = project(points, target, distance);
    const half = distance * Math.tan((camera.fov * Math.PI) / 360);
    const right = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0);
    const up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
    target.addScaledVector(right, (half * camera.aspect * (box.min.x + box.max.x)) / 2);
    target.addScaledVector(up, half * ((box.min.y + box.max.y) / 2 - 0.05));
  }
  return {target, distance: distanceThatFits(points, target)};
}

function missionPoints() {
  const r = 0.7 * DETAILS.size, offsets = [[r, 0, 0], [-r, 0, 0], [0, r, 0], [0, -r, 0], [0, 0, r]];
  return DETAILS.points.flatMap((p) => offsets.map((o) => toThree(p.map((x, i) => x + o[i]))));
}

function anchorOf(name) {
  return nodeAt(name === "tool" ? DETAILS.hand : DETAILS.body).getWorldPosition(new THREE.Vector3());
}

function look(name) {
  view.name = name;
  camera.fov = 38;
  camera.near = 0.05;
  camera.far = 40 * reach;
  camera.aspect = window.innerWidth / window.innerHeight;
  camera.updateProjectionMatrix();
  direction.copy(toThree(name === "tool" ? DETAILS.close_direction : DETAILS.direction)).normalize();
  const close = {vehicle: 3.6, tool: 2.1};
  const {target, distance} = name === "mission" ? frame(missionPoints())
    : {target: anchorOf(name), distance: close[name] * DETAILS.size};
  view.anchor.copy(target);
  camera.position.copy(target).addScaledVector(direction, distance);
  controls.target.copy(target);
  controls.maxDistance = 5 * reach;
  controls.update();
  for (const button of byId("views").children) button.classList.toggle("on", button.dataset.view === name);
  viewer.set_dirty();
}

function follow() {
  if (view.name === "mission") return;
  const now = anchorOf(view.name), step = now.clone().sub(view.anchor);
  camera.position.add(step);
  controls.target.add(step);
  view.anchor.copy(now);
}

// Time
const clock = {t: 0, playing: true, speed: DETAILS.speed, last: null};
const phaseAt = (t) => DETAILS.phases.filter((p) => p.start <= t + 1e-9).pop() || DETAILS.phases[0];

function lastBefore(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + 1e-9) low = middle + 1; else high = middle;
  }
  return Math.max(0, low - 1);
}

const digits = (value) => (value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(1) : value.toFixed(3));

// Names are data: they become text, never markup.
function showReadouts() {
  const phase = phaseAt(clock.t), [times, ...rows] = DETAILS.readouts, shown = byId("readouts");
  shown.replaceChildren();
  addElement(shown, "div", `${phase.name} ${phase.title}`, {className: "phase"});
  for (const fault of DETAILS.faults)
    if (fault.start <= clock.t + 1e-9 && (clock.t < fault.end || !fault.ended))
      addElement(shown, "div", `fault: ${fault.name}`, {className: "fault"});
  const k = times ? lastBefore(times.values, clock.t) : 0;
  for (const row of rows) {
    const value = row.values[k], line = addElement(shown, "div", "");
    addElement(line, "span", row.label);
    addElement(line, "span", value === null ? "-" : `${digits(value)} ${row.unit}`);
  }
}

function showTime(t) {
  clock.t = Math.min(Math.max(t, 0), DETAILS.duration);
  viewer.animator.seek(clock.t);
  viewer.scene.updateMatrixWorld(true);
  for (const trail of DETAILS.trails) {
    const mesh = nodeAt([...trail.path, "<object>"]);
    mesh.geometry.setDrawRange(0, 36 * lastBefore(trail.t, clock.t));
  }
  byId("cursor").style.left = `${(100 * clock.t) / DETAILS.duration}%`;
  byId("clock").textContent = `${clock.t.toFixed(1)} / ${DETAILS.duration.toFixed(1)} s`;
  showReadouts();
  follow();
  viewer.set_dirty();
}

function setPlaying(on) {
  clock.playing = on;
  clock.last = null;
  byId("play").textContent = on ? "\u275A\u275A" : "\u25B6";
}

function advance(now) {
  if (clock.playing) {
    const step = clock.last === null ? 0 : (clock.speed * (now - clock.last)) / 1000;
    clock.last = now;
    showTime(clock.t >= DETAILS.duration ? 0 : clock.t + step);
    if (clock.t >= DETAILS.duration) setPlaying(false);
  }
  placeLabels();
  requestAnimationFrame(advance);
}

function placeLabels() {
  const spans = byId("labels").children;
  DETAILS.labels.forEach((label, i) => {
    const [x, y, z] = label.position, s = toThree([x, y, z - 0.08]).project(camera);
    spans[i].style.display = s.z < 1 ? "" : "none";
    spans[i].style.left = `${50 * (s.x + 1)}%`;
    spans[i].style.top = `${50 * (1 - s.y)}%`;
  });
}

// Controls
function labelPhases() {
  [...byId("timeline").querySelectorAll(".phase")].forEach((element, i) => {
    element.textContent = element.title;
    if (element.scrollWidth > element.clientWidth) element.textContent = DETAILS.phases[i].name;
  });
}

function addElement(parent, tag, text, properties) {
  const element = Object.assign(document.createElement(tag), {textContent: text}, properties);
  parent.appendChild(element);
  return element;
}

function buildControls() {
  byId("scenario").textContent = DETAILS.scenario;
  byId("robot").textContent = DETAILS.floor === null ? DETAILS.robot : `${DETAILS.robot}, grid 1 m`;
  for (const label of DETAILS.labels) addElement(byId("labels"), "span", label.text);
  for (const phase of DETAILS.phases) {
    const share = (100 * (phase.end - phase.start)) / DETAILS.duration;
    const label = `${phase.name} ${phase.title}`;
    const element = addElement(byId("timeline"), "div", label, {className: "phase", title: label});
    element.style.left = `${(100 * phase.start) / DETAILS.duration}%`;
    element.style.width = `${share}%`;
    element.style.background = PHASE_COLOURS[phase.index % PHASE_COLOURS.length];
  }
  for (const fault of DETAILS.faults) {
    const element = addElement(byId("timeline"), "div", "", {className: "fault", title: `fault: ${fault.name}`});
    element.style.left = `${(100 * fault.start) / DETAILS.duration}%`;
    element.style.width = `${(100 * (fault.end - fault.start)) / DETAILS.duration}%`;
  }
  for (const speed of DETAILS.speeds) addElement(byId("speed"), "option", `\u00D7${speed}`, {value: speed});
  byId("speed").value = clock.speed;
  byId("speed").onchange = (event) => { clock.speed = Number(event.target.value); };
  for (const name of DETAILS.views) {
    const button = addElement(byId("views"), "button", name, {title: `camera: ${name}`, onclick: () => look(name)});
    button.dataset.view = name;
  }
  byId("play").onclick = () => setPlaying(!clock.playing);
  window.addEventListener("keydown", (event) => {
    if (event.code === "Space") { event.preventDefault(); setPlaying(!clock.playing); }
  });
  const timeline = byId("timeline");
  const scrub = (event) => {
    const box = timeline.getBoundingClientRect();
    setPlaying(false);
    showTime((DETAILS.duration * (event.clientX - box.left)) / box.width);
  };
  timeline.onpointerdown = (event) => { timeline.setPointerCapture(event.pointerId); scrub(event); };
  timeline.onpointermove = (event) => { if (event.buttons) scrub(event); };
}

// scene.html#t=12.5&view=tool opens paused at that time with that camera.
function openAtAddress() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  if (wanted.has("t")) { setPlaying(false); showTime(Number(wanted.get("t"))); }
  if (DETAILS.views.includes(wanted.get("view"))) look(wanted.get("view"));
}

fillWater();
light();
layFloor();
for (const command of COMMANDS) viewer.handle_command_bytearray(bytes(command));
for (const action of viewer.animator.actions) action.play();
dropShadowsOfAnnotations();
viewer.animator.folder.domElement.style.display = "none";
buildControls();
setPlaying(true);
showTime(0);
viewer.set_3d_pane_size();
look(DETAILS.start_view);
openAtAddress();
labelPhases();
window.addEventListener("resize", () => { labelPhases(); if (view.name === "mission") look("mission"); });
requestAnimationFrame(advance);

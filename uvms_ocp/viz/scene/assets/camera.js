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


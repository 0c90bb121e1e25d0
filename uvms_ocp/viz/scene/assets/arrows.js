// What moves with the vehicle or with the nearest points: arrows, and lines to obstacles that are near.
const UP = new THREE.Vector3(0, 1, 0);
const arrows = [], lines = [];

// A flat colour that water does not dim, of a cylinder of length 1 along y from the origin.
function rod(colour, top, bottom) {
  const shape = new THREE.CylinderGeometry(top, bottom, 1, 14);
  shape.translate(0, 0.5, 0);
  return new THREE.Mesh(shape, new THREE.MeshBasicMaterial({color: colour, fog: false}));
}

function buildArrows() {
  for (const group of DETAILS.arrows) for (const {at, vectors} of group.arrows) {
    const shaft = rod(group.colour, 1, 1), head = rod(group.colour, 0, 1), node = new THREE.Group();
    node.add(shaft, head);
    node.position.set(...at);
    nodeAt(DETAILS.body).add(node);
    arrows.push({group, vectors, node, shaft, head});
  }
}

// The value at a time between two moments; null where either is not known.
function between(times, values, t) {
  const k = lastBefore(times, t), next = Math.min(k + 1, times.length - 1);
  if (values[k] === null || values[next] === null) return null;
  const share = next === k ? 0 : Math.min(1, (t - times[k]) / (times[next] - times[k]));
  const mix = (a, b) => a + share * (b - a);
  return Array.isArray(values[k]) ? values[k].map((a, i) => mix(a, values[next][i])) : mix(values[k], values[next]);
}

function showArrows(t) {
  const thick = 0.014 * DETAILS.size;
  for (const {group, vectors, node, shaft, head} of arrows) {
    const vector = new THREE.Vector3(...between(DETAILS.times, vectors, t));
    const length = Math.min(group.scale * vector.length(), group.longest);
    node.visible = group.shown && length > thick;
    if (!node.visible) continue;
    const tip = Math.min(0.45 * length, 7 * thick);
    node.quaternion.setFromUnitVectors(UP, vector.normalize());
    shaft.scale.set(thick, length - tip, thick);
    head.position.y = length - tip;
    head.scale.set(2.6 * thick, tip, 2.6 * thick);
  }
}

function buildLines() {
  if (DETAILS.witness === null) return;
  const group = new THREE.Group();
  for (const obstacle of DETAILS.witness.obstacles) {
    const node = rod(DETAILS.witness.colour, 1, 1), text = addElement(byId("labels"), "span", "", {className: "distance"});
    group.add(node);
    lines.push({obstacle, node, text, middle: new THREE.Vector3()});
  }
  viewer.set_object(["Distances"], group);
}

function showLines(t) {
  const thick = 0.008 * DETAILS.size;
  for (const {obstacle, node, text, middle} of lines) {
    const k = lastBefore(DETAILS.witness.t, t), [x, y, z, u, v, w] = obstacle.line[k];
    const way = new THREE.Vector3(u - x, v - y, w - z), length = way.length();
    node.visible = DETAILS.witness.shown && length > 1e-4;
    text.textContent = node.visible ? `${digits(obstacle.distance[k])} m` : "";
    if (!node.visible) continue;
    middle.set((x + u) / 2, (y + v) / 2, (z + w) / 2);
    node.position.set(x, y, z);
    node.quaternion.setFromUnitVectors(UP, way.normalize());
    node.scale.set(thick, length, thick);
  }
}

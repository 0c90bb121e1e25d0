// Links and the goal of a robot that stands still are dragged: a joint turns or slides below the pointer, the vehicle and the goal
// move in the plane of the picture. All in W, whose origin and axes are those of the robot's node.
const robotNode = () => nodeAt(["meshcat", "scene", "robot"]);
let goal = null;

// A ball and its axes, in red, green and blue.
function buildGoal() {
  if (!DETAILS.live?.goal) return;
  const size = 0.035 * DETAILS.size, [x, y, z, ...turn] = DETAILS.live.goal;
  goal = new THREE.Group();
  goal.add(new THREE.Mesh(new THREE.SphereGeometry(size, 20, 14), new THREE.MeshBasicMaterial({color: 0xf24d1a, fog: false})));
  for (const [colour, axis] of [["#e03131", [1, 0, 0]], ["#2f9e44", [0, 1, 0]], ["#1c7ed6", [0, 0, 1]]]) {
    const shaft = rod(colour, 0.16 * size, 0.16 * size);
    shaft.scale.y = 4 * size;
    shaft.quaternion.setFromUnitVectors(UP, new THREE.Vector3(...axis));
    goal.add(shaft);
  }
  for (const {material} of goal.children) material.depthTest = false; // a handle is seen, and grasped, through what is before it
  for (const part of goal.children) part.renderOrder = 1;
  goal.position.set(x, y, z);
  goal.quaternion.set(...turn);
  nodeAt(["meshcat", "scene"]).add(goal);
  tell();
}

// What Python is told: the arguments of `Robot.configuration`, and the pose of the goal.
function tell() {
  if (DETAILS.live?.goal && window.parent !== window)
    window.parent.postMessage({q: configuration(), goal: [...goal.position.toArray(), ...goal.quaternion.toArray()]}, "*");
}

function rayOf(event) {
  const box = renderer.domElement.getBoundingClientRect(), caster = new THREE.Raycaster();
  const at = {x: (2 * (event.clientX - box.left)) / box.width - 1, y: 1 - (2 * (event.clientY - box.top)) / box.height};
  caster.setFromCamera(at, camera);
  return caster;
}

const inW = (ray) => ray.clone().applyMatrix4(robotNode().matrixWorld.clone().invert());

// What is below the pointer: the goal, or the joint that moves the link there; none where a joint cannot be moved.
function grasp(event) {
  const caster = rayOf(event), [handle] = goal ? caster.intersectObject(goal, true) : [];
  const [hit] = handle ? [handle] : caster.intersectObject(robotNode(), true);
  if (!hit) return null;
  const point = robotNode().worldToLocal(hit.point.clone()), chain = [];
  if (handle) return {point, move: (step) => goal.position.add(step)};
  for (let node = hit.object; node; node = node.parent) chain.push(node);
  const joint = DETAILS.joints.find(({path}) => chain.includes(nodeAt(path)));
  const moving = joint?.follows ? DETAILS.joints[joint.follows[0]] : joint;
  if (moving?.kind === "free") return {point, joint, move: (step) => step.toArray().forEach((x, i) => set(moving, i, moving.values[i] + x))};
  return ["turn", "slide"].includes(moving?.kind) ? {point, joint: moving} : null;
}

function set(joint, i, value) {
  joint.values[i] = Math.min(Math.max(value, joint.ranges[i][0]), joint.ranges[i][1]);
}

// The plane in which the pointer moves what it holds: that of the picture, or the one in which the joint's link turns.
function planeOf({point, joint, move}) {
  const away = inW(new THREE.Ray(camera.position, camera.getWorldDirection(new THREE.Vector3()))).direction;
  if (move || joint.kind === "slide") return new THREE.Plane().setFromNormalAndCoplanarPoint(away, point);
  const {axis} = placeOf(joint);
  return new THREE.Plane().setFromNormalAndCoplanarPoint(Math.abs(axis.dot(away)) > 0.15 ? axis : away, point);
}

// Where a joint is in W, and along what it moves.
function placeOf(joint) {
  const node = nodeAt(joint.path), axis = new THREE.Vector3(...joint.axis).applyQuaternion(node.quaternion).normalize();
  return {centre: node.position, axis};
}

function moveJoint(joint, from, to) {
  const {centre, axis} = placeOf(joint);
  if (joint.kind === "slide") return set(joint, 0, joint.values[0] + to.clone().sub(from).dot(axis));
  const [a, b] = [from, to].map((p) => p.clone().sub(centre).projectOnPlane(axis));
  if (Math.min(a.length(), b.length()) > 1e-3) set(joint, 0, joint.values[0] + Math.atan2(a.clone().cross(b).dot(axis), a.dot(b)));
}

function listenToPointer() {
  const pane = byId("meshcat-pane");
  let held = null, plane = null;
  const start = (event) => {
    held = event.button === 0 ? grasp(event) : null;
    if (!held) return;
    plane = planeOf(held);
    controls.enabled = false;
    pane.setPointerCapture(event.pointerId);
  };
  const drag = (event) => {
    if (!held) return;
    const to = inW(rayOf(event).ray).intersectPlane(plane, new THREE.Vector3());
    if (!to) return;
    if (held.move) held.move(to.clone().sub(held.point)); else moveJoint(held.joint, held.point, to);
    held.point = to;
    if (held.joint) poseJoints();
    viewer.set_dirty();
    tell();
  };
  pane.addEventListener("pointerdown", start, {capture: true});
  pane.addEventListener("pointermove", drag);
  for (const end of ["pointerup", "pointercancel"])
    pane.addEventListener(end, () => { held = null; controls.enabled = true; });
}

// A robot that stands still: sliders for its joints, and the words of Python that give the same configuration.
const AXES = ["x", "y", "z", "roll", "pitch", "yaw"];
const matrixOf = ([x, y, z, ...turn]) => new THREE.Matrix4().compose(
  new THREE.Vector3(x, y, z), new THREE.Quaternion(...turn), new THREE.Vector3(1, 1, 1));

// By what a joint moves the next link, at its values.
function motionOf(joint) {
  const axis = new THREE.Vector3(...(joint.axis || [0, 0, 0])), [leader, scale, offset] = joint.follows || [];
  const value = joint.follows ? scale * DETAILS.joints[leader].values[0] + offset : joint.values[0];
  if (joint.kind === "turn") return new THREE.Matrix4().makeRotationAxis(axis, value);
  if (joint.kind === "slide") return new THREE.Matrix4().makeTranslation(...axis.multiplyScalar(value).toArray());
  if (joint.kind === "held") return matrixOf(joint.pose);
  const [x, y, z, roll, pitch, yaw] = joint.values;
  return new THREE.Matrix4().makeRotationFromEuler(new THREE.Euler(roll, pitch, yaw, "ZYX")).setPosition(x, y, z);
}

function poseJoints() {
  const poses = [];
  for (const joint of DETAILS.joints) {
    const before = joint.parent < 0 ? new THREE.Matrix4() : poses[joint.parent].clone();
    const pose = before.multiply(matrixOf(joint.placement)).multiply(motionOf(joint)), node = nodeAt(joint.path);
    poses.push(pose);
    pose.decompose(node.position, node.quaternion, node.scale);
  }
  viewer.scene.updateMatrixWorld(true);
  byId("words").textContent = wordsOfPython();
  for (const show of sliders) show();
  follow();
  viewer.set_dirty();
}

// The arguments of `Robot.configuration`.
function configuration() {
  const free = DETAILS.joints.find(({kind}) => kind === "free"), found = {};
  if (free) Object.assign(found, {position: free.values.slice(0, 3), rpy: free.values.slice(3)});
  const own = DETAILS.joints.filter(({kind, follows}) => !follows && (kind === "turn" || kind === "slide"));
  if (own.length) found.joints = own.map(({values}) => values[0]);
  return found;
}

function wordsOfPython() {
  const list = (values) => `(${values.map((x) => Number(x.toFixed(4))).join(", ")}${values.length === 1 ? "," : ""})`;
  const parts = Object.entries(configuration()).map(([name, values]) => `${name}=${list(values)}`);
  return `q = robot.configuration(${parts.join(", ")})`;
}

const sliders = []; // each shows its value

function addSlider(label, unit, [lower, upper], values, i) {
  const row = addElement(byId("joints"), "label", ""), shown = (x) => `${(Math.round(100 * x) / 100 + 0).toFixed(2)} ${unit}`;
  addElement(row, "span", label);
  const properties = {type: "range", min: lower, max: upper, step: (upper - lower) / 1000, title: label};
  const slider = addElement(row, "input", "", properties), value = addElement(row, "span", "");
  sliders.push(() => { slider.value = values[i]; value.textContent = shown(values[i]); });
  slider.oninput = () => { values[i] = Number(slider.value); poseJoints(); tell(); };
}

function buildSliders() {
  if (!DETAILS.joints.length) return;
  for (const {kind, name, ranges, values, follows} of DETAILS.joints) {
    if (kind === "free") AXES.forEach((axis, i) => addSlider(axis, i < 3 ? "m" : "rad", ranges[i], values, i));
    if (!follows && (kind === "turn" || kind === "slide")) addSlider(name, kind === "turn" ? "rad" : "m", ranges[0], values, 0);
  }
  byId("posture").open = window.innerWidth > 760;
  poseJoints();
  buildGoal();
  listenToPointer();
}

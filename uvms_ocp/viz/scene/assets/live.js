// A run that goes on: frames come as they are made, and what came last is shown.
function showFrame({t, poses, phase, values, joints}) {
  if (joints) {
    DETAILS.joints.forEach((joint, j) => joint.values.splice(0, joint.values.length, ...joints[j]));
    poseJoints();
    return;
  }
  DETAILS.live.nodes.forEach((path, j) => {
    const node = nodeAt(path), [x, y, z, ...turn] = poses[j];
    node.position.set(x, y, z);
    node.quaternion.set(...turn);
  });
  viewer.scene.updateMatrixWorld(true);
  DETAILS.phases = phase === null ? [] : [DETAILS.live.phases[phase]];
  DETAILS.readouts.forEach((row, i) => { row.values = [i < values.length ? values[i] : null]; });
  byId("clock").textContent = `${t.toFixed(1)} s`;
  showReadouts();
  follow();
  viewer.set_dirty();
}

function listen() {
  if (!DETAILS.live) return;
  document.body.classList.add("live");
  byId("clock").textContent = DETAILS.joints.length ? "" : "not begun";
  if (!location.protocol.startsWith("http")) { // in a notebook, whose page hands frames on
    window.addEventListener("message", ({data, source}) => { if (source === window.parent) showFrame(data); });
    return;
  }
  const frames = new EventSource("frames");
  frames.onmessage = (event) => showFrame(JSON.parse(event.data));
  frames.addEventListener("end", () => frames.close());
  frames.onerror = () => frames.close();
}

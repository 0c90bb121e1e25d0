function placeLabels() {
  const taken = [];
  DETAILS.labels.forEach(({position: [x, y, z]}, i) => placeLabel(byId("names").children[i], [x, y, z - 0.08], taken));
  for (const {text, node, middle} of lines)
    if (node.visible) placeLabel(text, middle.toArray(), taken); else text.style.display = "none";
}

// Below its place, or a line lower where another name stands already.
function placeLabel(span, place, taken) {
  const s = toThree(place).project(camera), width = span.offsetWidth || 80, height = 22;
  const edge = width / 2 + 4, x = Math.min(Math.max((window.innerWidth * (s.x + 1)) / 2, edge), window.innerWidth - edge);
  let y = (window.innerHeight * (1 - s.y)) / 2;
  const hit = () => taken.find((other) => Math.abs(other.x - x) < (other.width + width) / 2 && Math.abs(other.y - y) < height);
  for (let tries = 0; tries < 4 && hit(); tries++) y = hit().y + height;
  taken.push({x, y, width});
  span.style.display = s.z < 1 && Math.abs(s.x) < 1 ? "" : "none";
  span.style.left = `${x}px`;
  span.style.top = `${y}px`;
}

function buildControls() {
  byId("scenario").textContent = DETAILS.scenario;
  byId("robot").textContent = DETAILS.floor === null ? DETAILS.robot : `${DETAILS.robot}, grid 1 m`;
  for (const label of DETAILS.labels) addElement(byId("names"), "span", label.text, {className: label.kind});
  for (const speed of DETAILS.speeds) addElement(byId("speed"), "option", `\u00D7${speed}`, {value: speed});
  byId("speed").value = clock.speed;
  byId("speed").onchange = (event) => { clock.speed = Number(event.target.value); };
  for (const name of DETAILS.views) {
    const button = addElement(byId("views"), "button", name, {title: `camera: ${name}`, onclick: () => look(name)});
    button.dataset.view = name;
  }
  byId("play").onclick = () => setPlaying(!clock.playing);
  document.body.classList.toggle("still", DETAILS.duration === 0);
  document.body.classList.toggle("posed", DETAILS.joints.length > 0);
}

const KEYS = {
  Space: () => setPlaying(!clock.playing),
  ArrowLeft: () => { setPlaying(false); showTime(clock.t - 1); },
  ArrowRight: () => { setPlaying(false); showTime(clock.t + 1); },
};
window.addEventListener("keydown", (event) => {
  if (!(event.code in KEYS) || event.target.tagName === "INPUT") return;
  event.preventDefault();
  KEYS[event.code]();
});

// scene.html#t=12.5&view=tool opens paused at that time with that camera.
function openAtAddress() {
  if (ADDRESS.has("t")) { setPlaying(false); showTime(Number(ADDRESS.get("t"))); }
  if (DETAILS.views.includes(ADDRESS.get("view"))) look(ADDRESS.get("view"));
  document.body.classList.toggle("film", ADDRESS.has("film"));
}

fillWater();
light();
layFloor();
for (const command of COMMANDS) viewer.handle_command_bytearray(bytes(command));
for (const action of viewer.animator.actions) action.play();
simplify();
buildControls();
buildArrows();
buildLines();
buildLegend();
buildTimeLine();
buildSliders();
setPlaying(true);
showTime(0);
viewer.set_3d_pane_size();
look(DETAILS.start_view);
openAtAddress();
labelPhases();
listen();
leaveContextUnseen();
window.addEventListener("resize", () => { labelPhases(); if (view.name === "mission") look("mission"); });
requestAnimationFrame(advance);

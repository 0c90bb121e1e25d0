// Time: what is shown at a moment, and the bar that leads to any.
const clock = {t: 0, playing: true, speed: DETAILS.speed, last: null, all: false};
const ALARM_STAYS = 5; // [s] of the run
const STATE_COLOURS = {suspect: "#ffc14d", lost: "#ff5a36", fault: "#ff5a36", alarm: "#fff27a"};
const phaseAt = (t) => DETAILS.phases.filter((p) => p.start <= t + 1e-9).pop() || DETAILS.phases[0];

function lastBefore(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + 1e-9) low = middle + 1; else high = middle;
  }
  return Math.max(0, low - 1);
}

// Names are data: they become text, never markup.
function showReadouts() {
  const phase = phaseAt(clock.t), panel = byId("readouts"), now = clock.t + 1e-9;
  panel.replaceChildren();
  if (!phase) return;
  addElement(panel, "div", `${phase.name} ${phase.title}`, {className: "phase"});
  for (const fault of DETAILS.faults)
    if (fault.start <= now && (clock.t < fault.end || !fault.ended))
      addElement(panel, "div", `fault: ${fault.name}`, {className: "fault"});
  for (const spell of DETAILS.health)
    if (spell.start <= now && clock.t < spell.end)
      addElement(panel, "div", `${spell.channel} ${spell.state}`, {className: spell.state});
  const alarm = DETAILS.alarms.filter(({t}) => t <= now && clock.t < t + ALARM_STAYS).pop();
  if (alarm) addElement(panel, "div", alarm.text, {className: "alarm"});
  showValues(panel, phase);
}

function showValues(panel, phase) {
  const k = lastBefore(DETAILS.times, clock.t), on = new Set(phase.tasks);
  const wanted = DETAILS.readouts.filter((row) => clock.all || !on.size || !row.task || on.has(row.task));
  if (DETAILS.known && wanted.length) addElement(panel, "div", DETAILS.known, {className: "known"});
  for (const row of wanted) {
    const value = row.values[k], line = addElement(panel, "div", "");
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
  showArrows(clock.t);
  showLines(clock.t);
  if (DETAILS.duration) byId("cursor").style.left = `${(100 * clock.t) / DETAILS.duration}%`;
  byId("clock").textContent = `${clock.t.toFixed(1)} / ${DETAILS.duration.toFixed(1)} s`;
  showReadouts();
  follow();
  viewer.set_dirty();
}

// Resolves once the picture of a time has been drawn.
function drawnAt(t) {
  showTime(t);
  return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
}

function setPlaying(on) {
  clock.playing = on && DETAILS.duration > 0;
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
  if (viewer.needs_render) viewer.render();
  requestAnimationFrame(advance);
}

// The bar
function place(element, start, end) {
  element.style.left = `${(100 * start) / DETAILS.duration}%`;
  element.style.width = `${(100 * (end - start)) / DETAILS.duration}%`;
}

function buildTimeLine() {
  const line = byId("timeline");
  for (const phase of DETAILS.phases) {
    const label = `${phase.name} ${phase.title}`, element = addElement(line, "div", label, {className: "phase", title: label});
    place(element, phase.start, phase.end);
    element.style.background = PHASE_COLOURS[phase.index % PHASE_COLOURS.length];
  }
  const ill = [...DETAILS.health].sort((a, b) => (a.state === "lost") - (b.state === "lost"));
  for (const {channel, state, start, end} of ill) {
    const element = addElement(line, "div", "", {className: "health", title: `${channel} ${state}`});
    place(element, start, end);
    element.style.background = STATE_COLOURS[state];
  }
  for (const {name, start, end} of DETAILS.faults)
    place(addElement(line, "div", "", {className: "fault", title: `fault: ${name}`}), start, end);
  for (const {t, text} of DETAILS.alarms)
    addElement(line, "div", "", {className: "alarm", title: `${t.toFixed(2)} s: ${text}`}).style.left =
      `${(100 * t) / DETAILS.duration}%`;
  const scrub = (event) => {
    const box = line.getBoundingClientRect();
    setPlaying(false);
    showTime((DETAILS.duration * (event.clientX - box.left)) / box.width);
  };
  line.onpointerdown = (event) => { line.setPointerCapture(event.pointerId); scrub(event); };
  line.onpointermove = (event) => { if (event.buttons) scrub(event); };
}

function labelPhases() {
  [...byId("timeline").querySelectorAll(".phase")].forEach((element, i) => {
    element.textContent = element.title;
    if (element.scrollWidth > element.clientWidth) element.textContent = DETAILS.phases[i].name;
    if (element.scrollWidth > element.clientWidth) element.textContent = "";
  });
}

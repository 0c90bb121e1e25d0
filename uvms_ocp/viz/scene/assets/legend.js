// What there is to see, by colour; what can be hidden has a box to tick.
const digits = (value) => (value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(1) : value.toFixed(3));

function addElement(parent, tag, text, properties) {
  const element = Object.assign(document.createElement(tag), {textContent: text}, properties);
  parent.appendChild(element);
  return element;
}

function legendRow(label, colour, shown, toggle) {
  const row = addElement(byId("rows"), "label", ""), properties = {type: "checkbox", checked: shown};
  properties.onchange = (event) => { toggle(event.target.checked); showTime(clock.t); };
  if (toggle) addElement(row, "input", "", properties);
  if (colour) addElement(row, "i", "").style.background = colour;
  addElement(row, "span", label);
}

const short = (value) => (value >= 100 ? value.toFixed(0) : value.toPrecision(2));

function buildLegend() {
  for (const {label, colour, path} of DETAILS.legend)
    legendRow(label, colour, true, (on) => { nodeAt(path).visible = on; });
  for (const group of DETAILS.arrows)
    legendRow(`${group.label}, up to ${short(group.largest)} ${group.unit}`, group.colour, group.shown,
      (on) => { group.shown = on; });
  const near = DETAILS.witness;
  if (near !== null) legendRow(`nearest points, below ${near.near} m`, near.colour, near.shown, (on) => { near.shown = on; });
  if (DETAILS.labels.length)
    legendRow("names", null, true, (on) => { byId("labels").classList.toggle("unnamed", !on); });
  if (DETAILS.readouts.some((row) => row.task)) legendRow("quantities of all tasks", null, false, (on) => { clock.all = on; });
  const seen = new Set(DETAILS.health.map((spell) => spell.state));
  for (const state of ["suspect", "lost"]) if (seen.has(state)) legendRow(`sensor ${state}`, STATE_COLOURS[state]);
  if (DETAILS.faults.length) legendRow("fault", STATE_COLOURS.fault);
  if (DETAILS.alarms.length) legendRow("alarm", STATE_COLOURS.alarm);
  byId("legend").open = window.innerWidth > 760;
  byId("legend").style.display = byId("rows").children.length ? "" : "none";
}

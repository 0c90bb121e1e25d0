// Writes what is dragged in a scene into the hidden text of a widget, by which the notebook tells Python.
((name) => window.addEventListener("message", ({data, source}) => {
  const input = document.querySelector(`.${name} input`);
  if (!input || source !== document.getElementById(name)?.contentWindow) return;
  input.value = JSON.stringify(data);
  input.dispatchEvent(new Event("input", {bubbles: true}));
}))

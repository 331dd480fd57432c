"use strict";
// The page's data, and which methods, materials and scenes are shown. Views redraw on a change.

const report = JSON.parse(document.getElementById("data").textContent);

const hidden = { methods: new Set(), materials: new Set(), scenes: new Set() };
const listeners = [];

/** Calls `draw` now and whenever what is shown, or the theme, changes. */
function follow(draw) {
  listeners.push(draw);
  draw();
}

function changed() {
  for (const draw of listeners) draw();
}

function isHidden(kind, place) {
  return place >= 0 && hidden[kind].has(place);
}

function toggleHidden(kind, place) {
  if (!hidden[kind].delete(place)) hidden[kind].add(place);
  changed();
}

// What the answer, the images and the plots are about: one choice for all of them.
const choice = { material: 0, scene: -1, stop: 16, shipped: false };

function choose(values) {
  Object.assign(choice, values);
  changed();
}

/** A number of the data, where infinity is text and nan is null. */
function num(value) {
  return value === null || value === undefined ? NaN : Number(value);
}

/** At most three significant digits; powers of ten where zeros would drown them. */
function brief(value) {
  const x = num(value);
  if (Number.isNaN(x)) return "†";
  if (!Number.isFinite(x)) return x > 0 ? "∞" : "−∞";
  if (x === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(x)));
  const text = size < -3 || size > 5 ? x.toExponential(2) : Number(x.toPrecision(3)).toString();
  return text.replace(/-/g, "−").replace("e+", "e");
}

function brieflySeconds(seconds) {
  const units = [[3600, "h"], [60, "min"], [1, "s"], [1e-3, "ms"], [1e-6, "µs"]];
  const [factor, name] = units.find(([least]) => seconds >= least) || units[units.length - 1];
  return `${brief(seconds / factor)} ${name}`;
}

// --- theme -------------------------------------------------------------------------------------

function darkNow() {
  const set = document.documentElement.dataset.theme;
  return set ? set === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function setUpTheme() {
  const button = document.getElementById("theme");
  const show = () => { button.textContent = darkNow() ? "☀ Light" : "☾ Dark"; };
  button.addEventListener("click", () => {
    document.documentElement.dataset.theme = darkNow() ? "light" : "dark";
    show();
    changed();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { show(); changed(); });
  show();
}

/** A method's colour; dark ones are lightened where the page is dark. */
function colourOf(method) {
  const colour = method >= 0 ? report.methods[method].colour : "#777777";
  if (!darkNow()) return colour;
  const parts = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const light = (0.3 * parts[0] + 0.59 * parts[1] + 0.11 * parts[2]) / 255;
  const mix = light < 0.45 ? 0.45 * (1 - light) : 0;
  const mixed = parts.map((part) => Math.round(part + (255 - part) * mix));
  return `rgb(${mixed.join(",")})`;
}

"use strict";
// Plotly in this page's colours: one figure, redrawn when what is shown changes.

/** Colours of the page for Plotly, which knows no CSS. */
function pageColours() {
  const style = getComputedStyle(document.documentElement);
  const read = (name) => style.getPropertyValue(name).trim();
  return { ink: read("--ink"), dim: read("--dim"), line: read("--line"), paper: read("--paper") };
}

/** A logarithmic axis that holds `values` with some room; intervals may leave it. */
function axisOf(title, values) {
  const colours = pageColours();
  const known = values.filter((v) => v > 0 && Number.isFinite(v)).map(Math.log10);
  const [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
  const room = Math.max(0.08 * (high - low), 0.12);
  return { title: { text: escaped(title), font: { size: 13 } }, type: "log", range: [low - room, high + room],
    dtick: high - low > 1.4 ? 1 : "D2", gridcolor: colours.line, linecolor: colours.dim, zeroline: false,
    ticks: "outside", tickcolor: colours.dim, exponentformat: "power", automargin: true,
    minor: { dtick: "D1", ticks: "outside", ticklen: 3, tickcolor: colours.dim } };
}

/** Text for Plotly, which reads some markup in it. */
function escaped(text) {
  return text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;").replace(/%\{/g, "%&#123;");
}

/** A figure with a heading and controls; `series()` gives traces and layout, `key()` what they depend on. */
function plotFigure(place, { title, caption, controls, key, plots }) {
  const form = el("div", { class: "form" });
  const row = el("div", { class: "plots" });
  const figures = plots.map(() => el("div", { class: "plot" }));
  row.append(...figures);
  place.append(el("figure", { class: "plotting" }, el("h3", {}, title), form, row, el("figcaption", {}, caption)));
  const drawControls = () => { if (controls) refill(form, controls()); };
  whenSeen(row, () => {
    followKey(() => [key(), darkNow()], async () => {
      drawControls();
      const Plotly = await plotly();
      plots.forEach((plot, i) => drawPlot(Plotly, figures[i], plot()));
    }, row);
  });
  drawControls();
}

function drawPlot(Plotly, place, { traces, layout, empty }) {
  if (!traces.length) {
    if (place.data) Plotly.purge(place);
    place.replaceChildren(el("p", { class: "dim" }, empty || "Nothing to show here."));
    return;
  }
  if (!place.data) place.replaceChildren();
  const colours = pageColours();
  const narrow = place.clientWidth < 420;
  const whole = {
    font: { family: "system-ui, sans-serif", size: 12, color: colours.ink },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", height: narrow ? 340 : 400,
    margin: { l: 60, r: 12, t: 12, b: 48 }, hovermode: "closest", showlegend: false, dragmode: "zoom",
    hoverlabel: { bgcolor: colours.paper, bordercolor: colours.dim, font: { color: colours.ink } },
    ...layout,
  };
  const fresh = !place.data;
  Plotly.react(place, traces, whole, { responsive: true, displaylogo: false,
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
  if (fresh) {
    place.on("plotly_click", (event) => {
      const trials = event.points[0].customdata;
      if (trials && trials.length) openTrials(trials, event.points[0].data.name);
    });
  }
}

/** Keys of methods beside a plot: press to switch them on and off. */
function methodKeys(methods) {
  return el("div", { class: "chips", role: "group", "aria-label": "Methods" }, methods.map((method) => {
    const about = report.methods[method];
    const chip = button(about.label, () => toggleHidden("methods", method), { class: "chip",
      "aria-pressed": !isHidden("methods", method) });
    chip.style.setProperty("--swatch", colourOf(method));
    return chip;
  }));
}

function lineOf(method) {
  return { color: colourOf(method), dash: report.methods[method].dash, width: 1.8 };
}

function translucent(colour, share) {
  if (colour.startsWith("rgb(")) return colour.replace("rgb(", "rgba(").replace(")", `,${share})`);
  const parts = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return `rgba(${parts.join(",")},${share})`;
}

/** A band between two curves; where the lower is not above zero it ends at `least`. */
function band(x, low, high, method, least) {
  const below = low.map((v) => (num(v) > 0 ? num(v) : least));
  return { x: [...x, ...[...x].reverse()], y: [...high.map(num), ...below.reverse()], fill: "toself",
    fillcolor: translucent(colourOf(method), 0.16), line: { width: 0 }, mode: "lines", hoverinfo: "skip" };
}

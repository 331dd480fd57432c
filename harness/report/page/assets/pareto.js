"use strict";
// Accuracy against time, every method and its knobs, with the front.

const OPACITY = { front: 1, possibly: 0.6, surely: 0.25 };

function setUpPareto(place) {
  if (!report.charts.length) return;
  const state = { chart: 0, panel: 0 };
  const chart = () => report.charts[state.chart];
  const panel = () => chart().panels[Math.min(state.panel, chart().panels.length - 1)];
  const set = (changes) => { Object.assign(state, changes); changed(); };
  plotFigure(place, {
    title: "What accuracy costs in time",
    caption: "Lower and further left is better; bars are 95% intervals. The line is the front: what no other beats on both axes. Faint points are beaten, intervals and all; half faint ones by value, but intervals overlap. Filled: a method as the suite lists it first; hollow: with the knob that its label or hovering names.",
    controls: () => [
      report.charts.length > 1 ? chooser("numbers", report.charts.map((one, i) => [i, one.title]), state.chart, (at) => set({ chart: at })) : null,
      chooser("material", chart().panels.map((one, i) => [i, one.title]), Math.min(state.panel, chart().panels.length - 1), (at) => set({ panel: at })),
      methodKeys([...new Set(panel().points.map((point) => point.family))].filter((m) => m >= 0)),
      panel().off.length ? el("p", { class: "dim" }, `infinite or zero: ${panel().off.join(", ")}`) : null],
    key: () => [state, [...hidden.methods]],
    plots: [() => frontPlot(chart(), panel())],
  });
}

function frontPlot(chart, panel) {
  const seen = panel.points.filter((p) => !isHidden("methods", p.method) && !isHidden("methods", p.family));
  const traces = [];
  const front = seen.filter((p) => p.place === "front").sort((a, b) => a.x.v - b.x.v);
  if (front.length > 1) {
    traces.push({ x: front.map((p) => p.x.v), y: front.map((p) => p.y.v), mode: "lines", hoverinfo: "skip",
      line: { color: pageColours().dim, width: 1.5 } });
  }
  const least = Math.min(...seen.map((p) => num(p.y.v))) / 3;
  for (const point of seen) {
    const name = report.methods[point.method].label;
    const colour = colourOf(point.family);
    traces.push({ x: [point.x.v], y: [point.y.v], name, mode: point.place === "front" ? "markers+text" : "markers",
      text: [escaped(point.knob || name)], textposition: "top center", textfont: { size: 11, color: colour },
      cliponaxis: false, opacity: OPACITY[point.place] || 1,
      marker: { symbol: (report.methods[point.family] || report.methods[point.method]).symbol + (point.knob ? "-open" : ""), size: 10, color: colour, line: { width: point.knob ? 1.5 : 0 } },
      error_x: ends(point.x), error_y: ends(point.y, least),
      customdata: [trialsOfMethod(point.method)],
      hovertemplate: `<b>${escaped(name)}</b>${point.knob ? `<br>knob: ${escaped(point.knob)}` : ""}<br>${escaped(chart.x)}: ${told(point.x)}<br>${escaped(chart.y)}: ${told(point.y)}<br>on the front with ${percent(point.sure)}<extra></extra>` });
  }
  for (const level of panel.levels) {
    if (isHidden("methods", level.method)) continue;
    const name = report.methods[level.method].label;
    const ys = [level.y.v, level.y.v];
    const xs = seen.map((p) => p.x.v);
    traces.push({ x: [Math.min(...xs), Math.max(...xs)], y: ys, name, mode: "lines", line: { ...lineOf(level.method), width: 1, dash: "dot" },
      hovertemplate: `${escaped(name)}: nothing to fit<extra></extra>` });
  }
  return { traces, layout: { xaxis: axisOf(chart.x, seen.map((p) => num(p.x.v))), yaxis: axisOf(chart.y, seen.map((p) => num(p.y.v))), margin: { l: 60, r: 40, t: 24, b: 48 } } };
}

function ends(found, least) {
  if (found.l === null || found.h === null || found.l === undefined) return undefined;
  const low = num(found.l) > 0 ? num(found.l) : least || num(found.v) / 10;
  return { type: "data", symmetric: false, array: [num(found.h) - num(found.v)],
    arrayminus: [num(found.v) - low], thickness: 1, width: 0 };
}

function told(found) {
  const interval = found.l === null || found.l === undefined ? "" : ` [${brief(found.l)}, ${brief(found.h)}]`;
  return `${brief(found.v)}${interval}${found.note ? ` (${escaped(found.note)})` : ""}`;
}

function trialsOfMethod(method) {
  const found = [];
  report.trials.list.forEach((trial, at) => {
    if (trial.d === method && ["equal-time", "pdf", "throughput", "cost"].includes(measureOf(trial)) && found.length < 30) found.push(at);
  });
  return found;
}

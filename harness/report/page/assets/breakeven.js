"use strict";
// Total time to an error against samples, with a slider of these.

function setUpBreakeven(place) {
  if (!report.advice.cells.some((cell) => cell.fitted)) return;
  const list = el("div", { class: "totals" });
  plotFigure(place, {
    title: "Break-even",
    caption: `Load, fit and samples until the error that so many samples of ${report.advice.reference} reach, over all pixels; bands are 95% intervals. Where two lines cross, the costlier start has paid for itself. The slider is that of the answer.`,
    controls: () => [cellChoosers(), sampleSlider(),
      checkbox("without the time of fitting", choice.shipped, (shipped) => choose({ shipped })),
      methodKeys(linesHere().map((line) => line.method))],
    key: () => [cellKey(), choice.shipped],
    plots: [totalTimes],
  });
  const figure = place.lastElementChild;
  figure.querySelector(".plots").append(list);
  followKey(() => [choice.stop, choice.shipped, cellKey()], () => {
    drawTotals(list);
    const slider = figure.querySelector("input[type=range]");
    if (slider) {
      slider.value = choice.stop;
      slider.parentElement.querySelector("output").textContent = report.advice.said[choice.stop];
    }
    const plot = figure.querySelector(".plot");
    if (plot.data && window.Plotly) window.Plotly.relayout(plot, { shapes: [stopLine()] });
  }, figure);
}

function linesHere() {
  const cell = adviceAt();
  const of = cell && cell[choice.shipped ? "shipped" : "fitted"];
  return of ? of.lines : [];
}

function stopLine() {
  const at = report.advice.samples[choice.stop];
  return { type: "line", x0: at, x1: at, y0: 0, y1: 1, yref: "paper", line: { color: "#c58b00", width: 2 } };
}

function totalTimes() {
  const seen = linesHere().filter((line) => !isHidden("methods", line.method));
  const x = report.advice.samples;
  const traces = seen.map((line) => band(x, line.seconds.map((s) => s[1]), line.seconds.map((s) => s[2]), line.method, 1e-9));
  for (const line of seen) {
    const name = report.methods[line.method].label;
    traces.push({ x, y: line.seconds.map((s) => s[0]), name, mode: "lines", line: lineOf(line.method),
      hovertemplate: `${escaped(name)}<br>%{x:.3s} samples: %{y:.3g} s<extra></extra>` });
  }
  const cell = adviceAt();
  return { traces, empty: (cell && cell.why) || "No total times hold here.",
    layout: { xaxis: axisOf(`samples of ${report.advice.reference}`, x),
      yaxis: axisOf("seconds", seen.flatMap((line) => line.seconds.map((s) => num(s[0])))), shapes: [stopLine()] } };
}

/** Everyone's total at the slider, the fastest first. */
function drawTotals(list) {
  const lines = linesHere().filter((line) => !isHidden("methods", line.method));
  const sorted = [...lines].sort((a, b) => num(a.seconds[choice.stop][0]) - num(b.seconds[choice.stop][0]));
  list.replaceChildren(el("b", {}, `at ${report.advice.said[choice.stop]} samples`), el("ol", {}, sorted.map((line) => {
    const [value, low, high] = line.seconds[choice.stop].map(num);
    return el("li", { title: line.mark }, swatch(line.method), `${report.methods[line.method].label}: ${brieflySeconds(value)} `,
      el("small", {}, low < high ? `[${brieflySeconds(low)}, ${brieflySeconds(high)}]` : ""), line.mark ? el("span", { class: "warning" }, " ‡") : null);
  })));
}

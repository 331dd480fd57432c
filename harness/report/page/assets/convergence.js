"use strict";
// Error against samples and against seconds, with the slope that independent samples give.

function setUpConvergence(place) {
  if (!report.convergence.length) return;
  const here = () => report.convergence.filter((curve) => curve.material === choice.material
    && (curve.scene === choice.scene || curve.scene === -1));
  plotFigure(place, {
    title: "Convergence",
    caption: "Mean squared error of a render against samples per pixel, and against seconds. Bands and bars are 95% intervals. The grey line has the slope −1 of independent samples. What lies below the noise of the reference is left out. A point opens its trial.",
    controls: () => [cellChoosers(), methodKeys([...new Set(here().map((curve) => curve.method))])],
    key: () => cellKey(),
    plots: [() => errorAgainst(here(), "spp", "samples per pixel"), () => errorAgainst(here(), "seconds", "seconds")],
  });
}

function errorAgainst(curves, x, title) {
  const seen = curves.filter((curve) => !isHidden("methods", curve.method));
  const traces = [];
  const values = seen.flatMap((curve) => curve.mse.filter((v) => v !== null));
  const least = Math.min(...values) / 10;
  for (const curve of seen) {
    if (curve.mse_low) {
      const kept = curve.mse.map((v, i) => (v === null || curve.mse_high[i] === null ? -1 : i)).filter((i) => i >= 0);
      traces.push(band(kept.map((i) => curve[x][i]), kept.map((i) => curve.mse_low[i]),
        kept.map((i) => curve.mse_high[i]), curve.method, least));
    }
  }
  for (const curve of seen) {
    const name = report.methods[curve.method].label;
    const at = curve[x].map(num);
    const error = curve[`${x}_low`] ? { type: "data", symmetric: false, thickness: 1, width: 0,
      array: curve[`${x}_high`].map((v, i) => num(v) - at[i]),
      arrayminus: curve[`${x}_low`].map((v, i) => at[i] - num(v)) } : undefined;
    traces.push({ x: at, y: curve.mse, name, mode: "lines+markers", line: lineOf(curve.method),
      marker: { symbol: report.methods[curve.method].symbol, size: 6 }, error_x: error,
      customdata: at.map(() => [curve.trial]),
      hovertemplate: `${escaped(name)}<br>%{x:.3g} ${title === "seconds" ? "s" : "spp"}: MSE %{y:.3g}<extra></extra>` });
  }
  if (seen.length) traces.push(slopeLine(seen, x));
  return { traces, empty: "No convergence was measured here.",
    layout: { xaxis: axisOf(title, seen.flatMap((curve) => curve[x].map(num))),
      yaxis: axisOf("mean squared error", values) } };
}

/** A line of slope −1 through the middle of the curves. */
function slopeLine(curves, x) {
  const products = curves.flatMap((curve) => curve[x].map((at, i) => num(at) * num(curve.mse[i])))
    .filter((v) => v > 0).sort((a, b) => a - b);
  const middle = products[Math.floor(products.length / 2)];
  const ends = curves.flatMap((curve) => curve[x].map(num));
  const at = [Math.min(...ends), Math.max(...ends)];
  return { x: at, y: at.map((v) => middle / v), mode: "lines", hoverinfo: "skip",
    line: { color: pageColours().dim, width: 1, dash: "dash" } };
}

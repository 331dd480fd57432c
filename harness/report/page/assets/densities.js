"use strict";
// Densities over the projected disk beside their target, with points of the method's own samples.

function setUpDensities(place) {
  const found = report.densities.materials;
  if (!found.length) return;
  const state = { at: 0, points: false };
  const form = el("div", { class: "form" });
  const grid = el("div", { class: "densities" });
  const left = report.densities.left;
  const figure = el("figure", { class: "plotting", id: "densities" }, el("h3", {}, "Densities"), form, grid,
    el("figcaption", {}, "Density per area of the projected disk: the target p* and the pdf of each method, for randomly drawn conditions. One colour scale a row, from 0 to the target's peak (its 99.9% quantile), with a square root between. KL divergence in nats and mean squared error from the target below each.",
      found.some((one) => one.methods.some((method) => method.below.some(Boolean))) ? ` ‡ ${report.densities.belowZero}.` : null,
      left.length ? ` Without room on this page: ${left.join(", ")}; the print figures have them.` : ""));
  place.append(figure);
  const draw = () => {
    const sampled = found[state.at].methods.some((one) => one.samples);
    refill(form, chooser("material", found.map((one, i) => [i, report.materials[one.material]]), state.at, (at) => { state.at = at; draw(); }),
      sampled ? checkbox("points drawn by the method", state.points, (points) => { state.points = points; draw(); })
        : el("span", { class: "dim" }, "Stored before sampled points were kept."));
    drawDensities(grid, found[state.at], state.points);
  };
  whenSeen(figure, () => followKey(() => [[...hidden.methods], darkNow()], draw, figure));
}

async function drawDensities(grid, found, points) {
  const [count, side] = found.target.shape;
  const target = await unpackArray(found.target);
  const methods = found.methods.filter((one) => !isHidden("methods", one.method));
  const all = await Promise.all(methods.map((one) => unpackArray(one.grid)));
  const rows = [];
  for (let k = 0; k < count; k += 1) {
    const cells = [disk(target, k, side, "target p*", `peak ${brief(found.peaks[k])}`, null, found.peaks[k])];
    methods.forEach((one, i) => {
      const name = report.methods[one.method].label;
      const said = [`KL ${one.kl[k]}${one.below[k] ? " ‡" : ""}`, `MSE ${one.mse[k]}`].join(", ");
      const made = disk(all[i], k, side, name, said, points && one.samples ? one.samples[k] : null, found.peaks[k]);
      if (one.below[k]) made.title = report.densities.belowZero;
      made.addEventListener("click", () => openTrials([one.trial], name));
      cells.push(made);
    });
    rows.push(el("div", { class: "row" }, cells));
  }
  grid.replaceChildren(...rows);
}

/** One density: 0 off the disk, else the root of its share of the peak in 255 steps. */
function disk(values, k, side, name, said, points, peak) {
  const canvas = el("canvas", { width: side, height: side });
  const context = canvas.getContext("2d");
  const data = new ImageData(side, side);
  for (let row = 0; row < side; row += 1) {
    for (let column = 0; column < side; column += 1) {
      const value = values[(k * side + row) * side + column];
      // Rows go up with y, those of a canvas down.
      const at = 4 * ((side - 1 - row) * side + column);
      if (value) data.data.set([...mapped((value - 1) / 254), 255], at);
    }
  }
  context.putImageData(data, 0, 0);
  const pictures = [canvas];
  if (points) pictures.push(pointsOver(points));
  const value = el("output", {});
  canvas.addEventListener("pointermove", (event) => {
    const column = Math.floor((event.offsetX / canvas.clientWidth) * side);
    const row = side - 1 - Math.floor((event.offsetY / canvas.clientHeight) * side);
    const at = values[(k * side + row) * side + column];
    value.textContent = at ? `p = ${brief(num(peak) * ((at - 1) / 254) ** 2)}${at === 255 ? " or more" : ""}` : "";
  });
  return el("button", { type: "button", class: "density" }, el("b", {}, name), el("span", { class: "disk" }, pictures),
    el("small", {}, said), value);
}

function pointsOver(points) {
  const made = svg("svg", { viewBox: "-1 -1 2 2" });
  for (let i = 0; i < points.length; i += 2) {
    made.append(svg("circle", { cx: points[i], cy: -points[i + 1], r: 0.015 }));
  }
  return made;
}

"use strict";
// The answer in sentences, the means as dots, and the advice for one material and scene.

function setUpAnswer() {
  const place = section("answer", "The answer");
  place.append(el("div", { class: "sentences" },
    report.answer.sentences.map((text) => el("p", {}, emphasised(text)))));
  const { means } = report.answer;
  const first = means.filter((one) => one.table === (means[0] && means[0].table));
  if (first.length) place.append(dotPlots(first));
  if (report.advice.cells.some((cell) => cell.fitted)) {
    setUpAdvice(place);
  } else if (report.advice.cells.length) {
    place.append(el("p", { class: "warning" },
      `No advice by number of samples: ${report.advice.cells[0].why || "no method has a time that holds"}.`));
  }
  const others = means.filter((one) => !first.includes(one));
  if (others.length) {
    place.append(el("details", { class: "others" },
      el("summary", {}, "Means of other numbers: equal samples, densities"), dotPlots(others)));
  }
}

function dotPlots(means) {
  const dots = el("div", { class: "dots" });
  followKey(hiddenKey, () => dots.replaceChildren(...means.filter(meansShown).map(dotPlot)));
  return dots;
}

/** The names of methods in bold. */
function emphasised(text) {
  const labels = report.methods.map((method) => method.label).sort((a, b) => b.length - a.length);
  const parts = [];
  let rest = text;
  while (rest) {
    const found = labels.map((label) => [rest.indexOf(label), label]).filter(([at]) => at >= 0)
      .sort((a, b) => a[0] - b[0] || b[1].length - a[1].length)[0];
    if (!found) break;
    parts.push(rest.slice(0, found[0]), el("b", {}, found[1]));
    rest = rest.slice(found[0] + found[1].length);
  }
  return [...parts, rest];
}

function meansShown(means) {
  return !isHidden("scenes", report.scenes.indexOf(means.scene));
}

/** The methods below each other, a dot with its interval each, on one axis. */
function dotPlot(means) {
  const rows = means.dots.filter((dot) => !isHidden("methods", methodNamed(dot.label)));
  const ends = rows.flatMap((dot) => [num(dot.v), num(dot.l), num(dot.h)]).filter((v) => v > 0);
  const axis = scaleOf(rows.every((dot) => num(dot.v) > 0) ? ends : ends.concat(0), 0.06);
  const sorted = [...rows].sort((a, b) => (means.best === "high" ? b.v - a.v : a.v - b.v));
  const better = means.best === "high" ? "more is better" : "less is better";
  const title = `${means.title}${means.scene ? `, ${means.scene}` : ""}`;
  const list = el("div", { class: "dotplot", role: "table", "aria-label": title });
  const ceiling = (method) => method >= 0 && report.methods[method].ceiling;
  for (const dot of sorted) {
    const method = methodNamed(dot.label);
    const name = ceiling(method) ? el("i", { title: "The ceiling: too slow and too large to be used" }, dot.label) : dot.label;
    list.append(el("div", { class: "dotrow", role: "row", title: dot.note || dot.text },
      el("span", { class: "name", role: "rowheader" }, swatch(method), name),
      el("span", { class: "track", "aria-hidden": "true" }, gridLines(axis), bar(dot, axis, colourOf(method), 22)),
      el("span", { class: dot.bold ? "value bold" : "value", role: "cell" }, dot.text,
        dot.note ? el("span", { class: "warning" }, " ‡") : null)));
  }
  list.append(el("div", { class: "dotrow ticks", "aria-hidden": "true" }, el("span"),
    el("span", { class: "track" }, axis.ticks.map((v) => el("span", { style: `left:${(100 * axis.place(v)).toFixed(1)}%` }, brief(v)))),
    el("span")));
  for (const one of means.missing) {
    if (isHidden("methods", methodNamed(one.label))) continue;
    list.append(el("div", { class: "dotrow dim", title: one.why },
      el("span", { class: "name" }, swatch(methodNamed(one.label)), one.label),
      el("span", { class: "why" }, one.why), el("span", { class: "value" }, "†")));
  }
  return el("figure", {}, el("figcaption", {}, el("b", {}, title),
    ` (${means.row}; ${better}; ${axis.log ? "logarithmic; " : ""}bars are 95% intervals)`), list);
}

function gridLines(axis) {
  return svg("svg", { class: "lines", width: "100%", height: "100%" }, axis.ticks.map((v) => {
    const at = `${(100 * axis.place(v)).toFixed(2)}%`;
    return svg("line", { x1: at, x2: at, y1: 0, y2: "100%", class: v === 1 && axis.log ? "one" : "" });
  }));
}

function methodNamed(label) {
  return report.methods.findIndex((method) => method.label === label);
}

function swatch(method) {
  return el("i", { class: "swatch", style: `background:${colourOf(method)}` });
}

/** An axis through `values`: logarithmic where all are above zero. `room` is left on both sides. */
function scaleOf(values, room = 0) {
  const known = values.filter((v) => Number.isFinite(v));
  const log = known.length > 0 && known.every((v) => v > 0);
  const at = (v) => (log ? Math.log(v) : v);
  const low = known.length ? Math.min(...known.map(at)) : 0;
  const high = known.length ? Math.max(...known.map(at)) : 1;
  const wide = (high - low || 1) * (1 + 2 * room);
  const start = low - (high - low || 1) * room;
  const place = (v) => Math.min(1, Math.max(0, (at(v) - start) / wide));
  const [first, last] = [start, start + wide].map((v) => (log ? Math.exp(v) : v));
  return { log, place, ticks: log ? logTicks(first, last) : evenTicks(first, last) };
}

/** Some of 1, 2 and 5 times powers of ten; powers alone where there are many. */
function logTicks(first, last) {
  for (const steps of [[1, 1.5, 2, 3, 5, 7], [1, 2, 5], [1]]) {
    const found = [];
    for (let power = Math.floor(Math.log10(first)); power <= Math.log10(last); power += 1) {
      found.push(...steps.map((step) => step * 10 ** power));
    }
    const inside = found.filter((v) => v >= first && v <= last);
    if (inside.length <= 6 || steps.length === 1) {
      return inside.filter((_, i) => i % Math.ceil(inside.length / 6) === 0);
    }
  }
  return [];
}

function evenTicks(first, last) {
  const rough = (last - first) / 5;
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  const step = [1, 2, 5, 10].map((m) => m * power).find((m) => m >= rough) || 1;
  const found = [];
  for (let i = Math.ceil(first / step); i * step <= last; i += 1) found.push(i * step);
  return found;
}

/** A dot and its interval, as a picture of the width that it is given. */
function bar(number, axis, colour, height) {
  const per = (v) => `${(100 * axis.place(v)).toFixed(2)}%`;
  const [v, l, h] = [num(number.v), num(number.l), num(number.h)];
  const made = svg("svg", { class: "bar", height, "aria-hidden": "true" });
  if (!Number.isFinite(v) || (axis.log && v <= 0)) return made;
  const middle = height / 2;
  if (l <= h) {
    const low = axis.log && l <= 0 ? "0%" : per(l);
    made.append(svg("line", { x1: low, x2: Number.isFinite(h) ? per(h) : "100%", y1: middle,
      y2: middle, stroke: colour, "stroke-width": 2, "stroke-opacity": 0.55 }));
  }
  made.append(svg("circle", { cx: per(v), cy: middle, r: height > 10 ? 4 : 2.5, fill: colour }));
  return made;
}

// --- advice ------------------------------------------------------------------------------------

function adviceAt() {
  return report.advice.cells.find((cell) => cell.material === choice.material
    && (cell.scene === choice.scene || cell.scene === -1));
}

/** The selects that the answer, the images and the break-even share. */
function cellChoosers() {
  const materials = report.materials.map((name, at) => [at, name]);
  const scenes = report.scenes.map((name, at) => [at, name]);
  return [
    chooser("material", materials, choice.material, (material) => choose({ material })),
    scenes.length > 1
      ? chooser("scene", scenes, choice.scene, (scene) => choose({ scene })) : null,
  ];
}

function sampleSlider() {
  const slider = el("input", { type: "range", min: 0, max: report.advice.samples.length - 1,
    value: choice.stop, "aria-label": `samples of ${report.advice.reference}`,
    "aria-valuetext": report.advice.said[choice.stop],
    on: { input: () => choose({ stop: Number(slider.value) }) } });
  return el("label", { class: "field wide" },
    el("span", {}, `samples of ${report.advice.reference} in all pixels`), slider,
    el("output", {}, report.advice.said[choice.stop]));
}

function setUpAdvice(place) {
  const form = el("div", { class: "form" });
  const out = el("div", { class: "advice", "aria-live": "polite" });
  place.append(el("h3", {}, "For your material, scene and number of samples"), form, out);
  const held = { key: "" };
  follow(() => {
    // The slider stays while it is dragged.
    const key = JSON.stringify([choice.material, choice.scene, choice.shipped]);
    if (key !== held.key) {
      held.key = key;
      refill(form, cellChoosers(), sampleSlider(),
        checkbox("without the time of fitting", choice.shipped, (shipped) => choose({ shipped })));
    }
    const slider = form.querySelector("input[type=range]");
    slider.value = choice.stop;
    slider.setAttribute("aria-valuetext", report.advice.said[choice.stop]);
    form.querySelector("output").textContent = report.advice.said[choice.stop];
    out.replaceChildren(...adviceLines());
  });
}

function adviceLines() {
  const cell = adviceAt();
  const of = cell && cell[choice.shipped ? "shipped" : "fitted"];
  if (!of || !of.best.length) {
    return [el("p", { class: "warning" }, `No advice: ${(cell && cell.why) || "no method has a time that holds here"}`)];
  }
  const best = of.best[choice.stop];
  const name = report.methods[best.method].label;
  const lines = [el("p", {}, "Use ", swatch(best.method), el("b", {}, name),
    `: ${best.seconds} to the error of ${report.advice.said[choice.stop]} samples of ${report.advice.reference}.`)];
  if (best.next !== undefined) {
    const next = report.methods[best.next].label;
    lines.push(el("p", {}, best.margin === "not resolved"
      ? `How much longer the next, ${next}, takes is not resolved. ` : `The next, ${next}, takes ${best.margin} as long. `,
      best.tie ? `A tie: ${name} is the fastest of all in ${percent(best.surest)} of the draws.`
        : `${name} is the fastest of all in ${percent(best.surest)} of the draws from all intervals.`));
  }
  const marks = marksOf(of.lines, [best.method, best.next]);
  if (marks.length) lines.push(el("p", { class: "warning" }, `‡ ${marks.join("; ")}`));
  lines.push(el("p", {}, trainingWords(cell.training, name)));
  const range = rangeOf(of.best, choice.stop);
  lines.push(el("p", { class: "dim" }, `This holds ${range}. `, whereTheyDiffer()));
  const out = Object.entries(of.out);
  if (out.length) {
    lines.push(el("details", {}, el("summary", {}, out.length > 1 ? `${out.length} methods do not take part` : "One method does not take part"),
      el("ul", {}, out.map(([label, why]) => el("li", {}, `${label}: ${why}`)))));
  }
  return lines;
}

/** What is to be known of the timings of `methods`: one sentence for those that share it. */
function marksOf(lines, methods) {
  const found = new Map();
  for (const line of lines.filter((one) => one.mark && methods.includes(one.method))) {
    found.set(line.mark, [...(found.get(line.mark) || []), report.methods[line.method].label]);
  }
  return [...found].map(([mark, names]) => `${names.join(" and ")}: ${mark}`);
}

function percent(share) {
  return share > 0.99 ? "over 99%" : `${Math.round(100 * share)}%`;
}

/** From which to which number of samples the same method is the fastest. */
function rangeOf(best, stop) {
  let [first, last] = [stop, stop];
  while (first > 0 && best[first - 1].method === best[stop].method) first -= 1;
  while (last < best.length - 1 && best[last + 1].method === best[stop].method) last += 1;
  const said = report.advice.said;
  if (first === 0 && last === best.length - 1) return "for any number of samples";
  const from = first === 0 ? "from the first sample" : `from ${said[first]}`;
  const before = first ? ` (${report.methods[best[first - 1].method].label} below)` : "";
  const to = last === best.length - 1 ? "on" : `to ${said[last]} (${report.methods[best[last + 1].method].label} above)`;
  return `${from}${before} ${to}`;
}

function trainingWords(training, name) {
  if (training.seeds < 2) {
    return "Would a second training change it? Not known: there is one training of each method.";
  }
  const counts = Object.entries(training.first);
  const total = counts.reduce((sum, [, n]) => sum + n, 0);
  if (!total) return "Would a second training change it? No training has a number here.";
  const mine = training.first[name] || 0;
  const others = counts.filter(([label]) => label !== name);
  const rest = others.map(([label, n]) => `${label} with ${n}`).join(", ");
  const verdict = mine === total ? "No" : "It may";
  return `Would a second training change it? ${verdict}: by its speed at equal error, ${name} is first with ${mine} of ${total} trainings${rest ? `, ${rest}` : ""}.`;
}

/** In which part of the image the methods differ most, with a link to it. */
function whereTheyDiffer() {
  const group = groupAt();
  if (!group) {
    const others = [...new Set(report.images.groups.map((one) => report.materials[one.material]))];
    return others.length ? el("span", {}, "No images of it are stored; ",
      el("a", { href: "#images" }, `those of ${others.join(", ")}`), " are.") : "No images of it are stored.";
  }
  if (!group.squares.length) return el("a", { href: "#images" }, "Its images are below.");
  return el("span", {}, "In the image the methods differ most at ",
    el("a", { href: "#images", on: { click: () => showSquare(0) } }, group.squares[0].said), ".");
}

"use strict";
// Runs side by side: what moved, what cannot be compared, and a number over the runs.

const LABEL_COUNT = report.labels.length;
const AT = { metric: LABEL_COUNT, unit: LABEL_COUNT + 1, why: LABEL_COUNT + 2, moved: LABEL_COUNT + 3,
  change: LABEL_COUNT + 4, entries: LABEL_COUNT + 5 };
const METHOD = report.labels.indexOf("method");
const MOST = 1000;

function labelOf(one, name) {
  const at = report.labels.indexOf(name);
  return String(report.lists[at][one[at]]);
}

function entryOf(one, run) {
  return one[AT.entries + (run < 0 ? report.runs.length + run : run)];
}

function saidEntry(entry) {
  if (!entry) return "";
  const ends = entry[1] === null || entry[2] === null ? "" : ` [${brief(entry[1])}, ${brief(entry[2])}]`;
  return `${brief(entry[0])}${ends}${entry[4] === "stale" ? " (stale)" : ""}`;
}

function numbersTable(numbers, withWhy) {
  const heads = ["measure", "metric", "method", "material", "scene", "seed", withWhy ? "why not" : "last / first", "first", "last"];
  const state = { words: [], sort: -1, up: false };
  const body = el("tbody", {});
  const said = el("span", { class: "dim" });
  const cellsOf = (one) => [labelOf(one, "measure"), report.metrics[one[AT.metric]], labelOf(one, "method"),
    labelOf(one, "material"), labelOf(one, "scene"), labelOf(one, "seed"),
    withWhy ? report.reasons[one[AT.why]] : `${brief(one[AT.change])}×`, saidEntry(entryOf(one, 0)), saidEntry(entryOf(one, -1))];
  const rows = numbers.map((one) => ({ one, cells: cellsOf(one), size: Math.abs(Math.log(num(one[AT.change]))) || 0 }));
  const draw = () => {
    const seen = rows.filter((row) => state.words.every((word) => row.cells.join(" ").toLowerCase().includes(word)));
    if (state.sort >= 0) seen.sort((a, b) => (state.up ? 1 : -1) * a.cells[state.sort].localeCompare(b.cells[state.sort], "en", { numeric: true }));
    else seen.sort((a, b) => b.size - a.size);
    said.textContent = seen.length > MOST ? `${MOST} of ${seen.length} shown; words narrow it` : `${seen.length} of ${rows.length}`;
    body.replaceChildren(...seen.slice(0, MOST).map((row) => el("tr", {}, row.cells.map((cell, i) => el(i ? "td" : "th", i ? {} : { scope: "row" }, cell)))));
  };
  const search = el("input", { type: "search", placeholder: "words that a row has", "aria-label": "Filter numbers",
    on: { input: () => { state.words = search.value.toLowerCase().split(/\s+/).filter(Boolean); draw(); } } });
  const head = heads.map((name, at) => el("th", { scope: "col" }, button(name, () => {
    state.up = state.sort === at ? !state.up : true;
    state.sort = at;
    draw();
  })));
  draw();
  return el("div", {}, el("div", { class: "form" }, search, said),
    el("div", { class: "scroll", tabindex: 0 }, el("table", { class: "left" }, el("thead", {}, el("tr", {}, head)), body)));
}

function setUpRuns() {
  const heads = ["run", "suite", "profile", "measured", "machine", "versions"];
  const rows = report.runs.map((run) => [run.name, run.suite, run.profile, `${run.first} to ${run.last}`,
    run.machines.join("; "), run.versions.join("; ")]);
  section("runs", "The runs", el("div", { class: "scroll" }, el("table", { class: "words" },
    el("thead", {}, el("tr", {}, heads.map((name) => el("th", { scope: "col" }, name)))),
    el("tbody", {}, rows.map((row) => el("tr", {}, row.map((cell, i) => el(i ? "td" : "th", i ? {} : { scope: "row" }, cell))))))));
}

function setUpMoved() {
  const moved = report.numbers.filter((one) => one[AT.moved] === true);
  const compared = report.numbers.filter((one) => one[AT.moved] !== null).length;
  const place = section("moved", "What moved");
  place.append(el("p", {}, compared
    ? `${moved.length} of ${compared} numbers have intervals in the first and the last run that do not touch. Of two 95% intervals of equal width about 6 in 1000 pairs are apart by chance: ${brief(0.006 * compared)} here.`
    : "No number of the two can be compared."));
  if (moved.length) place.append(numbersTable(moved, false));
  const heads = ["measure", "metric", "compared", "moved", "median width", "widest"];
  const rows = report.agreement.map((a) => [a.measure, a.metric, a.pairs, a.moved, share(a.width), share(a.widest)]);
  if (rows.length) {
    place.append(el("h3", {}, "By metric"), el("div", { class: "scroll" }, el("table", {},
      el("thead", {}, el("tr", {}, heads.map((name) => el("th", { scope: "col" }, name)))),
      el("tbody", {}, rows.map((row) => el("tr", {}, row.map((cell, i) => el(i ? "td" : "th", i ? {} : { scope: "row" }, String(cell)))))))));
  }
}

function share(width) {
  const value = num(width);
  return Number.isFinite(value) ? `${brief(100 * value)}%` : "∞";
}

function setUpNotCompared() {
  if (!report.reasons.length) return;
  const place = section("not", "What cannot be compared");
  report.reasons.forEach((reason, at) => {
    const of = report.numbers.filter((one) => one[AT.why] === at);
    const details = el("details", {}, el("summary", {}, `${reason}: ${of.length}`));
    details.addEventListener("toggle", () => {
      if (details.open && details.children.length === 1) details.append(numbersTable(of, true));
    });
    place.append(details);
  });
}

/** A number of every method over the runs, in the order given. */
function setUpHistory() {
  const kinds = [...new Set(report.numbers.map((one) => [labelOf(one, "measure"), report.metrics[one[AT.metric]]].join(" ")))];
  const wanted = kinds.findIndex((kind) => kind === "equal-time speedup-equal-time");
  const state = { kind: Math.max(0, wanted), cell: 0 };
  const ofKind = () => report.numbers.filter((one) => [labelOf(one, "measure"), report.metrics[one[AT.metric]]].join(" ") === kinds[state.kind]);
  const where = (one) => [labelOf(one, "material"), labelOf(one, "scene"), `seed ${labelOf(one, "seed")}`].filter(Boolean).join(", ");
  const cells = () => [...new Set(ofKind().map(where))];
  const set = (changes) => { Object.assign(state, changes); changed(); };
  const place = section("history", "A number over the runs");
  plotFigure(place, {
    title: "History", caption: "Runs in the order in which they were given, by the date of their last trial; bars are 95% intervals.",
    controls: () => [chooser("number", kinds.map((kind, i) => [i, kind]), state.kind, (kind) => set({ kind, cell: 0 })),
      chooser("of", cells().map((cell, i) => [i, cell]), state.cell, (cell) => set({ cell }))],
    key: () => [state],
    plots: [() => historyPlot(ofKind().filter((one) => where(one) === cells()[state.cell]), kinds[state.kind])],
  });
}

function historyPlot(numbers, title) {
  const names = report.runs.map((run) => `${escaped(run.name)}<br>${run.last.slice(0, 10)}`);
  const all = numbers.flatMap((one) => report.runs.map((_, i) => (entryOf(one, i) ? num(entryOf(one, i)[0]) : NaN)));
  const traces = numbers.map((one) => {
    const entries = report.runs.map((_, i) => entryOf(one, i));
    return { x: names, y: entries.map((entry) => (entry ? entry[0] : null)), name: escaped(labelOf(one, "method")),
      mode: "lines+markers", line: { width: 1.5 }, error_y: { type: "data", symmetric: false, thickness: 1, width: 3,
        array: entries.map((entry) => (entry && entry[2] !== null ? num(entry[2]) - num(entry[0]) : 0)),
        arrayminus: entries.map((entry) => (entry && entry[1] !== null ? num(entry[0]) - num(entry[1]) : 0)) } };
  });
  const positive = all.filter((v) => Number.isFinite(v)).every((v) => v > 0);
  const axis = axisOf(title, all);
  return { traces, layout: { showlegend: true, legend: { orientation: "h", y: -0.25 }, height: 460,
    xaxis: { type: "category", automargin: true }, yaxis: positive ? axis : { ...axis, type: "linear", range: undefined, dtick: undefined, minor: undefined } } };
}

setUpTheme();
setUpMoved();
setUpNotCompared();
setUpHistory();
setUpRuns();
document.documentElement.dataset.ready = "yes";

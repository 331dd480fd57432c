"use strict";
// All records: thousands of rows, of which only those in sight are elements.

const ROW_HEIGHT = 30;
const RECORD_COLUMNS = ["method", "material", "scene", "measure", "metric", "value", "95% interval",
  "unit", "seed", "status"];

function allRecords() {
  const { list, metrics, units } = report.trials;
  const rows = [];
  list.forEach((trial, place) => {
    const scene = trial.c >= 0 ? report.scenes[trial.c] : "";
    const common = [report.methods[trial.d].label, report.materials[trial.m], scene, measureOf(trial)];
    const all = trial.records.length ? trial.records : [[-1, null, null, null, -1]];
    for (const [metric, value, low, high, unit] of all) {
      const cells = [...common, metric < 0 ? "" : metrics[metric], value === null ? NaN : num(value),
        low === null || high === null ? "" : `[${brief(low)}, ${brief(high)}]`,
        unit < 0 ? "" : units[unit], trial.seed, trial.status];
      rows.push({ place, trial, cells, text: [...common, cells[4], trial.status].join(" ").toLowerCase() });
    }
  });
  return rows;
}

function setUpRecords() {
  const place = section("records", "All records");
  const details = el("details", {}, el("summary", {}, "Every number of every trial"));
  place.append(details);
  details.addEventListener("toggle", () => {
    if (details.open && details.children.length === 1) details.append(recordTable(allRecords()));
  });
}

function recordTable(rows) {
  const state = { sort: -1, up: true, words: [], shown: rows };
  const count = el("span", { class: "dim" });
  const inner = el("div", { class: "rows", role: "rowgroup" });
  const frame = el("div", { class: "records", tabindex: 0, role: "table", "aria-label": "All records",
    "aria-rowcount": rows.length });
  const head = el("div", { class: "record head", role: "row" });
  const draw = () => {
    const first = Math.max(0, Math.floor(frame.scrollTop / ROW_HEIGHT) - 5);
    const last = Math.min(state.shown.length, first + Math.ceil(frame.clientHeight / ROW_HEIGHT) + 12);
    inner.style.height = `${state.shown.length * ROW_HEIGHT}px`;
    inner.replaceChildren(...state.shown.slice(first, last).map((row, i) => recordRow(row, first + i)));
  };
  const order = () => {
    const kept = rows.filter((row) => state.words.every((word) => row.text.includes(word))
      && !isHidden("methods", row.trial.d) && !isHidden("materials", row.trial.m)
      && !isHidden("scenes", row.trial.c));
    if (state.sort >= 0) kept.sort((a, b) => compareCells(a.cells[state.sort], b.cells[state.sort], state.up ? 1 : -1));
    state.shown = kept;
    count.textContent = `${kept.length} of ${rows.length} records`;
    frame.scrollTop = 0;
    for (const one of head.children) {
      const mine = Number(one.dataset.at) === state.sort;
      one.setAttribute("aria-sort", mine ? (state.up ? "ascending" : "descending") : "none");
    }
    draw();
  };
  RECORD_COLUMNS.forEach((name, at) => {
    const set = () => { state.up = state.sort === at ? !state.up : true; state.sort = at; order(); };
    head.append(el("span", { role: "columnheader", "data-at": at }, button(name, set)));
  });
  const search = el("input", { type: "search", placeholder: "words, all of which a row has: leather speedup studio",
    "aria-label": "Filter records",
    on: { input: () => { state.words = search.value.toLowerCase().split(/\s+/).filter(Boolean); order(); } } });
  frame.append(head, inner);
  frame.addEventListener("scroll", () => requestAnimationFrame(draw));
  inner.addEventListener("click", (event) => {
    const pressed = event.target.closest(".record");
    if (pressed) openTrials([state.shown[Number(pressed.dataset.at)].place], "Record");
  });
  const made = el("div", {}, el("div", { class: "form" }, search, count), frame);
  requestAnimationFrame(() => followKey(hiddenKey, order, frame));
  return made;
}

function compareCells(a, b, sign) {
  if (typeof a === "string") return sign * (a < b ? -1 : a > b ? 1 : 0);
  if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
  return sign * (a - b);
}

function recordRow(row, at) {
  return el("button", { type: "button", class: "record", role: "row", "data-at": at,
    style: `top:${at * ROW_HEIGHT}px` },
  row.cells.map((cell, i) => el("span", { role: "cell" }, i === 5 ? brief(cell) : String(cell))));
}

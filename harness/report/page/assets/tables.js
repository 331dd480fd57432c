"use strict";
// Tables that sort, filter and hide; a number opens the trials behind it.

function setUpTables() {
  const tables = report.tables.filter((table) => table.name !== "status");
  if (!tables.length) return;
  const place = section("tables", "Tables");
  place.append(el("p", { class: "dim" }, "A heading sorts. Every number opens the trials that it comes from. Bars under the numbers are 95% intervals on the scale of their section."));
  tables.forEach((table, i) => place.append(foldedTable(table, i === 0)));
}

/** A table behind its title, drawn when it is opened. */
function foldedTable(table, open) {
  const made = el("details", { class: "table", id: `table-${table.name}`, open }, el("summary", {}, table.title));
  let drawn = false;
  const draw = () => {
    if (drawn || !made.open) return;
    drawn = true;
    made.append(wholeTable(table));
  };
  made.addEventListener("toggle", draw);
  draw();
  return made;
}

function wholeTable(table) {
  const state = { sort: {}, filter: "", off: new Set() };
  const body = el("div", {});
  const draw = () => {
    const columns = table.columns.map((_, i) => i).filter((i) => !state.off.has(i)
      && !isHidden("methods", table.columnMethods[i]));
    refill(body, table.sections
      .filter((part) => !isHidden("scenes", part.scene))
      .map((part, at) => tableSection(table, part, at, columns, state)));
  };
  const filter = el("input", { type: "search", placeholder: `filter by ${table.corner}`,
    "aria-label": `Filter rows of ${table.title}`,
    on: { input: () => { state.filter = filter.value.toLowerCase(); draw(); } } });
  const columns = el("details", { class: "menu" }, el("summary", {}, "Columns"),
    el("div", {}, table.columns.map((name, i) => checkbox(name, true, (on) => {
      if (on) state.off.delete(i); else state.off.add(i);
      draw();
    }))));
  followKey(hiddenKey, draw, body);
  const files = ["md", "csv", "tex"].map((end) => el("a", { href: `${encodeURIComponent(table.name)}.${end}` }, end));
  return el("div", {},
    el("p", { class: "caption" }, table.caption),
    el("div", { class: "form" }, table.sections.some((s) => s.rows.length > 2) ? filter : null, columns,
      el("span", { class: "files" }, "as ", files.flatMap((one, i) => (i ? [" · ", one] : [one])))),
    body,
    table.constant.length ? el("p", { class: "caption" }, table.constant.join(" ")) : null,
    el("ul", { class: "notes" }, table.legend.map((line) => el("li", {}, line))),
    notesOf(table));
}

/** What the marks † and ‡ of a table's numbers stand for; many are folded, hovering tells each. */
function notesOf(table) {
  if (!table.notes.length) return null;
  const list = el("ul", { class: "notes" },
    table.notes.map((note, i) => el("li", { value: i + 1 }, el("sup", {}, i + 1), " ", note)));
  return table.notes.length < 8 ? list : el("details", { class: "notes" },
    el("summary", {}, `${table.notes.length} notes on numbers, † and ‡ (also shown over each)`), list);
}

function tableSection(table, part, at, columns, state) {
  const rows = part.rows.filter((row) => !isHidden("materials", row.material)
    && !isHidden("methods", row.method) && row.label.toLowerCase().includes(state.filter));
  const absent = absentColumns(rows, columns);
  const mine = columns.filter((i) => !absent.has(i));
  const cells = rows.flatMap((row) => mine.map((i) => row.cells[i]));
  const axis = scaleOf(cells.flatMap((cell) => (cell.l === undefined ? [] : [num(cell.v), num(cell.l), num(cell.h)])
    .filter((v) => Number.isFinite(v))));
  const made = new Map(rows.map((row) => [row, tableRow(table, part, row, mine, axis)]));
  const body = el("tbody", {});
  const heads = el("tr", {});
  let sorted = rows;
  // Rows are moved, not made again.
  const arrange = () => {
    const sort = state.sort[at];
    sorted = sort ? inOrder(rows, sort) : rows;
    body.append(...sorted.map((row) => made.get(row)));
    for (const head of heads.children) {
      const up = sort && sort.column === Number(head.dataset.column) ? sort.up : null;
      head.setAttribute("aria-sort", up === null ? "none" : up ? "ascending" : "descending");
      head.firstChild.dataset.sorted = up === null ? "" : up ? " ▲" : " ▼";
    }
  };
  const heading = (name, column) => el("th", { scope: "col", data: { column } }, button(name, () => {
    state.sort[at] = nextSort(state.sort[at], column, table.best);
    arrange();
  }));
  heads.append(heading(table.corner, -1), ...mine.map((i) => heading(table.columns[i], i)));
  arrange();
  const grid = el("table", { class: table.words ? "words" : "" }, el("thead", {}, heads), body);
  grid.addEventListener("click", (event) => {
    const pressed = event.target.closest("button[data-row]");
    if (!pressed) return;
    const row = sorted[pressed.closest("tr").sectionRowIndex];
    const cell = row.cells[Number(pressed.dataset.column)];
    openTrials(cell.k, [table.title, part.title, row.label, table.columns[pressed.dataset.column],
      cell.no === undefined ? `${cell.t} ${cell.i || ""}` : "†"].filter(Boolean).join(" · "));
  });
  return el("div", {}, part.title ? el("h4", {}, part.title) : null,
    el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": part.title || table.title }, grid),
  absent.size ? el("p", { class: "caption" }, withoutNumber(table, rows, absent)) : null);
}

/** Columns (of several) in which no row has a number or a trial, all for the same reason. */
function absentColumns(rows, columns) {
  const alike = (i) => rows.every((row) => row.cells[i].no !== undefined && !row.cells[i].k
    && row.cells[i].no === rows[0].cells[i].no);
  const found = rows.length > 2 ? columns.filter(alike) : [];
  return new Set(found.length < columns.length ? found : []);
}

function withoutNumber(table, rows, absent) {
  const by = new Map();
  for (const i of absent) {
    const why = table.notes[rows[0].cells[i].no];
    by.set(why, [...(by.get(why) || []), table.columns[i]]);
  }
  return [...by].map(([why, names]) => `Without a number here: ${names.join(", ")} (${why}).`).join(" ");
}

/** Sorted by a column, what has no number last, means below all. */
function inOrder(rows, sort) {
  const key = (row) => (sort.column < 0 ? row.label : num(row.cells[sort.column].v));
  const sign = sort.up ? 1 : -1;
  return [...rows].sort((a, b) => {
    if (Boolean(a.summary) !== Boolean(b.summary)) return a.summary ? 1 : -1;
    const [x, y] = [key(a), key(b)];
    if (typeof x === "string") return sign * x.localeCompare(y);
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
    return sign * (x - y);
  });
}

/** A first press shows the best on top, a second the worst, a third the suite's own order. */
function nextSort(sort, column, best) {
  const first = column < 0 || best !== "high";
  if (!sort || sort.column !== column) return { column, up: first };
  return sort.up === first ? { column, up: !first } : undefined;
}

function tableRow(table, part, row, columns, axis) {
  return el("tr", { class: row.summary ? "summary" : "" },
    el("th", { scope: "row", title: row.about }, row.label),
    columns.map((i) => tableCell(table, row.cells[i], i, axis)));
}

function tableCell(table, cell, column, axis) {
  const why = cell.no !== undefined ? table.notes[cell.no] : cell.w !== undefined ? table.notes[cell.w] : "";
  const words = cell.no !== undefined ? why
    : [cell.i ? `${cell.t}, 95% interval from ${cell.i.slice(1, -1).replace(", ", " to ")}` : cell.t, why].filter(Boolean).join(": ");
  const inside = [];
  if (cell.no !== undefined) {
    inside.push(el("span", { class: "warning" }, "†", el("sup", {}, cell.no + 1)));
  } else {
    inside.push(el(cell.bold ? "b" : cell.ceiling ? "i" : "span", {}, cell.t));
    if (cell.w !== undefined) inside.push(el("span", { class: "warning" }, "‡", el("sup", {}, cell.w + 1)));
    if (cell.i) inside.push(el("small", {}, cell.i));
    if (cell.l !== undefined && cell.i) inside.push(bar(cell, axis, "currentColor", 7));
  }
  const shown = cell.k
    ? el("button", { type: "button", title: words, "data-row": "", "data-column": column }, inside)
    : el("span", { title: words }, inside);
  return el("td", { class: cell.shade || "" }, shown);
}

"use strict";
// Elements. All text goes in as text, never as markup.

/** An element with attributes; `on` holds listeners, children are nodes or texts. */
function el(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) element.addEventListener(event, listener);
    } else if (name === "data") {
      Object.assign(element.dataset, value);
    } else {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return element;
}

const FOCUSABLE = "button, input, select, summary, a, [tabindex]";

/** Replace what is in `place`; the focus stays with the element of the same position. */
function refill(place, ...children) {
  const at = [...place.querySelectorAll(FOCUSABLE)].indexOf(document.activeElement);
  place.replaceChildren(...children.flat(Infinity).filter(Boolean));
  if (at < 0) return;
  const now = place.querySelectorAll(FOCUSABLE)[at];
  if (now) now.focus({ preventScroll: true });
}

/** A part of the page with a heading and a link in the navigation. */
function section(id, title, ...children) {
  const made = el("section", { id }, el("h2", {}, title), ...children);
  document.getElementById("main").append(made);
  const link = el("a", { href: `#${id}` }, title);
  document.getElementById("sections").append(el("li", {}, link));
  return made;
}

/** Calls `draw` once when `element` comes near the window. */
function whenSeen(element, draw) {
  const watch = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    watch.disconnect();
    draw();
  }, { rootMargin: "300px" });
  watch.observe(element);
}

/**
 * Calls `draw` now, and again where `key()` is another than before. With an `element`, what is
 * out of the window's reach waits until it comes near or is printed.
 */
function followKey(key, draw, element = null) {
  let last = null;
  let near = true;
  const update = () => {
    const now = JSON.stringify(key());
    if (now === last) return;
    last = now;
    draw();
  };
  if (element) {
    new IntersectionObserver((entries) => {
      near = entries[entries.length - 1].isIntersecting;
      if (near) update();
    }, { rootMargin: "300px" }).observe(element);
    window.addEventListener("beforeprint", update);
  }
  update();
  follow(() => { if (near) update(); });
}

/** What views of one material and scene depend on. */
function cellKey() {
  return [choice.material, choice.scene, [...hidden.methods], darkNow()];
}

/** What views of all materials and scenes depend on. */
function hiddenKey() {
  return [[...hidden.methods], [...hidden.materials], [...hidden.scenes], darkNow()];
}

/** A labelled select; `options` are [value, text]. */
function chooser(label, options, value, set) {
  const select = el("select", { on: { change: () => set(Number(select.value)) } },
    options.map(([at, text]) => el("option", { value: at, selected: at === value }, text)));
  return el("label", { class: "field" }, el("span", {}, label), select);
}

function checkbox(label, checked, set) {
  const box = el("input", { type: "checkbox", checked, on: { change: () => set(box.checked) } });
  return el("label", { class: "check" }, box, label);
}

function button(text, run, attributes = {}) {
  return el("button", { type: "button", ...attributes, on: { click: run } }, text);
}

/** One of several, as buttons; `options` are [value, text]. */
function switches(label, options, value, set) {
  const group = el("div", { class: "switches", role: "group", "aria-label": label });
  const show = (now) => {
    for (const one of group.children) one.setAttribute("aria-pressed", one.dataset.value === now);
  };
  for (const [each, text] of options) {
    group.append(button(text, () => { show(each); set(each); }, { "data-value": each }));
  }
  show(value);
  return group;
}

// --- which methods, materials and scenes are shown ---------------------------------------------

function setUpFilters() {
  const kinds = [["methods", report.methods.map((m) => m.label)], ["materials", report.materials],
    ["scenes", report.scenes]];
  const place = document.getElementById("filters");
  const details = el("details", { class: "filters" }, el("summary", {}, "Show and hide"));
  const summary = details.firstChild;
  for (const [kind, names] of kinds) {
    if (names.length < 2) continue;
    const list = el("div", { class: "chips" }, el("b", {}, kind));
    names.forEach((name, at) => {
      list.append(button(name, () => toggleHidden(kind, at), { class: "chip", data: { kind, at } }));
    });
    const all = (out) => { hidden[kind] = new Set(out ? names.keys() : []); changed(); };
    list.append(button("all", () => all(false), { class: "plain" }));
    list.append(button("none", () => all(true), { class: "plain" }));
    details.append(list);
  }
  place.append(details);
  follow(() => {
    let count = 0;
    for (const chip of details.querySelectorAll(".chip")) {
      const off = isHidden(chip.dataset.kind, Number(chip.dataset.at));
      chip.setAttribute("aria-pressed", !off);
      if (chip.dataset.kind === "methods") {
        chip.style.setProperty("--swatch", colourOf(Number(chip.dataset.at)));
      }
      count += off;
    }
    summary.textContent = count
      ? `Show and hide: ${count} hidden`
      : "Show and hide methods, materials, scenes";
  });
}

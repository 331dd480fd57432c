"use strict";
// Renders of equal time beside their reference: flip, side by side, wipe.

const viewer = { mode: "flip", show: "render", stops: 0, at: -1, peek: null, other: -1, wipe: 0.5,
  frames: true };

function setUpViewer() {
  if (!report.images.groups.length) return;
  const place = section("images", "Where the images differ");
  const sizes = report.images.sizes.join(", ");
  const exactly = report.images.exact ? "Values are half floats, as stored."
    : `Values are rounded, off by up to ${percent(num(report.images.off))} of an image's root mean square.`;
  place.append(el("p", { class: "dim" },
    `Rendered in equal time, at ${sizes} pixels; the reference is a long render, or the mean of all unbiased methods' long ones. ${exactly} Number keys, arrow keys in the list and hovering flip; the wheel zooms, dragging pans, a double press shows all again. With the image in focus, arrows move it, + and − zoom, Home shows all, and Shift with arrows reads a pixel.`));
  const top = el("div", { class: "form" });
  const stage = el("div", { class: "stage" });
  const values = el("div", { class: "values scroll", tabindex: 0 });
  place.append(top, stage, values);
  place.addEventListener("keydown", (event) => {
    if (!/^[0-9]$/.test(event.key) || event.target.matches("input, select")) return;
    const group = groupAt();
    const shots = group ? shownShots(group) : [];
    const at = event.key === "0" ? -1 : Number(event.key) - 1;
    if (at < shots.length) flipTo(at < 0 ? -1 : shots[at].method);
  });
  // Beyond nine methods there are no digits.
  place.addEventListener("keydown", (event) => {
    const list = event.target.closest(".flips");
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!list || !step) return;
    event.preventDefault();
    const all = [...list.children];
    const next = all[Math.min(all.length - 1, Math.max(0, all.indexOf(event.target) + step))];
    next.focus();
    flipTo(Number(next.dataset.method));
  });
  viewer.redraw = () => drawViewer(top, stage, values);
  whenSeen(place, () => followKey(cellKey, viewer.redraw, place));
}

function shownShots(group) {
  return group.shots.filter((shot) => !isHidden("methods", shot.method));
}

function shotOf(group, method) {
  return group.shots.find((shot) => shot.method === method) || null;
}

function flipTo(method) {
  viewer.at = method;
  viewer.peek = null;
  if (viewer.marks) viewer.marks();
}

/** Zoom all panes to one of the proposed squares. */
function showSquare(at) {
  const group = groupAt();
  const square = group && group.squares[at];
  if (!square) return;
  look({ zoom: group.width / square.side / 1.6, x: (square.x + square.side / 2) / group.width,
    y: (square.y + square.side / 2) / group.height });
}

function drawViewer(top, stage, values) {
  panes.clear();
  const group = groupAt();
  const set = (changes) => { Object.assign(viewer, changes); viewer.redraw(); };
  const cells = report.images.groups.map((one, at) => [at,
    [report.materials[one.material], one.scene >= 0 ? report.scenes[one.scene] : ""].filter(Boolean).join(", ")]);
  // So that the first of the list can be chosen where the page's choice has no images.
  if (!group) cells.unshift([-1, "choose one"]);
  const shows = Object.entries(SHOWS).filter(([name]) => (name !== "flip" || report.images.flip)
    && (!["relmse", "flip"].includes(name) || (group && group.reference !== null)))
    .map(([name, about]) => [name, about.label]);
  const exposure = el("input", { type: "range", min: -6, max: 6, step: 0.5, value: viewer.stops,
    "aria-label": "exposure in stops", on: { input: () => {
      viewer.stops = Number(exposure.value);
      exposure.nextSibling.textContent = `${viewer.stops > 0 ? "+" : ""}${viewer.stops}`;
      if (viewer.paint) viewer.paint();
    } } });
  refill(top,
    chooser("image", cells, report.images.groups.indexOf(group), (at) => at >= 0 && choose({
      material: report.images.groups[at].material, scene: report.images.groups[at].scene })),
    switches("layout", [["flip", "flip"], ["side", "side by side"], ["wipe", "wipe"]], viewer.mode, (mode) => set({ mode })),
    switches("shown", shows, viewer.show, (show) => set({ show })),
    el("label", { class: "field" }, el("span", {}, "exposure, stops"), exposure, el("output", {}, String(viewer.stops))),
    button("whole image", () => look({ x: 0.5, y: 0.5, zoom: 1 })),
    checkbox("frames", viewer.frames, (frames) => { viewer.frames = frames; look({}); }));
  if (!group) {
    const said = `${report.materials[choice.material]}${choice.scene >= 0 ? ` in ${report.scenes[choice.scene]}` : ""}`;
    stage.replaceChildren(el("p", { class: "warning" }, `No images of ${said} are stored here; the list above has those that are.`));
    values.replaceChildren();
    return;
  }
  if (group.squares.length) {
    top.append(el("div", { class: "squares" }, "where methods differ most: ", group.squares.map((square, i) => button(
      square.said, () => showSquare(i), { class: "plain" }))));
  }
  if (viewer.show !== "render") top.append(colourScale(viewer.show));
  ({ flip: flipStage, side: sideStage, wipe: wipeStage })[viewer.mode](group, stage, () => pixelValues(group, values));
  pixelValues(group, values);
}

/** A pane of one method (or, with -1, the reference) that repaints itself. */
function shotPane(group, method, pointed) {
  const shot = method() >= 0 ? shotOf(group, method()) : null;
  const held = { shown: null, why: "", key: "" };
  const pane = makePane(shot ? report.methods[shot.method].label : "reference", group, (context, at) => {
    drawBitmap(context, at, held.shown, held.why);
    if (viewer.frames) drawSquares(context, at, group);
  }, pointed);
  pane.paint = async () => {
    const now = method() >= 0 ? shotOf(group, method()) : null;
    held.key = `${method()} ${viewer.show} ${viewer.stops}`;
    const key = held.key;
    const shown = await bitmap(group, now, viewer.show, viewer.stops);
    if (key !== held.key) return;
    held.shown = shown;
    held.why = now ? now.why || "this map is of what differs from a reference"
      : group.reference === null ? "no reference: no long render is stored" : "the reference itself has no error";
    pane.draw();
  };
  pane.paint();
  return pane;
}

function flipStage(group, stage, pointed) {
  const now = () => (viewer.peek === null ? viewer.at : viewer.peek);
  const pane = shotPane(group, now, pointed);
  const caption = el("figcaption", { "aria-live": "polite" });
  const list = el("div", { class: "flips", role: "group", "aria-label": "Methods" });
  const shots = shownShots(group);
  const entries = [[-1, "0", "reference", ""], ...shots.map((shot, i) => [shot.method, i < 9 ? i + 1 : "",
    report.methods[shot.method].label, shot.why ? "†" : `${shot.spp}, relMSE ${shot.error}${shot.flipMean ? `, FLIP ${shot.flipMean}` : ""}`])];
  for (const [method, key, name, said] of entries) {
    const one = el("button", { type: "button", data: { method } },
      el("kbd", {}, key), swatch(method), el("span", {}, name), el("small", {}, said));
    one.addEventListener("click", () => flipTo(method));
    one.addEventListener("pointerenter", () => { viewer.peek = method; viewer.marks(); });
    one.addEventListener("pointerleave", () => { viewer.peek = null; viewer.marks(); });
    list.append(one);
  }
  viewer.marks = () => {
    for (const one of list.children) one.setAttribute("aria-pressed", Number(one.dataset.method) === now());
    const [, , name, said] = entries.find(([method]) => method === now()) || entries[0];
    const shot = shotOf(group, now());
    const parts = [el("b", {}, name), said ? ` ${said} ` : " "];
    if (shot && shot.trial !== undefined) parts.push(button("open its trial", () => openTrials([shot.trial], name), { class: "plain" }));
    caption.replaceChildren(...parts);
    pane.paint();
  };
  viewer.paint = () => pane.paint();
  stage.replaceChildren(el("figure", { class: "big" }, pane.canvas, caption), list);
  viewer.marks();
}

function sideStage(group, stage, pointed) {
  const methods = [-1, ...shownShots(group).map((shot) => shot.method)];
  const made = methods.map((method) => shotPane(group, () => method, pointed));
  viewer.marks = null;
  viewer.paint = () => made.forEach((pane) => pane.paint());
  stage.replaceChildren(el("div", { class: "panes" }, made.map((pane, i) => {
    const shot = shotOf(group, methods[i]);
    const name = shot ? report.methods[shot.method].label : "reference";
    const said = !shot ? "" : shot.why ? "†" : `${shot.spp}, relMSE ${shot.error}`;
    return el("figure", {}, pane.canvas, el("figcaption", {}, el("b", {}, name), " ", said));
  })));
  viewer.paint();
}

function wipeStage(group, stage, pointed) {
  const shots = shownShots(group);
  if (viewer.at < 0 && viewer.other < 0 && shots.length) viewer.other = shots[0].method;
  const options = [[-1, "reference"], ...shots.map((shot) => [shot.method, report.methods[shot.method].label])];
  const held = { left: null, right: null };
  const pane = makePane("wipe", group, (context, at) => {
    drawBitmap(context, at, held.left, "");
    const edge = viewer.wipe * context.canvas.width;
    context.save();
    context.beginPath();
    context.rect(edge, 0, context.canvas.width - edge, context.canvas.height);
    context.clip();
    context.clearRect(0, 0, context.canvas.width, context.canvas.height);
    drawBitmap(context, at, held.right, "");
    context.restore();
    context.fillStyle = "#ffcc00";
    context.fillRect(edge - 1, 0, 2, context.canvas.height);
    if (viewer.frames) drawSquares(context, at, group);
  }, pointed);
  const paint = async () => {
    const of = (method) => bitmap(group, method >= 0 ? shotOf(group, method) : null, viewer.show, viewer.stops);
    [held.left, held.right] = await Promise.all([of(viewer.at), of(viewer.other)]);
    pane.draw();
  };
  const slider = el("input", { type: "range", min: 0, max: 1, step: 0.005, value: viewer.wipe, class: "wipe",
    "aria-label": "where the images meet", on: { input: () => { viewer.wipe = Number(slider.value); pane.draw(); } } });
  viewer.marks = () => { paint(); };
  viewer.paint = paint;
  stage.replaceChildren(el("figure", { class: "big" }, slider, pane.canvas, el("figcaption", { class: "form" },
    chooser("left", options, viewer.at, (at) => { viewer.at = at; paint(); }),
    chooser("right", options, viewer.other, (other) => { viewer.other = other; paint(); }))));
  paint();
}

/** The values of all methods under the pointer. */
async function pixelValues(group, place) {
  if (!view.pointer) {
    place.replaceChildren(el("p", { class: "dim" }, "Point at the image to read its values (or Shift and arrows with the image in focus)."));
    return;
  }
  const [x, y] = view.pointer;
  const i = y * group.width + x;
  const rows = [];
  const right = group.reference === null ? null : (await image(group.reference)).planes;
  const truth = right ? luminanceAt(right, i) : NaN;
  if (right) rows.push(["reference", right, NaN]);
  for (const shot of shownShots(group)) {
    if (shot.image === undefined) continue;
    const { planes } = await image(shot.image);
    const error = (luminanceAt(planes, i) - truth) ** 2 / (truth * truth + num(group.floor));
    rows.push([report.methods[shot.method].label, planes, error]);
  }
  place.replaceChildren(el("table", {},
    el("thead", {}, el("tr", {}, [`pixel ${x}, ${y}`, "red", "green", "blue", "luminance", "relMSE"].map((h) => el("th", { scope: "col" }, h)))),
    el("tbody", {}, rows.map(([name, planes, error]) => el("tr", {}, el("th", { scope: "row" }, name),
      planes.map((plane) => el("td", {}, brief(plane[i]))), el("td", {}, brief(luminanceAt(planes, i))),
      el("td", {}, Number.isNaN(error) ? "" : brief(error)))))));
}

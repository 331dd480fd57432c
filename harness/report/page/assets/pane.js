"use strict";
// Panes that pan and zoom together, and show the pixel under the pointer.

const view = { x: 0.5, y: 0.5, zoom: 1, pointer: null };
const panes = new Set();
const PANE_KEYS = "arrows move, + and − zoom, Home shows all, Shift and arrows read a pixel, 0 to 9 flip";

/** The same view for all panes: `x`, `y` in shares of the image, `zoom` 1 shows all of it. */
function look(values) {
  Object.assign(view, values);
  view.zoom = Math.min(64, Math.max(1, view.zoom));
  const half = 0.5 / view.zoom;
  view.x = Math.min(1 - half, Math.max(half, view.x));
  view.y = Math.min(1 - half, Math.max(half, view.y));
  for (const pane of panes) pane.draw();
}

/** A canvas; `paintOn(context, place)` draws with `place` mapping shares of the image to pixels. */
function makePane(label, group, paintOn, pointed) {
  const canvas = el("canvas", { tabindex: 0, role: "img", "aria-label": `${label}: ${PANE_KEYS}` });
  const pane = { canvas, draw };
  const ratio = () => group.height / group.width;

  function size() {
    const width = canvas.clientWidth || 200;
    const dots = Math.min(2, window.devicePixelRatio || 1);
    const want = [Math.round(width * dots), Math.round(width * ratio() * dots)];
    if (canvas.width !== want[0] || canvas.height !== want[1]) [canvas.width, canvas.height] = want;
  }

  function frame() {
    const across = canvas.width * view.zoom;
    const down = canvas.height * view.zoom;
    return { x: canvas.width / 2 - view.x * across, y: canvas.height / 2 - view.y * down, across, down };
  }

  function draw() {
    if (!canvas.isConnected) return;
    size();
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    context.clearRect(0, 0, canvas.width, canvas.height);
    const at = frame();
    paintOn(context, at);
    if (view.pointer) crosshair(context, at);
  }

  function crosshair(context, at) {
    const [px, py] = view.pointer;
    const side = at.across / group.width;
    context.strokeStyle = "#ffcc00";
    context.lineWidth = 1.5;
    context.strokeRect(at.x + px * side, at.y + py * side, side, side);
  }

  function shareOf(event) {
    const box = canvas.getBoundingClientRect();
    const at = frame();
    const dots = canvas.width / box.width;
    return [((event.clientX - box.left) * dots - at.x) / at.across,
      ((event.clientY - box.top) * dots - at.y) / at.down];
  }

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const [x, y] = shareOf(event);
    const zoom = Math.min(64, Math.max(1, view.zoom * 1.25 ** -Math.sign(event.deltaY)));
    const keep = view.zoom / zoom;
    look({ zoom, x: x + (view.x - x) * keep, y: y + (view.y - y) * keep });
  }, { passive: false });

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    held = { event, x: view.x, y: view.y };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (held && view.zoom > 1) {
      const box = canvas.getBoundingClientRect();
      look({
        x: held.x - (event.clientX - held.event.clientX) / box.width / view.zoom,
        y: held.y - (event.clientY - held.event.clientY) / box.height / view.zoom,
      });
    }
    const [x, y] = shareOf(event);
    const inside = x >= 0 && y >= 0 && x < 1 && y < 1;
    view.pointer = inside ? [Math.floor(x * group.width), Math.floor(y * group.height)] : null;
    look({});
    pointed();
  });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointerleave", () => { view.pointer = null; look({}); pointed(); });
  canvas.addEventListener("dblclick", () => look({ x: 0.5, y: 0.5, zoom: 1 }));
  // The pixel that is read moves by one, from the middle of what is in sight.
  function readNext(across, down) {
    const [x, y] = view.pointer || [Math.floor(view.x * group.width), Math.floor(view.y * group.height)];
    const within = (v, size) => Math.min(size - 1, Math.max(0, v));
    const [column, row] = [within(x + across, group.width), within(y + down, group.height)];
    view.pointer = [column, row];
    const half = 0.5 / view.zoom;
    const keep = (at, share) => Math.min(share + half, Math.max(share - half, at));
    look({ x: keep(view.x, (column + 0.5) / group.width), y: keep(view.y, (row + 0.5) / group.height) });
    pointed();
  }

  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.shiftKey && steps[event.key]) {
      event.preventDefault();
      readNext(...steps[event.key]);
      return;
    }
    const step = 0.1 / view.zoom;
    const moves = { ArrowLeft: { x: view.x - step }, ArrowRight: { x: view.x + step },
      ArrowUp: { y: view.y - step }, ArrowDown: { y: view.y + step },
      "+": { zoom: view.zoom * 1.5 }, "-": { zoom: view.zoom / 1.5 }, Home: { x: 0.5, y: 0.5, zoom: 1 } };
    if (!moves[event.key]) return;
    event.preventDefault();
    look(moves[event.key]);
  });
  panes.add(pane);
  return pane;
}

/** Draw a bitmap, or why there is none. */
function drawBitmap(context, at, shown, why) {
  if (shown) {
    context.drawImage(shown, at.x, at.y, at.across, at.down);
    return;
  }
  context.fillStyle = getComputedStyle(context.canvas).color;
  context.font = `${Math.round(context.canvas.width / 22)}px sans-serif`;
  context.textAlign = "center";
  why.split(/[:;] /).slice(0, 3).forEach((line, i) => {
    context.fillText(line.slice(0, 48), context.canvas.width / 2, context.canvas.height / 2 + i * context.canvas.width / 18);
  });
}

function drawSquares(context, at, group) {
  context.lineWidth = 1.5;
  group.squares.forEach((square, i) => {
    const unit = at.across / group.width;
    context.strokeStyle = i ? "#88aacc" : "#ffcc00";
    context.strokeRect(at.x + square.x * unit, at.y + square.y * unit, square.side * unit, square.side * unit);
  });
}

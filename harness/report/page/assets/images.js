"use strict";
// Pixels to colours: tone mapping, false colour, and maps of errors with their scales.

const LUMINANCE = [0.212671, 0.71516, 0.072169];
// From dark to light, monotonic in lightness, so that it reads in grey.
const STOPS_OF_COLOUR = [[0, 0, 4], [40, 11, 84], [101, 21, 110], [159, 42, 99], [212, 72, 66],
  [245, 125, 21], [250, 193, 39], [252, 255, 164]];
const SHOWS = {
  render: { label: "render" },
  light: { label: "false colour", low: -8, high: 2, said: "stops of luminance, white 0" },
  relmse: { label: "relMSE", low: -4, high: 1, said: "powers of ten of the relative squared error" },
  flip: { label: "FLIP", low: 0, high: 1, said: "FLIP, 0 alike to 1" },
};

const bitmaps = new Map();

function groupAt() {
  return report.images.groups.find((group) => group.material === choice.material
    && (group.scene === choice.scene || group.scene === -1));
}

function luminanceAt(planes, i) {
  return LUMINANCE[0] * planes[0][i] + LUMINANCE[1] * planes[1][i] + LUMINANCE[2] * planes[2][i];
}

/** A colour [r, g, b] for `t` between 0 and 1. */
function mapped(t) {
  const at = Math.min(1, Math.max(0, t)) * (STOPS_OF_COLOUR.length - 1);
  const i = Math.min(STOPS_OF_COLOUR.length - 2, Math.floor(at));
  return STOPS_OF_COLOUR[i].map((v, c) => v + (at - i) * (STOPS_OF_COLOUR[i + 1][c] - v));
}

function display(linear) {
  const x = Math.min(1, Math.max(0, linear));
  return 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
}

/** What `show` has for each pixel, before it is a colour; null where there is nothing to show. */
async function quantity(group, shot, show) {
  const shown = shot ? shot.image : group.reference;
  if (shown === undefined || shown === null) return null;
  if (show === "flip") return shot && shot.flip !== undefined ? (await image(shot.flip)).planes[0] : null;
  const { planes } = await image(shown);
  const count = planes[0].length;
  const values = new Float32Array(count);
  if (show === "light") {
    const scale = num(group.exposure);
    for (let i = 0; i < count; i += 1) values[i] = Math.log2(luminanceAt(planes, i) * scale);
    return values;
  }
  if (group.reference === null) return null;
  const right = (await image(group.reference)).planes;
  const floor = num(group.floor);
  for (let i = 0; i < count; i += 1) {
    const truth = luminanceAt(right, i);
    values[i] = Math.log10((luminanceAt(planes, i) - truth) ** 2 / (truth * truth + floor));
  }
  return values;
}

/** A canvas of an image's own size; null where there is none. */
function bitmap(group, shot, show, stops) {
  const key = [report.images.groups.indexOf(group), shot ? shot.method : -1, show, stops].join();
  if (!bitmaps.has(key)) {
    // Old exposures are not kept: each is a canvas.
    if (bitmaps.size > 400) bitmaps.clear();
    bitmaps.set(key, paint(group, shot, show, stops));
  }
  return bitmaps.get(key);
}

async function paint(group, shot, show, stops) {
  const { width, height } = group;
  const data = new ImageData(width, height);
  if (show === "render") {
    const place = shot ? shot.image : group.reference;
    if (place === undefined || place === null) return null;
    const { planes } = await image(place);
    const scale = num(group.exposure) * 2 ** stops;
    for (let i = 0; i < width * height; i += 1) {
      for (let c = 0; c < 3; c += 1) data.data[4 * i + c] = display(planes[c][i] * scale);
      data.data[4 * i + 3] = 255;
    }
  } else {
    const values = await quantity(group, shot, show);
    if (!values) return null;
    const { low, high } = SHOWS[show];
    const shift = show === "light" ? stops : 0;
    for (let i = 0; i < values.length; i += 1) {
      const colour = mapped((values[i] + shift - low) / (high - low));
      data.data.set([...colour, 255], 4 * i);
    }
  }
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").putImageData(data, 0, 0);
  return canvas;
}

/** The colours of a map beside its numbers. */
function colourScale(show) {
  const { low, high, said } = SHOWS[show];
  const steps = Array.from({ length: 12 }, (_, i) => {
    const colour = mapped(i / 11).map(Math.round).join(",");
    return el("i", { style: `background:rgb(${colour})` });
  });
  return el("div", { class: "scale" }, el("span", {}, brief(low)), el("span", { class: "steps" }, steps),
    el("span", {}, brief(high)), el("span", { class: "dim" }, said));
}

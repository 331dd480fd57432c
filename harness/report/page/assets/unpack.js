"use strict";
// Arrays and scripts that the page carries deflated, as base64.

const pixelTexts = { data: null };
const unpacked = new Map();

function bytesOf(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Undo `plain.packed`: whole numbers of 8 or 16 bits, differences along rows of `width`. */
async function unpackArray(packed) {
  const steps = await inflated(packed.data);
  const count = packed.shape.reduce((a, b) => a * b, 1);
  const width = packed.shape[packed.shape.length - 1];
  const values = packed.bits === 8 ? new Uint8Array(count) : new Uint16Array(count);
  for (let i = 0; i < count; i += 1) {
    const step = packed.bits === 8 ? steps[i] : (steps[i] << 8) | steps[count + i];
    values[i] = i % width ? values[i - 1] + step : step;
  }
  return values;
}

let halves = null;

/** All 65536 half floats. */
function halfFloats() {
  if (halves) return halves;
  halves = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits += 1) {
    const power = (bits >> 10) & 31;
    const part = bits & 1023;
    let value = power ? 2 ** (power - 15) * (1 + part / 1024) : 2 ** -14 * (part / 1024);
    if (power === 31) value = part ? NaN : Infinity;
    halves[bits] = bits & 32768 ? -value : value;
  }
  return halves;
}

/** An image of the page: `{width, height, planes}`, planes being [3 or 1][height * width]. */
function image(place) {
  if (!unpacked.has(place)) unpacked.set(place, unpackImage(place));
  return unpacked.get(place);
}

async function unpackImage(place) {
  pixelTexts.data ||= JSON.parse(document.getElementById("pixels").textContent);
  const packed = pixelTexts.data[place];
  if (packed.webp) return unpackWebp(packed);
  const values = await unpackArray(packed);
  if (packed.bits === 8) {
    const [height, width] = packed.shape;
    return { width, height, planes: [Float32Array.from(values, (v) => v / 255)] };
  }
  const table = halfFloats();
  const [, height, width] = packed.shape;
  const all = Float32Array.from(values, (v) => table[v]);
  const size = width * height;
  return { width, height, planes: [0, 1, 2].map((c) => all.subarray(c * size, (c + 1) * size)) };
}

/** Of steps of a logarithm, or of a map of errors. */
async function unpackWebp(packed) {
  const blob = new Blob([bytesOf(packed.webp)], { type: "image/webp" });
  const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
  const { width, height } = bitmap;
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  const data = context.getImageData(0, 0, width, height).data;
  const planes = (packed.stops ? [0, 1, 2] : [0]).map((channel) => {
    const plane = new Float32Array(width * height);
    for (let i = 0; i < plane.length; i += 1) {
      const step = data[4 * i + channel] / (packed.steps || 255);
      plane[i] = packed.stops ? 2 ** (step * packed.stops + packed.top - packed.stops) : step;
    }
    return plane;
  });
  return { width, height, planes };
}

let plotlyLoaded = null;

/** Plotly, unpacked and run when the first plot is seen. */
function plotly() {
  plotlyLoaded ||= (async () => {
    const text = new TextDecoder().decode(await inflated(document.getElementById("plotly").textContent));
    document.head.append(el("script", {}, text));
    return window.Plotly;
  })();
  return plotlyLoaded;
}

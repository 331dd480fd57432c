// Rational-quadratic splines: the mathematics of harness/nets/spline.py over a block of rows.

#pragma once

#include "layers.h"

namespace {

constexpr float MINIMUM = 1e-3f, STEEPEST = 1e3f;
constexpr int MOST_BINS = 512;

struct Bin {
    Floats anchor, x0, x1, y0, y1, d0, d1;
};

INLINE Floats derivative(Floats raw) {
    // What is added is log(exp(1 - MINIMUM) - 1): zero is slope one.
    Floats v = raw / (1.0f + magnitude(raw) * (1 / STEEPEST)) + 0.539742417236952f;
    return MINIMUM + (v > 0.0f ? v : v * 0.0f) + log_of_one_and(exponential(-magnitude(v)));
}

// Knots [bins + 1] from the logits of bin sizes: from -1 up to the middle, from 1 down to it.
INLINE void knots(const float *logits, int bins, Floats *knot) {
    Floats top = load(logits);
    for (int k = 1; k < bins; k++) {
        Floats v = load(logits + k * BLOCK);
        top = v > top ? v : top;
    }
    Floats total = Floats{};
    for (int k = 0; k < bins; k++) {
        knot[k] = exponential(load(logits + k * BLOCK) - top);
        total = k ? total + knot[k] : knot[k];
    }
    const Floats scale = (2 - 2 * MINIMUM * bins) / total;
    const int half = bins / 2;
    Floats sum = Floats{};
    for (int k = 0; k <= half; k++) {
        Floats step = knot[k] * scale + 2 * MINIMUM;
        knot[k] = sum;
        sum = sum + step;
    }
    sum = Floats{};
    for (int k = bins - 1; k > half; k--) {
        Floats step = knot[k] * scale + 2 * MINIMUM;
        knot[k + 1] = sum;
        sum = sum - step;
    }
    knot[half + 1] = sum;
}

// The bin of `value` by its knots on x (axis 0) or y (axis 1).
INLINE Bin find(const float *numbers, int bins, Floats value, int axis, Floats (*knot)[MOST_BINS]) {
    knots(numbers, bins, knot[0]);
    knots(numbers + bins * BLOCK, bins, knot[1]);
    const float *slopes = numbers + 2 * bins * BLOCK;
    const int half = bins / 2;
    const Floats below = value + 1.0f, above = value - 1.0f, *along = knot[axis];
    Bin b = {all(-1.0f), knot[0][0], knot[0][1], knot[1][0], knot[1][1], Floats{}, load(slopes)};
    for (int k = 1; k < bins; k++) {
        Ints reached = along[k] <= (k <= half ? below : above);
        // The middle bin begins on one side and ends on the other.
        const float shift = k == half ? 2.0f : 0.0f;
        b.x0 = reached ? knot[0][k] : b.x0;
        b.x1 = reached ? knot[0][k + 1] + shift : b.x1;
        b.y0 = reached ? knot[1][k] : b.y0;
        b.y1 = reached ? knot[1][k + 1] + shift : b.y1;
        b.d0 = reached ? load(slopes + (k - 1) * BLOCK) : b.d0;
        b.d1 = reached ? (k + 1 < bins ? load(slopes + k * BLOCK) : Floats{}) : b.d1;
        if (k == half + 1) b.anchor = reached ? all(1.0f) : b.anchor;
    }
    b.d0 = derivative(b.d0);
    b.d1 = derivative(b.d1);
    return b;
}

INLINE Floats clipped(Floats v, Floats low, Floats high) {
    v = v < low ? low : v;
    return v > high ? high : v;
}

// One function for every caller, so that a density is the same bits wherever it is asked for.
__attribute__((noinline)) void warp(const float *numbers, int bins, const float *at, float *to,
                                    float *slopes) {
    Floats knot[2][MOST_BINS];
    for (int row = 0; row < BLOCK; row += WIDTH) {
        const Floats v = load(at + row);
        const Bin b = find(numbers + row, bins, v, 0, knot);
        const Floats width = b.x1 - b.x0, height = b.y1 - b.y0, s = height / width;
        const Floats x = clipped(v - b.anchor, b.x0, b.x1);
        const Floats xi = (x - b.x0) / width, rest = (b.x1 - x) / width;
        const Floats mixed = xi * rest, square = xi * xi, opposite = rest * rest;
        const Floats d = s * (square + opposite) + (b.d0 + b.d1) * mixed;
        const Floats y = b.anchor + (b.y0 + height * ((s * square + b.d0 * mixed) / d));
        const Floats ratio = s / d;
        const Floats slope = ratio * ratio * (b.d1 * square + 2.0f * s * mixed + b.d0 * opposite);
        const Ints inside = magnitude(v) < 1.0f;
        store(to + row, inside ? y : v);
        store(slopes + row, inside ? slope : all(1.0f));
    }
}

__attribute__((noinline)) void unwarp(const float *numbers, int bins, const float *at, float *to) {
    Floats knot[2][MOST_BINS];
    for (int row = 0; row < BLOCK; row += WIDTH) {
        const Floats v = load(at + row);
        const Bin b = find(numbers + row, bins, v, 1, knot);
        const Floats width = b.x1 - b.x0, height = b.y1 - b.y0, s = height / width;
        const Floats y = clipped(v - b.anchor, b.y0, b.y1);
        const Floats theta = (y - b.y0) / height, rest = (b.y1 - y) / height;
        const Floats e = b.d0 * rest - b.d1 * theta;
        const Floats t = magnitude(e) + square_root(e * e + 4.0f * s * s * theta * rest);
        const Ints rising = e >= 0.0f;
        const Floats near = 2.0f * s * (rising ? theta : rest);
        const Floats step = width * (near / (near + t));
        const Floats x = b.anchor + (rising ? b.x0 + step : b.x1 - step);
        store(to + row, magnitude(v) < 1.0f ? x : v);
    }
}

// What the network's outputs are used for; NOTHING tells what the network alone takes.
enum Use { OUTPUTS_THEMSELVES = 0, WARP = 1, UNWARP = 2, DRAW = 3, NOTHING = 4 };

// Extra columns per use: the value; for DRAW also keep (1 or 0), what to keep, and the chord.
INLINE int extra_columns(int use) { return use == DRAW ? 4 : use == WARP || use == UNWARP ? 1 : 0; }
INLINE int result_columns(int use, int outputs) {
    return use == OUTPUTS_THEMSELVES ? outputs : use == DRAW ? 3 : use == WARP ? 2 : use == UNWARP ? 1 : 0;
}

void splines(int use, const float *numbers, int bins, const float *const *extra, float *const *out) {
    if (use == WARP) {
        warp(numbers, bins, extra[0], out[0], out[1]);
    } else if (use == UNWARP) {
        unwarp(numbers, bins, extra[0], out[0]);
    } else {
        alignas(64) float at[BLOCK];
        unwarp(numbers, bins, extra[0], at);
        for (int row = 0; row < BLOCK; row += WIDTH) {
            const Floats chord = load(extra[3] + row);
            const Floats place = load(extra[1] + row) != 0.0f ? load(extra[2] + row) : load(at + row) * chord;
            store(out[0] + row, place);
            store(at + row, place / chord);
        }
        warp(numbers, bins, at, out[1], out[2]);
    }
}

}  // namespace

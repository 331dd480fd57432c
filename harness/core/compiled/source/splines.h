// Rational-quadratic splines: the mathematics of harness/nets/spline.py over a block of rows.

#pragma once

#include "layers.h"

namespace {

constexpr float MINIMUM = 1e-3f, STEEPEST = 1e3f;
constexpr int SIDE_BY_SIDE = 4;  // registers of rows whose knots are summed together

struct Bin {
    Floats anchor, x0, x1, y0, y1, d0, d1;
};

INLINE Floats derivative(Floats raw) {
    // What is added is log(exp(1 - MINIMUM) - 1): zero is slope one.
    Floats v = raw / (1.0f + magnitude(raw) * (1 / STEEPEST)) + 0.539742417236952f;
    return MINIMUM + (v > 0.0f ? v : v * 0.0f) + log_of_one_and(exponential_below_one(-magnitude(v)));
}

// Inner knots 1 to bins - 1 in place of the logits of `bins` bin sizes, a column each: from -1 up to
// the middle, from 1 down to it. Column 0 is not used any more.
INLINE void knots_of_an_axis(float *column, int bins) {
    constexpr int STEP = SIDE_BY_SIDE * WIDTH;
    const int half = bins / 2;
    for (int row = 0; row < BLOCK; row += STEP) {
        Floats top[SIDE_BY_SIDE], total[SIDE_BY_SIDE], sum[SIDE_BY_SIDE], size[SIDE_BY_SIDE];
        float *first = column + row;
#define EACH for (int r = 0; r < SIDE_BY_SIDE; r++)
        EACH top[r] = load(first + r * WIDTH);
        for (int k = 1; k < bins; k++) EACH {
            Floats v = load(first + k * BLOCK + r * WIDTH);
            top[r] = v > top[r] ? v : top[r];
        }
        EACH total[r] = Floats{};
        for (int k = 0; k < bins; k++) EACH {
            float *p = first + k * BLOCK + r * WIDTH;
            Floats e = exponential_below_one(load(p) - top[r]);
            store(p, e);
            total[r] += e;
        }
        EACH total[r] = (2 - 2 * MINIMUM * bins) / total[r];
        EACH sum[r] = Floats{};
        EACH size[r] = load(first + r * WIDTH);
        for (int k = 1; k <= half; k++) EACH {
            float *p = first + k * BLOCK + r * WIDTH;
            sum[r] += size[r] * total[r] + 2 * MINIMUM;
            size[r] = load(p);
            store(p, sum[r]);
        }
        EACH sum[r] = Floats{};
        for (int k = bins - 1; k > half; k--) EACH {
            float *p = first + k * BLOCK + r * WIDTH;
            sum[r] -= load(p) * total[r] + 2 * MINIMUM;
            store(p, sum[r]);
        }
#undef EACH
    }
}

// One function for every caller, so that a knot is the same bits wherever it is used.
__attribute__((noinline)) void knots(float *numbers, int bins) {
    knots_of_an_axis(numbers, bins);
    knots_of_an_axis(numbers + bins * BLOCK, bins);
}

// The bin of `value` by its knots on x (axis 0) or y (axis 1).
INLINE Bin find(const float *numbers, int bins, Floats value, int axis) {
    const float *x = numbers, *y = x + bins * BLOCK, *slopes = y + bins * BLOCK, *along = axis ? y : x;
    const int half = bins / 2;
    const Floats below = value + 1.0f, above = value - 1.0f;
    Bin b = {all(-1.0f), Floats{}, load(x + BLOCK), Floats{}, load(y + BLOCK), Floats{}, load(slopes)};
    // The middle bin begins on one side and ends on the other; the last knot of all is the end.
    auto take = [&](Ints reached, int k, float shift) __attribute__((always_inline)) {
        const bool last = k + 1 == bins;
        b.x0 = reached ? load(x + k * BLOCK) : b.x0;
        b.x1 = reached ? (last ? all(shift) : load(x + (k + 1) * BLOCK) + shift) : b.x1;
        b.y0 = reached ? load(y + k * BLOCK) : b.y0;
        b.y1 = reached ? (last ? all(shift) : load(y + (k + 1) * BLOCK) + shift) : b.y1;
        b.d0 = reached ? load(slopes + (k - 1) * BLOCK) : b.d0;
        b.d1 = reached ? (last ? Floats{} : load(slopes + k * BLOCK)) : b.d1;
    };
    for (int k = 1; k < half; k++) take(load(along + k * BLOCK) <= below, k, 0.0f);
    take(load(along + half * BLOCK) <= below, half, 2.0f);
    if (half + 1 < bins) {
        const Ints right = load(along + (half + 1) * BLOCK) <= above;
        b.anchor = right ? all(1.0f) : b.anchor;
    }
    for (int k = half + 1; k < bins - 1; k++) take(load(along + k * BLOCK) <= above, k, 0.0f);
    if (half + 1 < bins) take(load(along + (bins - 1) * BLOCK) <= above, bins - 1, 0.0f);
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
    for (int row = 0; row < BLOCK; row += WIDTH) {
        const Floats v = load(at + row);
        const Bin b = find(numbers + row, bins, v, 0);
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
    for (int row = 0; row < BLOCK; row += WIDTH) {
        const Floats v = load(at + row);
        const Bin b = find(numbers + row, bins, v, 1);
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

}  // namespace

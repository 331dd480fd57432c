// The steps of a flow, x + h u(x, k h), over tiles of rows: the mathematics of
// harness/nets/discrete_flow_columns.py for Euler's method.

#pragma once

#include "velocity.h"

namespace {

enum Way { FORWARD = 0, ENDPOINT = 1, BACKWARD = 2, INVERSE = 3 };

struct Flow {
    const Network *condition;  // its only layer: what the condition adds to the velocity's first one
    Velocity velocity;
    int32_t steps;
};

// Derivatives (a, b) by row of a place: (a c; b d) of columns, as [by x] and [by y].
struct Matrix {
    float a, c, b, d;
};

INLINE float determinant(const Matrix &m) { return fused(m.a, m.d, -(m.b * m.c)); }

// Of the step by h at row i of `rows`.
INLINE Matrix step_matrix(const Rows &rows, int i, float h) {
    return {fused(h, rows.ux[i], 1.0f), h * rows.vx[i], h * rows.uy[i], fused(h, rows.vy[i], 1.0f)};
}

INLINE void solve(const Matrix &m, float x, float y, float &to_x, float &to_y) {
    const float scale = 1.0f / determinant(m);
    to_x = fused(m.d, x, -(m.b * y)) * scale;
    to_y = fused(m.a, y, -(m.c * x)) * scale;
}

// Rows of a tile on their way: places, and the whole map's determinant and derivatives.
struct Tile {
    int count;
    int row[TILE];
    float x[TILE], y[TILE], det[TILE];
    Matrix whole[TILE];
    float found[TILE];

    INLINE void all(Rows &rows) const {
        rows.clear();
        for (int i = 0; i < count; i++) rows.add(row[i], x[i], y[i]);
    }
};

void forward(const Flow &flow, const float *shared, Tile &tile, Rows &rows, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    for (int k = 0; k < flow.steps; k++) {
        tile.all(rows);
        pass<true>(flow.velocity, shared, float(k) * h, rows, scratch);
        for (int i = 0; i < tile.count; i++) {
            const Matrix m = step_matrix(rows, i, h), w = tile.whole[i];
            tile.x[i] = fused(h, rows.u[i], tile.x[i]);
            tile.y[i] = fused(h, rows.v[i], tile.y[i]);
            tile.det[i] *= determinant(m);
            tile.whole[i] = {fused(m.a, w.a, m.b * w.c), fused(m.c, w.a, m.d * w.c),
                             fused(m.a, w.b, m.b * w.d), fused(m.c, w.b, m.d * w.d)};
        }
    }
}

void endpoint(const Flow &flow, const float *shared, Tile &tile, Rows &rows, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    for (int k = 0; k < flow.steps; k++) {
        tile.all(rows);
        pass<false>(flow.velocity, shared, float(k) * h, rows, scratch);
        for (int i = 0; i < tile.count; i++) {
            tile.x[i] = fused(h, rows.u[i], tile.x[i]);
            tile.y[i] = fused(h, rows.v[i], tile.y[i]);
        }
    }
}

// Not the inverse: explicit steps, with the velocity of their ends.
void backward(const Flow &flow, const float *shared, Tile &tile, Rows &rows, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    for (int k = flow.steps; k > 0; k--) {
        tile.all(rows);
        pass<true>(flow.velocity, shared, float(k) * h, rows, scratch);
        for (int i = 0; i < tile.count; i++) {
            tile.x[i] = fused(-h, rows.u[i], tile.x[i]);
            tile.y[i] = fused(-h, rows.v[i], tile.y[i]);
            tile.det[i] /= determinant(step_matrix(rows, i, -h));
        }
    }
}

}  // namespace

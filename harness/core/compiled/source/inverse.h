// The inverse of a flow's steps, by Newton's method.
//
// The velocity at a step's start is extrapolated from the later steps', whose starts are known, and
// corrected with the derivatives of the step that was inverted before: passes without derivatives,
// a third of the price. The last pass, whose derivatives the density needs, then finds the start;
// where it does not, Newton's method goes on, and where that fails, it begins again with the
// explicit step back, its steps halved where they come no nearer.

#pragma once

#include "flow.h"

namespace {

constexpr float TOLERANCE = 1.0f / (1 << 21);  // of a step's end, relative to the places
constexpr int ROUNDS = 24;                     // of Newton's method, with halved steps among them
constexpr int HISTORY = 4;                     // velocities that are extrapolated
constexpr int CHEAP = 3;                       // passes without derivatives at most

struct Search {
    Tile tile;   // places are the targets, and then the starts
    Rows rows;
    int todo[TILE];
    float x[TILE], y[TILE];            // the start as far as it is known
    float goal[TILE], left[TILE];      // error of the end: wanted, and reached
    float to_x[TILE], to_y[TILE];      // Newton's step
    float rx[TILE], ry[TILE];          // what the end lacks
    Matrix m[TILE];                    // the step's derivatives there
    Matrix before[TILE];               // those of the step that was inverted before
    float u[HISTORY][TILE], v[HISTORY][TILE];  // velocities at the places after, the nearest first
    float shrink[TILE];                // what a cheap pass left of the error, the last time
    bool straight[TILE];               // the last guess was near enough for no cheap pass
};

INLINE float size(float x, float y) {
    x = std::fabs(x);
    y = std::fabs(y);
    return x > y ? x : y;
}

INLINE void set_goal(Search &s, int i) {
    s.goal[i] = TOLERANCE * (1.0f + size(s.tile.x[i], s.tile.y[i]) + size(s.x[i], s.y[i]));
}

// Where the explicit steps back lead.
void explicit_guess(const Flow &flow, const float *shared, int k, Search &s, int count, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    s.rows.clear();
    for (int j = 0; j < count; j++) {
        const int i = s.todo[j];
        s.rows.add(s.tile.row[i], s.tile.x[i], s.tile.y[i]);
    }
    pass<false>(flow.velocity, shared, float(k + 1) * h, s.rows, scratch);
    for (int j = 0; j < count; j++) {
        const int i = s.todo[j];
        s.x[i] = fused(-h, s.rows.u[j], s.tile.x[i]);
        s.y[i] = fused(-h, s.rows.v[j], s.tile.y[i]);
        set_goal(s, i);
        if (k + 1 == flow.steps) {
            s.u[0][i] = s.rows.u[j];
            s.v[0][i] = s.rows.v[j];
        }
    }
}

// Newton's method from s.x, s.y for the first `count` of s.todo.
void newton(const Flow &flow, const float *shared, int k, Search &s, int count, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    for (int j = 0; j < count; j++) {
        const int i = s.todo[j];
        s.left[i] = INFINITY;
        s.to_x[i] = s.to_y[i] = s.rx[i] = s.ry[i] = 0.0f;
        s.m[i] = {1.0f, 0.0f, 0.0f, 1.0f};
    }
    for (int round = 0; round < ROUNDS && count; round++) {
        s.rows.clear();
        for (int j = 0; j < count; j++) {
            const int i = s.todo[j];
            s.rows.add(s.tile.row[i], s.x[i] + s.to_x[i], s.y[i] + s.to_y[i]);
        }
        pass<true>(flow.velocity, shared, float(k) * h, s.rows, scratch);
        int more = 0;
        for (int j = 0; j < count; j++) {
            const int i = s.todo[j];
            const float x = s.rows.x[j], y = s.rows.y[j];
            const float rx = s.tile.x[i] - fused(h, s.rows.u[j], x);
            const float ry = s.tile.y[i] - fused(h, s.rows.v[j], y);
            const float away = size(rx, ry);
            if (round == 0) s.straight[i] &= away <= s.goal[i];
            // So compared, a nan is no better.
            if (away < s.left[i]) {
                s.x[i] = x;
                s.y[i] = y;
                s.m[i] = step_matrix(s.rows, j, h);
                s.rx[i] = rx;
                s.ry[i] = ry;
                s.left[i] = away;
                solve(s.m[i], rx, ry, s.to_x[i], s.to_y[i]);
            } else {
                s.to_x[i] *= 0.5f;
                s.to_y[i] *= 0.5f;
            }
            if (!(s.left[i] <= s.goal[i])) s.todo[more++] = i;
        }
        count = more;
    }
}

// From the extrapolated velocity, by the derivatives of the step before; into s.x, s.y.
void cheap_guess(const Flow &flow, const float *shared, int k, Search &s, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    const int known = flow.steps - k;
    int count = 0;
    for (int i = 0; i < s.tile.count; i++) {
        const float (*u)[TILE] = s.u, (*v)[TILE] = s.v;
        float gx, gy;
        if (known == 2) {
            gx = fused(2.0f, u[0][i], -u[1][i]);
            gy = fused(2.0f, v[0][i], -v[1][i]);
        } else if (known == 3) {
            gx = fused(3.0f, u[0][i] - u[1][i], u[2][i]);
            gy = fused(3.0f, v[0][i] - v[1][i], v[2][i]);
        } else {
            gx = fused(4.0f, u[0][i] + u[2][i], -fused(6.0f, u[1][i], u[3][i]));
            gy = fused(4.0f, v[0][i] + v[2][i], -fused(6.0f, v[1][i], v[3][i]));
        }
        s.x[i] = fused(-h, gx, s.tile.x[i]);
        s.y[i] = fused(-h, gy, s.tile.y[i]);
        set_goal(s, i);
        s.left[i] = INFINITY;
        if (!s.straight[i]) s.todo[count++] = i;
    }
    for (int round = 0; round < CHEAP && count; round++) {
        s.rows.clear();
        for (int j = 0; j < count; j++) {
            const int i = s.todo[j];
            s.rows.add(s.tile.row[i], s.x[i], s.y[i]);
        }
        pass<false>(flow.velocity, shared, float(k) * h, s.rows, scratch);
        int more = 0;
        for (int j = 0; j < count; j++) {
            const int i = s.todo[j];
            const float rx = s.tile.x[i] - fused(h, s.rows.u[j], s.x[i]);
            const float ry = s.tile.y[i] - fused(h, s.rows.v[j], s.y[i]);
            const float away = size(rx, ry);
            if (!(away < 0.5f * s.left[i])) continue;
            if (round)
                s.shrink[i] = away / s.left[i];
            else
                s.straight[i] = away <= 0.5f * s.goal[i];
            s.left[i] = away;
            float dx, dy;
            solve(s.before[i], rx, ry, dx, dy);
            s.x[i] += dx;
            s.y[i] += dy;
            if (away * s.shrink[i] > 0.5f * s.goal[i]) s.todo[more++] = i;
        }
        count = more;
    }
}

void invert(const Flow &flow, const float *shared, Search &s, float *scratch) {
    const float h = 1.0f / float(flow.steps);
    const int n = s.tile.count;
    for (int i = 0; i < n; i++) {
        s.shrink[i] = 0.05f;
        s.straight[i] = false;
    }
    for (int k = flow.steps - 1; k >= 0; k--) {
        const bool first = k == flow.steps - 1;
        for (int i = 0; i < n; i++) s.todo[i] = i;
        if (first)
            explicit_guess(flow, shared, k, s, n, scratch);
        else
            cheap_guess(flow, shared, k, s, scratch);
        for (int i = 0; i < n; i++) s.todo[i] = i;
        newton(flow, shared, k, s, n, scratch);
        if (!first) {
            int again = 0;
            for (int i = 0; i < n; i++)
                if (!(s.left[i] <= 64.0f * s.goal[i])) s.todo[again++] = i;
            if (again) {
                explicit_guess(flow, shared, k, s, again, scratch);
                newton(flow, shared, k, s, again, scratch);
            }
        }
        for (int i = 0; i < n; i++) {
            if (!(s.left[i] <= 64.0f * s.goal[i])) s.tile.found[i] = 0.0f;
            float dx, dy;
            solve(s.m[i], s.rx[i], s.ry[i], dx, dy);
            const float x = s.x[i] + dx, y = s.y[i] + dy;
            for (int j = HISTORY - 1; j > 0; j--) {
                s.u[j][i] = s.u[j - 1][i];
                s.v[j][i] = s.v[j - 1][i];
            }
            s.u[0][i] = (s.tile.x[i] - x) / h;
            s.v[0][i] = (s.tile.y[i] - y) / h;
            s.before[i] = s.m[i];
            s.tile.det[i] *= determinant(s.m[i]);
            s.tile.x[i] = x;
            s.tile.y[i] = y;
        }
    }
}

}  // namespace

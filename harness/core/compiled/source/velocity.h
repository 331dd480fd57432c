// The velocity of a flow of the plane, u(x, t, condition), for rows of a tile: alone, or with its
// derivatives by x. The mathematics of harness/nets/velocity.py.
//
// Activations lie in triples of registers: three registers of rows, or one of rows with its two
// derivatives. Either way every weight is broadcast for three products, and a product of a layer is
// one loop.

#pragma once

#include "network.h"

namespace {

// 3 * SUMS sums, a triple and a weight fill the registers: 16 of AVX2, 32 of the others.
constexpr int SUMS = WIDTH == 8 ? 4 : 8;
constexpr int TILE = 3 * BLOCK;    // rows that go through the steps together
constexpr int TRIPLES = 2;         // triples whose activations stay in the first-level cache
constexpr float REACH = 8.0f;      // x is seen as REACH tanh(x / REACH)

struct Velocity {
    int32_t width, layers, activation, bounded;
    float slope;
    const float *place;  // the first layer's weights of x, y and t, one after the other
    const Layer *layer;  // the layers after the first, packed by SUMS
};

// Rows of a tile to be evaluated: their numbers in the tile, and where; with room for a triple more.
struct Rows {
    int count;
    int index[TILE + 3 * WIDTH];
    float x[TILE + 3 * WIDTH], y[TILE + 3 * WIDTH];
    // Velocity; its derivatives by x, then by y.
    float u[TILE + 3 * WIDTH], v[TILE + 3 * WIDTH];
    float ux[TILE + 3 * WIDTH], vx[TILE + 3 * WIDTH], uy[TILE + 3 * WIDTH], vy[TILE + 3 * WIDTH];

    INLINE void clear() { count = 0; }
    INLINE void add(int row, float at_x, float at_y) {
        index[count] = row;
        x[count] = at_x;
        y[count++] = at_y;
    }
};

template <int ACTIVATION, bool DUAL> INLINE void activate(Floats *s, float slope) {
    if (!DUAL) {
        for (int i = 0; i < 3; i++)
            s[i] = ACTIVATION == SILU ? s[i] * logistic(s[i]) : activated<RELU>(s[i], slope);
        return;
    }
    Floats bend;
    if (ACTIVATION == SILU) {
        const Floats gate = logistic(s[0]);
        s[0] = s[0] * gate;
        bend = fused(s[0], 1.0f - gate, gate);
    } else {
        bend = s[0] > 0.0f ? all(1.0f) : all(slope);
        s[0] = activated<RELU>(s[0], slope);
    }
    s[1] = s[1] * bend;
    s[2] = s[2] * bend;
}

// J outputs of a layer, for `triples` of them `stride` floats from input to input.
template <int J, int ACTIVATION, bool DUAL, bool LAST>
void some_outputs(const float *x, int stride, int triples, int inputs, const float *weights,
                  const float *biases, float *y, float slope) {
    for (int c = 0; c < triples; c++) {
        const float *from = x + c * 3 * WIDTH;
        Floats sum[J][3];
        for (int j = 0; j < J; j++) {
            sum[j][0] = all(biases[j]);
            sum[j][1] = sum[j][2] = DUAL ? Floats{} : sum[j][0];
        }
        for (int k = 0; k < inputs; k++) {
            const Floats a = load(from), b = load(from + WIDTH), d = load(from + 2 * WIDTH);
            for (int j = 0; j < J; j++) {
                const Floats w = all(weights[k * J + j]);
                sum[j][0] += w * a;
                sum[j][1] += w * b;
                sum[j][2] += w * d;
            }
            from += stride;
        }
        for (int j = 0; j < J; j++) {
            if (!LAST) activate<ACTIVATION, DUAL>(sum[j], slope);
            float *to = y + j * stride + c * 3 * WIDTH;
            for (int i = 0; i < 3; i++) store(to + i * WIDTH, sum[j][i]);
        }
    }
}

template <int ACTIVATION, bool DUAL, bool LAST>
INLINE void triple_layer(const Layer &l, const float *x, int stride, int triples, float *y, float slope) {
    const float *weights = l.weights, *biases = l.biases;
    for (int g = 0, n = groups(l.outputs, SUMS); g < n; g++) {
        const int size = group_size(l.outputs, g, SUMS);
        switch (size) {
#define CASE(J) case J: if (J <= SUMS) some_outputs<(J <= SUMS ? J : 1), ACTIVATION, DUAL, LAST>(x, stride, triples, l.inputs, weights, biases, y, slope); break;
            CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8)
#undef CASE
        }
        weights += size * l.inputs;
        biases += size;
        y += size * stride;
    }
}

// The first layer's activations. `shared` is what the condition adds, TILE floats a neuron, and
// `time` what the time does.
template <int ACTIVATION, bool DUAL>
INLINE void first_layer(const Velocity &net, const float *shared, const float *time, const int *index,
                        const float *px, const float *py, int stride, int triples, float *to) {
    const float *wx = net.place, *wy = wx + net.width;
    constexpr int PACKETS_OF_ROWS = DUAL ? 1 : 3;
    for (int c = 0; c < triples; c++) {
        const int row = c * PACKETS_OF_ROWS * WIDTH;
        Floats x[3], y[3], sx = all(1.0f), sy = all(1.0f);
        bool in_order = true;
        for (int i = 1; i < PACKETS_OF_ROWS * WIDTH; i++) in_order &= index[row + i] == index[row] + i;
        for (int i = 0; i < PACKETS_OF_ROWS; i++) {
            x[i] = load(px + row + i * WIDTH);
            y[i] = load(py + row + i * WIDTH);
            if (net.bounded) {
                const Floats a = hyperbolic_tangent(x[i] * (1 / REACH));
                const Floats b = hyperbolic_tangent(y[i] * (1 / REACH));
                x[i] = REACH * a;
                y[i] = REACH * b;
                sx = 1.0f - a * a;
                sy = 1.0f - b * b;
            }
        }
        for (int j = 0; j < net.width; j++) {
            const float *from = shared + j * TILE;
            Floats s[3];
            for (int i = 0; i < PACKETS_OF_ROWS; i++) {
                const int *at = index + row + i * WIDTH;
                Floats there;
                if (in_order)
                    there = load(from + at[0]);
                else
                    for (int l = 0; l < WIDTH; l++) there[l] = from[at[l]];
                s[i] = fused(all(wx[j]), x[i], fused(all(wy[j]), y[i], there + time[j]));
            }
            if (DUAL) {
                s[1] = wx[j] * sx;
                s[2] = wy[j] * sy;
            }
            activate<ACTIVATION, DUAL>(s, net.slope);
            float *p = to + j * stride + c * 3 * WIDTH;
            for (int i = 0; i < 3; i++) store(p + i * WIDTH, s[i]);
        }
    }
}

// Neurons of the widest layer; the last one has two.
INLINE int widest(const Velocity &net) { return net.width > 2 ? net.width : 2; }

// Floats of scratch that a pass needs.
INLINE size_t pass_floats(const Velocity &net) {
    return size_t(2) * widest(net) * TRIPLES * 3 * WIDTH + net.width;
}

template <int ACTIVATION, bool DUAL>
void pass_of(const Velocity &net, const float *shared, float t, Rows &rows, float *scratch) {
    constexpr int EACH = DUAL ? WIDTH : 3 * WIDTH;  // rows of a triple
    const int whole = (rows.count + EACH - 1) / EACH;
    for (int i = rows.count; i < whole * EACH; i++) {
        rows.index[i] = rows.index[rows.count - 1];
        rows.x[i] = rows.y[i] = 0.0f;
    }
    const int stride = TRIPLES * 3 * WIDTH;
    float *time = scratch + 2 * widest(net) * stride;
    for (int j = 0; j < net.width; j++) time[j] = net.place[2 * net.width + j] * t;
    for (int c = 0; c < whole; c += TRIPLES) {
        const int triples = whole - c < TRIPLES ? whole - c : TRIPLES;
        const int start = c * EACH;
        float *x = scratch, *y = scratch + widest(net) * stride;
        first_layer<ACTIVATION, DUAL>(net, shared, time, rows.index + start, rows.x + start,
                                      rows.y + start, stride, triples, x);
        for (int i = 0; i + 1 < net.layers; i++) {
            triple_layer<ACTIVATION, DUAL, false>(net.layer[i], x, stride, triples, y, net.slope);
            float *kept = x;
            x = y;
            y = kept;
        }
        triple_layer<ACTIVATION, DUAL, true>(net.layer[net.layers - 1], x, stride, triples, y, net.slope);
        for (int k = 0; k < triples; k++) {
            const float *u = y + k * 3 * WIDTH, *v = u + stride;
            const int row = start + k * EACH;
            if (DUAL) {
                float *const to[] = {rows.u, rows.ux, rows.uy}, *const too[] = {rows.v, rows.vx, rows.vy};
                for (int i = 0; i < 3; i++) {
                    memcpy(to[i] + row, u + i * WIDTH, sizeof(Floats));
                    memcpy(too[i] + row, v + i * WIDTH, sizeof(Floats));
                }
            } else {
                memcpy(rows.u + row, u, 3 * sizeof(Floats));
                memcpy(rows.v + row, v, 3 * sizeof(Floats));
            }
        }
    }
}

// Velocities at `rows`, and their derivatives if `DUAL`.
template <bool DUAL>
void pass(const Velocity &net, const float *shared, float t, Rows &rows, float *scratch) {
    if (rows.count == 0) return;
    if (net.activation == SILU)
        pass_of<SILU, DUAL>(net, shared, t, rows, scratch);
    else
        pass_of<RELU, DUAL>(net, shared, t, rows, scratch);
}

}  // namespace

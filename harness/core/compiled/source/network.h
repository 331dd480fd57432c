// A network over a block of rows, and how its columns are encoded before.

#pragma once

#include "layers.h"

namespace {

constexpr float FARTHEST = 16777216.0f;  // 2^24: beyond it neighbouring floats have no phase

constexpr int CHUNK = 8;  // blocks in a task of the thread pool

enum Encoding { SCALED = 0, WAVES = 1 };

// What a column becomes: at `place` (v - mean) * scale, or v with its sines and cosines at
// 1, 2, 4, ... `step` places apart.
struct Input {
    int32_t encoding, place, step, frequencies;
    float mean, scale;
};

struct Network {
    int32_t columns, encoded, layers, activation;
    float slope;
    int32_t plain;  // the columns are the first layer's inputs as they are
    const Input *inputs;
    const Layer *layer;
};

template <int ACTIVATION>
void layers(const Network &net, const float **x, float *const *out, float *hidden, int widest) {
    float *next[4096];
    for (int i = 0; i < net.layers; i++) {
        const Layer &l = net.layer[i];
        if (i == net.layers - 1) {
            layer<ACTIVATION, true>(l, x, out, net.slope);
            return;
        }
        float *base = hidden + (i & 1) * widest * BLOCK;
        for (int j = 0; j < l.outputs; j++) next[j] = base + j * BLOCK;
        layer<ACTIVATION, false>(l, x, next, net.slope);
        for (int j = 0; j < l.outputs; j++) x[j] = next[j];
    }
}

// Columns as a caller has them: `wide` says whether one has a value per row, or one for all.
struct Columns {
    const float *const *from;
    const uint8_t *wide;
};

// Columns of one value as BLOCK rows at `copied`, once for all blocks.
INLINE void repeat(const Columns &in, int columns, float *copied) {
    for (int i = 0; i < columns; i++)
        if (!in.wide[i])
            for (int row = 0; row < BLOCK; row++) copied[i * BLOCK + row] = in.from[i][0];
}

// Where `count` rows from `start` on lie; the last few are copied, so that there are BLOCK of them.
INLINE void block_of(const Columns &in, int columns, size_t start, int count, float *copied,
                     const float **raw) {
    for (int i = 0; i < columns; i++) {
        raw[i] = in.wide[i] ? in.from[i] + start : copied + i * BLOCK;
        if (in.wide[i] && count < BLOCK) {
            memset(copied + i * BLOCK, 0, BLOCK * sizeof(float));
            memcpy(copied + i * BLOCK, raw[i], count * sizeof(float));
            raw[i] = copied + i * BLOCK;
        }
    }
}

// A cache line's boundary at or after `p`.
INLINE float *aligned(float *p) {
    return p + ((64 - (reinterpret_cast<uintptr_t>(p) & 63)) & 63) / 4;
}

void encode(const Network &net, const float *const *in, float *to) {
    for (int i = 0; i < net.columns; i++) {
        const Input &e = net.inputs[i];
        for (int row = 0; row < BLOCK; row += WIDTH) {
            Floats v = load(in[i] + row);
            float *p = to + e.place * BLOCK + row;
            if (e.encoding == SCALED) {
                store(p, (v - e.mean) * e.scale);
                continue;
            }
            store(p, v);
            Floats far = v < 0.0f ? -v : v, s, c;
            sine_and_cosine(far > FARTHEST ? Floats{} : v, s, c);
            for (int k = 0; k < e.frequencies; k++) {
                p += e.step * BLOCK;
                store(p, s);
                p += e.step * BLOCK;
                store(p, c);
                Floats twice = 2.0f * s * c;
                c = -2.0f * s * s + 1.0f;
                s = twice;
            }
        }
    }
}

}  // namespace

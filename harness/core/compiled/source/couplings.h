// Spline couplings in turn over a block of rows: the mathematics of harness/nets/spline_couplings.py.

#pragma once

#include "network.h"
#include "splines.h"

namespace {

struct Couplings {
    const Network *condition;  // how a condition is encoded; it has no layers
    const Network *waves;      // how the other coordinate is
    // Of each coupling, one after the other: the first layer's part for the condition, that for
    // the coordinate, whose sums begin where the condition's end, and `rest` more.
    const Layer *layer;
    int32_t count, width, rest, bins;
    int32_t square;  // x is over the chord
    float slope;
};

// From directions to the base's points, or from those to directions and back.
enum Direction { TO_BASE = 0, DRAW = 1 };

// TO_BASE: x, y. DRAW: x, y, keep (1 or 0), and x and y to keep.
INLINE int coupled_columns(int direction) { return direction == DRAW ? 5 : 2; }
// TO_BASE: x, y, and the slope. DRAW: the direction before.
INLINE int coupled_results(int direction) { return direction == DRAW ? 5 : 3; }

struct CouplingScratch {
    float *encoded, *waves, *shared, *hidden, *numbers;
    int widest;
    alignas(64) float at[2][BLOCK], slope[BLOCK], one[BLOCK], chord[BLOCK];
};

INLINE size_t coupling_floats(const Couplings &c, int widest) {
    const size_t columns = c.condition->encoded + c.waves->encoded + c.count * c.width + 2 * widest +
                           3 * c.bins - 1;
    return columns * BLOCK;
}

// What the condition adds to every coupling's first layer.
void share(const Couplings &c, const float *const *raw, CouplingScratch &s) {
    const float *x[4096];
    float *to[4096];
    if (c.condition->plain) {
        for (int i = 0; i < c.condition->columns; i++) x[i] = raw[i];
    } else {
        encode(*c.condition, raw, s.encoded);
        for (int i = 0; i < c.condition->encoded; i++) x[i] = s.encoded + i * BLOCK;
    }
    for (int i = 0; i < c.count; i++) {
        for (int j = 0; j < c.width; j++) to[j] = s.shared + (i * c.width + j) * BLOCK;
        layer<RELU, true>(c.layer[i * (2 + c.rest)], x, to, 0.0f);
    }
}

// Coupling i's numbers where the other coordinate is `other`. One function for every caller, so that they are
// the same bits for a sample and for a query.
__attribute__((noinline)) void network_of(const Couplings &c, int i, const float *other, CouplingScratch &s) {
    const float *x[4096];
    float *to[4096];
    const Layer *layers_of = c.layer + i * (2 + c.rest);
    encode(*c.waves, &other, s.waves);
    for (int k = 0; k < c.waves->encoded; k++) x[k] = s.waves + k * BLOCK;
    const float *sums[4096];
    for (int j = 0; j < c.width; j++) {
        sums[j] = s.shared + (i * c.width + j) * BLOCK;
        to[j] = s.hidden + (s.widest + j) * BLOCK;
    }
    layer<RELU, false>(layers_of[1], x, to, c.slope, sums);
    for (int j = 0; j < c.width; j++) x[j] = to[j];
    for (int j = 0; j < 3 * c.bins - 1; j++) to[j] = s.numbers + j * BLOCK;
    const Network rest{0, 0, c.rest, RELU, c.slope, 0, nullptr, layers_of + 2};
    layers<RELU>(rest, x, to, s.hidden, s.widest);
}

// Half the disk's width at y, or one.
__attribute__((noinline)) void chord_of(const Couplings &c, const float *y, float *chord) {
    for (int row = 0; row < BLOCK; row += WIDTH) {
        const Floats v = load(y + row), squared = (1.0f - v) * (1.0f + v);
        store(chord + row, c.square ? square_root(squared > 0.0f ? squared : all(1.0f)) : all(1.0f));
    }
}

// s.at becomes the base's point from coupling `first` on; s.slope is multiplied.
void warp_on(const Couplings &c, int first, CouplingScratch &s, bool splines) {
    for (int i = first; i < c.count; i++) {
        const int own = i % 2;
        network_of(c, i, s.at[1 - own], s);
        if (!splines) continue;
        knots(s.numbers, c.bins);
        warp(s.numbers, c.bins, s.at[own], s.at[own], s.one);
        for (int row = 0; row < BLOCK; row += WIDTH)
            store(s.slope + row, load(s.slope + row) * load(s.one + row));
    }
}

// `in` and `out` as coupled_columns and coupled_results say; `splines` false: what networks alone take.
void couple(const Couplings &c, int direction, const float *const *in, float *const *out, CouplingScratch &s,
            bool splines) {
    float *x = s.at[0], *y = s.at[1];
    memcpy(x, in[0], sizeof(s.at[0]));
    memcpy(y, in[1], sizeof(s.at[1]));
    if (direction == DRAW) {
        for (int i = c.count - 1; i > 0; i--) {
            const int own = i % 2;
            network_of(c, i, s.at[1 - own], s);
            if (!splines) continue;
            knots(s.numbers, c.bins);
            unwarp(s.numbers, c.bins, s.at[own], s.at[own]);
        }
        for (int row = 0; row < BLOCK; row += WIDTH) {
            const Floats v = load(in[2] + row) != 0.0f ? load(in[4] + row) : load(y + row);
            store(y + row, v);
            store(out[1] + row, v);
        }
    }
    chord_of(c, y, s.chord);
    // The first spline, whose network sees y alone, goes there and back.
    network_of(c, 0, y, s);
    if (splines) knots(s.numbers, c.bins);
    if (direction == DRAW) {
        if (splines) unwarp(s.numbers, c.bins, x, x);
        for (int row = 0; row < BLOCK; row += WIDTH) {
            const Floats there = load(x + row) * load(s.chord + row);
            const Floats place = load(in[2] + row) != 0.0f ? load(in[3] + row) : there;
            store(out[0] + row, place);
            store(x + row, place);
        }
        out += 2;
    }
    for (int row = 0; row < BLOCK; row += WIDTH) store(x + row, load(x + row) / load(s.chord + row));
    if (splines) warp(s.numbers, c.bins, x, x, s.slope);
    warp_on(c, 1, s, splines);
    for (int row = 0; row < BLOCK; row += WIDTH) {
        store(out[0] + row, load(x + row));
        store(out[1] + row, load(y + row));
        store(out[2] + row, load(s.slope + row) / load(s.chord + row));
    }
}

struct CouplingJob {
    const Couplings *couplings;
    uint32_t rows;
    Columns in;
    float *const *out;
    int direction;
    bool splines;
};

// Blocks [first, last) of a job.
void couple_blocks(const CouplingJob &job, uint32_t first, uint32_t last) {
    const Couplings &c = *job.couplings;
    const int columns = c.condition->columns, in = columns + coupled_columns(job.direction);
    const int results = coupled_results(job.direction);
    CouplingScratch *s = new CouplingScratch;
    s->widest = c.width;
    const size_t room = coupling_floats(c, s->widest);
    float *scratch = new float[room + (in + results) * BLOCK + 16];
    float *copied = aligned(scratch), *kept = copied + in * BLOCK;
    s->encoded = kept + results * BLOCK;
    s->waves = s->encoded + c.condition->encoded * BLOCK;
    s->shared = s->waves + c.waves->encoded * BLOCK;
    s->hidden = s->shared + c.count * c.width * BLOCK;
    s->numbers = s->hidden + 2 * s->widest * BLOCK;
    const float *raw[4096];
    float *to[8];
    repeat(job.in, in, copied);
    for (uint32_t block = first; block < last; block++) {
        const size_t start = size_t(block) * BLOCK;
        const int count = job.rows - start < BLOCK ? int(job.rows - start) : BLOCK;
        block_of(job.in, in, start, count, copied, raw);
        for (int j = 0; j < results; j++) to[j] = count < BLOCK ? kept + j * BLOCK : job.out[j] + start;
        share(c, raw, *s);
        couple(c, job.direction, raw + columns, to, *s, job.splines);
        if (count < BLOCK)
            for (int j = 0; j < results; j++) memcpy(job.out[j] + start, to[j], count * sizeof(float));
    }
    delete[] scratch;
    delete s;
}

void couplings_task(uint32_t index, void *payload) {
    const CouplingJob &job = **static_cast<CouplingJob **>(payload);
    const uint32_t blocks = (job.rows + BLOCK - 1) / BLOCK, first = index * CHUNK;
    couple_blocks(job, first, first + CHUNK < blocks ? first + CHUNK : blocks);
}

}  // namespace

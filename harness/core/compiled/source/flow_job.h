// Columns to tiles of rows, through a flow, and back.

#pragma once

#include "inverse.h"

namespace {

struct FlowJob {
    const Flow *flow;
    uint32_t rows;
    Columns in;  // of the condition, x, y, and `active` where there is one
    bool masked;
    float *const *out;
    int way;
};

INLINE float value(const Columns &in, int column, size_t row) {
    return in.from[column][in.wide[column] ? row : 0];
}

// What the condition adds to the first layer in a tile's rows: TILE floats a neuron.
void share(const FlowJob &job, size_t start, int count, float *copied, float *encoded, float *shared) {
    const Network &net = *job.flow->condition;
    const float *raw[4096], *x[4096];
    float *to[4096];
    for (int first = 0; first < count; first += BLOCK) {
        const int here = count - first < BLOCK ? count - first : BLOCK;
        block_of(job.in, net.columns, start + first, here, copied, raw);
        if (net.plain) {
            for (int i = 0; i < net.columns; i++) x[i] = raw[i];
        } else {
            encode(net, raw, encoded);
            for (int i = 0; i < net.encoded; i++) x[i] = encoded + i * BLOCK;
        }
        for (int j = 0; j < job.flow->velocity.width; j++) to[j] = shared + j * TILE + first;
        layer<RELU, true>(net.layer[0], x, to, 0.0f);
    }
}

// Tiles [first, last) of a job.
void flow_tiles(const FlowJob &job, uint32_t first, uint32_t last) {
    const Flow &flow = *job.flow;
    const Network &net = *flow.condition;
    const int width = flow.velocity.width, at = net.columns;
    const size_t floats =
        size_t(net.columns + net.encoded) * BLOCK + size_t(width) * TILE + pass_floats(flow.velocity);
    float *room = new float[floats + 16], *copied = aligned(room), *encoded = copied + net.columns * BLOCK;
    float *shared = encoded + net.encoded * BLOCK, *scratch = shared + width * TILE;
    Search *search = new Search;
    Tile &tile = search->tile;
    repeat(job.in, net.columns, copied);
    for (uint32_t number = first; number < last; number++) {
        const size_t start = size_t(number) * TILE;
        const int rows = job.rows - start < TILE ? int(job.rows - start) : TILE;
        tile.count = 0;
        for (int row = 0; row < rows; row++) {
            if (job.masked && value(job.in, at + 2, start + row) == 0.0f) continue;
            const int i = tile.count++;
            tile.row[i] = row;
            tile.x[i] = value(job.in, at, start + row);
            tile.y[i] = value(job.in, at + 1, start + row);
            tile.det[i] = tile.found[i] = 1.0f;
            tile.whole[i] = {1.0f, 0.0f, 0.0f, 1.0f};
        }
        if (tile.count) {
            share(job, start, rows, copied, encoded, shared);
            switch (job.way) {
                case FORWARD: forward(flow, shared, tile, search->rows, scratch); break;
                case ENDPOINT: endpoint(flow, shared, tile, search->rows, scratch); break;
                case BACKWARD: backward(flow, shared, tile, search->rows, scratch); break;
                default: invert(flow, shared, *search, scratch);
            }
        }
        // Rows that are not active stay where they are.
        for (int row = 0, i = 0; row < rows; row++) {
            const bool there = i < tile.count && tile.row[i] == row;
            const size_t to = start + row;
            job.out[0][to] = there ? tile.x[i] : value(job.in, at, to);
            job.out[1][to] = there ? tile.y[i] : value(job.in, at + 1, to);
            if (job.way != ENDPOINT) job.out[2][to] = there ? tile.det[i] : 1.0f;
            if (job.way == INVERSE) job.out[3][to] = there ? tile.found[i] : 1.0f;
            if (job.way == FORWARD) {
                const Matrix m = there ? tile.whole[i] : Matrix{1.0f, 0.0f, 0.0f, 1.0f};
                job.out[3][to] = m.a;
                job.out[4][to] = m.c;
                job.out[5][to] = m.b;
                job.out[6][to] = m.d;
            }
            i += there;
        }
    }
    delete search;
    delete[] room;
}

constexpr uint32_t TILES = 4;  // in a task

void flow_task(uint32_t index, void *payload) {
    const FlowJob &job = **static_cast<FlowJob **>(payload);
    const uint32_t tiles = (job.rows + TILE - 1) / TILE, first = index * TILES;
    flow_tiles(job, first, first + TILES < tiles ? first + TILES : tiles);
}

}  // namespace

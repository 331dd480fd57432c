// Rows to columns in memory.

#pragma once

#include <cstddef>
#include <cstdint>

namespace {

// A matrix in row-major order, to be written column by column.
struct Table {
    const float *from;
    float *to;
    uint32_t rows, columns;
    int64_t stride;
};

void transpose(const Table &t, uint32_t first, uint32_t last) {
    constexpr uint32_t LINE = 16;  // floats of a cache line
    for (uint32_t row = first; row < last; row += LINE) {
        const uint32_t end = row + LINE < last ? row + LINE : last;
        for (uint32_t c = 0; c < t.columns; c++) {
            const float *from = t.from + c;
            float *to = t.to + size_t(c) * t.rows;
            for (uint32_t r = row; r < end; r++) to[r] = from[int64_t(r) * t.stride];
        }
    }
}

constexpr uint32_t ROWS = 4096;  // in a task

void transpose_task(uint32_t index, void *payload) {
    const Table &t = **static_cast<Table **>(payload);
    const uint32_t first = index * ROWS;
    transpose(t, first, first + ROWS < t.rows ? first + ROWS : t.rows);
}

}  // namespace

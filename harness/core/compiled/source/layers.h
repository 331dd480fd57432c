// One layer over a block of rows: PACKETS * OUTPUTS sums stay in registers.

#pragma once

#include "vectors.h"

#ifndef PACKETS
#define PACKETS 2  // rows of registers that share a weight
#endif
#ifndef OUTPUTS
#define OUTPUTS 6  // outputs at a time: PACKETS * OUTPUTS sums stay in registers
#endif


namespace {

constexpr int BLOCK = 64;  // rows whose activations are kept together

enum Activation { RELU = 0, SILU = 1 };

template <int ACTIVATION> INLINE Floats activated(Floats v, float slope) {
    if (ACTIVATION == SILU) return v / (1.0f + exponential(-v));
    return v > 0.0f ? v : v * slope;
}

struct Layer {
    int32_t inputs, outputs;
    const float *weights;  // packed: see harness_pack
    const float *biases;
};

// Outputs are taken in groups as even as possible, of `most` at most: an odd few at the end
// would have too few sums to fill the processor's pipeline.
INLINE int groups(int outputs, int most = OUTPUTS) { return (outputs + most - 1) / most; }
INLINE int group_size(int outputs, int group, int most = OUTPUTS) {
    int n = groups(outputs, most);
    return outputs / n + (group < outputs % n);
}

// Sums begin at the biases, or where `sums` is not null at its columns.
template <int J, int ACTIVATION, bool LAST>
INLINE void rows(const float *const *x, int inputs, int row, const float *weights, const float *biases,
                 const float *const *sums, float *const *y, float slope) {
    Floats sum[J][PACKETS];
    for (int j = 0; j < J; j++)
        for (int r = 0; r < PACKETS; r++)
            sum[j][r] = sums ? load(sums[j] + row + r * WIDTH) : all(biases[j]);
    for (int k = 0; k < inputs; k++) {
        Floats v[PACKETS];
        for (int r = 0; r < PACKETS; r++) v[r] = load(x[k] + row + r * WIDTH);
        for (int j = 0; j < J; j++) {
            Floats w = all(weights[k * J + j]);
            for (int r = 0; r < PACKETS; r++) sum[j][r] += w * v[r];
        }
    }
    for (int j = 0; j < J; j++)
        for (int r = 0; r < PACKETS; r++)
            store(y[j] + row + r * WIDTH, LAST ? sum[j][r] : activated<ACTIVATION>(sum[j][r], slope));
}

template <int J, int ACTIVATION, bool LAST>
void group(const float *const *x, int inputs, const float *weights, const float *biases,
           const float *const *sums, float *const *y, float slope) {
    for (int row = 0; row < BLOCK; row += PACKETS * WIDTH)
        rows<J, ACTIVATION, LAST>(x, inputs, row, weights, biases, sums, y, slope);
}

template <int ACTIVATION, bool LAST>
void layer(const Layer &l, const float *const *x, float *const *y, float slope,
           const float *const *sums = nullptr) {
    const float *weights = l.weights, *biases = l.biases;
    for (int g = 0, n = groups(l.outputs); g < n; g++) {
        int size = group_size(l.outputs, g);
        switch (size) {
#define CASE(J) case J: if (J <= OUTPUTS) group<(J <= OUTPUTS ? J : 1), ACTIVATION, LAST>(x, l.inputs, weights, biases, sums, y, slope); break;
            CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8)
#undef CASE
        }
        weights += size * l.inputs;
        biases += size;
        if (sums) sums += size;
        y += size;
    }
}

}  // namespace

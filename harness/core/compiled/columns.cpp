// Small networks over columns: one array per input and output, rows taken in blocks whose
// activations stay in the first-level cache.
//
// Compiled once for each instruction set (build.py); WIDTH is the number of floats in a register.
// Every output is bias + sum over inputs in order, by fused multiply-adds: the same bits whatever
// the width, the block or the number of threads.

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#ifndef WIDTH
#define WIDTH 8
#endif
#ifndef PACKETS
#define PACKETS 2  // rows of registers that share a weight
#endif
#ifndef OUTPUTS
#define OUTPUTS 6  // outputs at a time: PACKETS * OUTPUTS sums stay in registers
#endif

namespace {

constexpr int BLOCK = 64;       // rows whose activations are kept together
constexpr int CHUNK = 8;        // blocks in a task of the thread pool
constexpr float FARTHEST = 16777216.0f;  // 2^24: beyond it neighbouring floats have no phase

typedef float Floats __attribute__((vector_size(WIDTH * 4)));
typedef int32_t Ints __attribute__((vector_size(WIDTH * 4)));

#define INLINE inline __attribute__((always_inline))

INLINE Floats load(const float *p) {
    Floats v;
    memcpy(&v, p, sizeof(v));
    return v;
}

INLINE void store(float *p, Floats v) { memcpy(p, &v, sizeof(v)); }

// Not 0 + x, which would cost an addition: it is not x where x is -0.
INLINE Floats all(float x) { return x - Floats{}; }

INLINE Floats magnitude(Floats v) { return (Floats)((Ints)v & 0x7fffffff); }

INLINE Floats square_root(Floats v) {
#if WIDTH == 16 && defined(__AVX512F__)
    return (Floats)_mm512_sqrt_ps((__m512)v);
#elif WIDTH == 8 && defined(__AVX__)
    return (Floats)_mm256_sqrt_ps((__m256)v);
#else
    for (int i = 0; i < WIDTH; i++) v[i] = std::sqrt(v[i]);
    return v;
#endif
}

// Nearest whole number of |v| < 2^22.
INLINE Floats nearest(Floats v) {
    const Floats magic = all(12582912.0f);  // 1.5 * 2^23
    return (v + magic) - magic;
}

INLINE Floats power_of_two(Ints n) { return (Floats)((n + 127) << 23); }

// e^v to 1 ulp or two; denormal results and infinity in two steps of the exponent.
INLINE Floats exponential(Floats v) {
    const Floats low = all(-104.0f), high = all(89.0f);
    // Beyond these bounds the result is 0 or infinite anyway; a nan stays one.
    Floats x = v < low ? low : v;
    x = x > high ? high : x;
    Floats n = nearest(x * 1.44269504f);
    Floats r = x - n * 0.693145752f;  // 15 bits: exact products
    r = r - n * 1.42860677e-6f;
    Floats p = all(1.0f / 5040);
    p = p * r + 1.0f / 720;
    p = p * r + 1.0f / 120;
    p = p * r + 1.0f / 24;
    p = p * r + 1.0f / 6;
    p = p * r + 0.5f;
    p = p * r * r + r + 1.0f;
    Ints k = __builtin_convertvector(n, Ints);
    Ints half = k >> 1;
    return p * power_of_two(half) * power_of_two(k - half);
}

// v less k quarter turns.
INLINE Floats less_quarters(Floats v, Floats k) {
    v = v - k * 1.57079637f;
    v = v + k * 4.37113883e-8f;
    return v + k * 1.71512489e-15f;
}

// Sine and cosine of |v| <= 2^24: quarter turns subtracted, then Taylor's series.
INLINE void sine_and_cosine(Floats v, Floats &sine, Floats &cosine) {
    // Far out the number of quarters is rounded, and one may be left or too many.
    Floats many = __builtin_convertvector(__builtin_convertvector(v * 0.636619772f, Ints), Floats);
    Floats r = less_quarters(v, many);
    Floats few = nearest(r * 0.636619772f);
    r = less_quarters(r, few);
    Floats k = many + few;
    Ints turn = __builtin_convertvector(k, Ints);
    Floats q = r * r;
    Floats s = all(2.75573192e-6f);
    s = s * q - 1.98412698e-4f;
    s = s * q + 8.33333333e-3f;
    s = s * q - 1.66666667e-1f;
    s = s * q * r + r;
    Floats c = all(-2.75573192e-7f);
    c = c * q + 2.48015873e-5f;
    c = c * q - 1.38888889e-3f;
    c = c * q + 4.16666667e-2f;
    c = c * q * q - 0.5f * q + 1.0f;
    Ints odd = (turn & 1) != 0;
    Floats a = odd ? c : s, b = odd ? s : c;
    sine = (turn & 2) != 0 ? -a : a;
    cosine = ((turn + 1) & 2) != 0 ? -b : b;
}

// log(1 + e) for e in [0, 1]: the series of the inverse hyperbolic tangent at e / (2 + e) <= 1/3.
INLINE Floats log_of_one_and(Floats e) {
    Floats t = e / (2.0f + e), q = t * t;
    Floats p = all(1.0f / 15);
    p = p * q + 1.0f / 13;
    p = p * q + 1.0f / 11;
    p = p * q + 1.0f / 9;
    p = p * q + 1.0f / 7;
    p = p * q + 1.0f / 5;
    p = p * q + 1.0f / 3;
    p = p * q * t + t;
    return 2.0f * p;
}

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

// Outputs are taken in groups as even as possible, of OUTPUTS at most: an odd few at the end
// would have too few sums to fill the processor's pipeline.
INLINE int groups(int outputs) { return (outputs + OUTPUTS - 1) / OUTPUTS; }
INLINE int group_size(int outputs, int group) {
    int n = groups(outputs);
    return outputs / n + (group < outputs % n);
}

template <int J, int ACTIVATION, bool LAST>
INLINE void rows(const float *const *x, int inputs, int row, const float *weights, const float *biases,
                 float *const *y, float slope) {
    Floats sum[J][PACKETS];
    for (int j = 0; j < J; j++)
        for (int r = 0; r < PACKETS; r++) sum[j][r] = all(biases[j]);
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
void group(const float *const *x, int inputs, const float *weights, const float *biases, float *const *y,
           float slope) {
    for (int row = 0; row < BLOCK; row += PACKETS * WIDTH)
        rows<J, ACTIVATION, LAST>(x, inputs, row, weights, biases, y, slope);
}

template <int ACTIVATION, bool LAST>
void layer(const Layer &l, const float *const *x, float *const *y, float slope) {
    const float *weights = l.weights, *biases = l.biases;
    for (int g = 0, n = groups(l.outputs); g < n; g++) {
        int size = group_size(l.outputs, g);
        switch (size) {
#define CASE(J) case J: if (J <= OUTPUTS) group<(J <= OUTPUTS ? J : 1), ACTIVATION, LAST>(x, l.inputs, weights, biases, y, slope); break;
            CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8)
#undef CASE
        }
        weights += size * l.inputs;
        biases += size;
        y += size;
    }
}

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

// --- Rational-quadratic splines: the mathematics of harness/nets/spline.py, row by row -----------

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

struct Job {
    const Network *net;
    uint32_t rows;
    const float *const *in;
    const uint8_t *wide;  // whether a column has a value per row, or one for all
    float *const *out;
    int widest, use;
};

// Blocks [first, last) of a job.
void work(const Job &job, uint32_t first, uint32_t last) {
    const Network &net = *job.net;
    const int in = net.columns + extra_columns(job.use);
    const int numbers = net.layer[net.layers - 1].outputs, out = result_columns(job.use, numbers);
    const size_t floats = size_t(in + net.encoded + 2 * job.widest + numbers + out) * BLOCK;
    float *scratch = new float[floats + 16];
    float *copied = scratch + ((64 - (reinterpret_cast<uintptr_t>(scratch) & 63)) & 63) / 4;
    float *encoded = copied + in * BLOCK, *hidden = encoded + net.encoded * BLOCK;
    float *raw_out = hidden + 2 * job.widest * BLOCK, *kept = raw_out + numbers * BLOCK;
    const float *x[4096], *raw[4096];
    float *y[4096], *to[4096];
    for (int i = 0; i < in; i++)
        if (!job.wide[i])
            for (int row = 0; row < BLOCK; row++) copied[i * BLOCK + row] = job.in[i][0];
    for (uint32_t block = first; block < last; block++) {
        const size_t start = size_t(block) * BLOCK;
        const int count = job.rows - start < BLOCK ? int(job.rows - start) : BLOCK;
        for (int i = 0; i < in; i++) {
            raw[i] = job.wide[i] ? job.in[i] + start : copied + i * BLOCK;
            if (job.wide[i] && count < BLOCK) {
                memset(copied + i * BLOCK, 0, BLOCK * sizeof(float));
                memcpy(copied + i * BLOCK, raw[i], count * sizeof(float));
                raw[i] = copied + i * BLOCK;
            }
        }
        if (net.plain) {
            for (int i = 0; i < net.columns; i++) x[i] = raw[i];
        } else {
            encode(net, raw, encoded);
            for (int i = 0; i < net.encoded; i++) x[i] = encoded + i * BLOCK;
        }
        for (int j = 0; j < out; j++) to[j] = count < BLOCK ? kept + j * BLOCK : job.out[j] + start;
        for (int j = 0; j < numbers; j++)
            y[j] = job.use == OUTPUTS_THEMSELVES ? to[j] : raw_out + j * BLOCK;
        if (net.activation == SILU)
            layers<SILU>(net, x, y, hidden, job.widest);
        else
            layers<RELU>(net, x, y, hidden, job.widest);
        if (job.use != OUTPUTS_THEMSELVES && job.use != NOTHING)
            splines(job.use, raw_out, (numbers + 1) / 3, raw + net.columns, to);
        if (count < BLOCK)
            for (int j = 0; j < out; j++) memcpy(job.out[j] + start, to[j], count * sizeof(float));
    }
    delete[] scratch;
}

void task(uint32_t index, void *payload) {
    const Job &job = **static_cast<Job **>(payload);
    const uint32_t blocks = (job.rows + BLOCK - 1) / BLOCK;
    const uint32_t first = index * CHUNK;
    work(job, first, first + CHUNK < blocks ? first + CHUNK : blocks);
}

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

typedef void *(*Submit)(void *pool, const void *const *parents, uint32_t parent_count, uint32_t size,
                        void (*function)(uint32_t, void *), void *payload, uint32_t payload_size,
                        void (*deleter)(void *), int always_async, int profile);
typedef void (*Wait)(void *task);

}  // namespace

extern "C" {

// Weights [outputs][inputs] in the order in which `rows` reads them.
void harness_pack(const float *weights, int32_t inputs, int32_t outputs, float *packed) {
    int first = 0;
    for (int g = 0; g < groups(outputs); g++) {
        const int size = group_size(outputs, g);
        for (int k = 0; k < inputs; k++)
            for (int j = 0; j < size; j++) *packed++ = weights[(first + j) * inputs + k];
        first += size;
    }
}

// The network over `rows` rows, and what its outputs are used for; `submit` and `wait` are the thread pool's (null: in this thread).
void harness_network(const Network *net, uint32_t rows, const float *const *in, const uint8_t *wide,
                     float *const *out, int32_t use, Submit submit, Wait wait) {
    int widest = 1;
    for (int i = 0; i + 1 < net->layers; i++)
        if (net->layer[i].outputs > widest) widest = net->layer[i].outputs;
    Job job{net, rows, in, wide, out, widest, use};
    const uint32_t blocks = (rows + BLOCK - 1) / BLOCK, tasks = (blocks + CHUNK - 1) / CHUNK;
    if (!submit || tasks < 2) {
        work(job, 0, blocks);
        return;
    }
    Job *payload = &job;
    void *made = submit(nullptr, nullptr, 0, tasks, task, &payload, sizeof(payload), nullptr, 1, 0);
    wait(made);
}

// [rows][columns] at `from`, `stride` floats from row to row, to [columns][rows] at `to`.
void harness_transpose(const float *from, int64_t stride, uint32_t rows, uint32_t columns, float *to,
                       Submit submit, Wait wait) {
    Table table{from, to, rows, columns, stride};
    const uint32_t tasks = (rows + ROWS - 1) / ROWS;
    if (!submit || tasks < 2) {
        transpose(table, 0, rows);
        return;
    }
    Table *payload = &table;
    wait(submit(nullptr, nullptr, 0, tasks, transpose_task, &payload, sizeof(payload), nullptr, 1, 0));
}

// Exponential, sine and cosine of n values (a multiple of WIDTH), for tests.
void harness_functions(const float *v, int32_t n, float *exponentials, float *sines, float *cosines) {
    for (int i = 0; i < n; i += WIDTH) {
        Floats s, c, x = load(v + i);
        store(exponentials + i, exponential(x));
        sine_and_cosine(x, s, c);
        store(sines + i, s);
        store(cosines + i, c);
    }
}

}

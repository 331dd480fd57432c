// Small networks over columns: one array per input and output, rows taken in blocks whose
// activations stay in the first-level cache.
//
// Compiled once for each instruction set (build.py); WIDTH is the number of floats in a register.
// Every output is bias + sum over inputs in order, by fused multiply-adds: the same bits whatever
// the width, the block or the number of threads.

#include <cmath>
#include <cstdint>
#include <cstring>

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

INLINE Floats truncated(Floats v) { return __builtin_convertvector(__builtin_convertvector(v, Ints), Floats); }

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

// Sine and cosine of |v| <= 2^24: quarter turns subtracted in three parts, then Taylor's series.
INLINE void sine_and_cosine(Floats v, Floats &sine, Floats &cosine) {
    Floats k = nearest(v * 0.636619772f);
    Floats r = v - k * 1.57079637f;
    r = r + k * 4.37113883e-8f;
    r = r + k * 1.71512489e-15f;
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

struct Job {
    const Network *net;
    uint32_t rows;
    const float *const *in;
    const uint8_t *wide;  // whether a column has a value per row, or one for all
    float *const *out;
    float *const *scratch_of;
    int widest, outputs;
};

// Blocks [first, last) of a job; `scratch` holds what one thread needs.
void work(const Job &job, uint32_t first, uint32_t last) {
    const Network &net = *job.net;
    const int in = net.columns, out = job.outputs;
    const size_t floats = size_t(in + net.encoded + 2 * job.widest + out) * BLOCK;
    float *scratch = new float[floats + 16];
    float *aligned = scratch + ((64 - (reinterpret_cast<uintptr_t>(scratch) & 63)) & 63) / 4;
    float *copied = aligned, *encoded = copied + in * BLOCK, *hidden = encoded + net.encoded * BLOCK;
    float *kept = hidden + 2 * job.widest * BLOCK;
    const float *x[4096], *raw[4096];
    float *y[4096];
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
            for (int i = 0; i < in; i++) x[i] = raw[i];
        } else {
            encode(net, raw, encoded);
            for (int i = 0; i < net.encoded; i++) x[i] = encoded + i * BLOCK;
        }
        for (int j = 0; j < out; j++) y[j] = count < BLOCK ? kept + j * BLOCK : job.out[j] + start;
        if (net.activation == SILU)
            layers<SILU>(net, x, y, hidden, job.widest);
        else
            layers<RELU>(net, x, y, hidden, job.widest);
        if (count < BLOCK)
            for (int j = 0; j < out; j++) memcpy(job.out[j] + start, y[j], count * sizeof(float));
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

// The network over `rows` rows; `submit` and `wait` are the thread pool's (null: in this thread).
void harness_network(const Network *net, uint32_t rows, const float *const *in, const uint8_t *wide,
                     float *const *out, Submit submit, Wait wait) {
    int widest = 1;
    for (int i = 0; i + 1 < net->layers; i++)
        if (net->layer[i].outputs > widest) widest = net->layer[i].outputs;
    Job job{net, rows, in, wide, out, nullptr, widest, net->layer[net->layers - 1].outputs};
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

int32_t harness_width() { return WIDTH; }

}

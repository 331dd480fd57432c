// Small networks over columns: one array per input and output, rows taken in blocks whose
// activations stay in the first-level cache.
//
// Compiled once for each instruction set (build.py); WIDTH is the number of floats in a register.
// Every output is bias + sum over inputs in order, by fused multiply-adds: the same bits whatever
// the width, the block or the number of threads.

#include "couplings.h"
#include "flow_job.h"
#include "network.h"
#include "transpose.h"

namespace {

struct Job {
    const Network *net;
    uint32_t rows;
    Columns in;
    float *const *out;
    int widest;
};

// Blocks [first, last) of a job.
void work(const Job &job, uint32_t first, uint32_t last) {
    const Network &net = *job.net;
    const int in = net.columns, out = net.layer[net.layers - 1].outputs;
    const size_t floats = size_t(in + net.encoded + 2 * job.widest + out) * BLOCK;
    float *scratch = new float[floats + 16];
    float *copied = aligned(scratch);
    float *encoded = copied + in * BLOCK, *hidden = encoded + net.encoded * BLOCK;
    float *kept = hidden + 2 * job.widest * BLOCK;
    const float *x[4096], *raw[4096];
    float *to[4096];
    repeat(job.in, in, copied);
    for (uint32_t block = first; block < last; block++) {
        const size_t start = size_t(block) * BLOCK;
        const int count = job.rows - start < BLOCK ? int(job.rows - start) : BLOCK;
        block_of(job.in, in, start, count, copied, raw);
        if (net.plain) {
            for (int i = 0; i < net.columns; i++) x[i] = raw[i];
        } else {
            encode(net, raw, encoded);
            for (int i = 0; i < net.encoded; i++) x[i] = encoded + i * BLOCK;
        }
        for (int j = 0; j < out; j++) to[j] = count < BLOCK ? kept + j * BLOCK : job.out[j] + start;
        if (net.activation == SILU)
            layers<SILU>(net, x, to, hidden, job.widest);
        else
            layers<RELU>(net, x, to, hidden, job.widest);
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

typedef void *(*Submit)(void *pool, const void *const *parents, uint32_t parent_count, uint32_t size,
                        void (*function)(uint32_t, void *), void *payload, uint32_t payload_size,
                        void (*deleter)(void *), int always_async, int profile);
typedef void (*Wait)(void *task);

}  // namespace

extern "C" {

// Weights [outputs][inputs] in the order in which `rows` reads them, or those of a flow.
void harness_pack(const float *weights, int32_t inputs, int32_t outputs, int32_t for_flow, float *packed) {
    int first = 0;
    const int most = for_flow ? SUMS : OUTPUTS;
    for (int g = 0; g < groups(outputs, most); g++) {
        const int size = group_size(outputs, g, most);
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
    Job job{net, rows, {in, wide}, out, widest};
    const uint32_t blocks = (rows + BLOCK - 1) / BLOCK, tasks = (blocks + CHUNK - 1) / CHUNK;
    if (!submit || tasks < 2) {
        work(job, 0, blocks);
        return;
    }
    Job *payload = &job;
    void *made = submit(nullptr, nullptr, 0, tasks, task, &payload, sizeof(payload), nullptr, 1, 0);
    wait(made);
}

// Spline couplings over `rows` rows. Columns in: the condition's, then as coupled_columns says; out: coupled_results.
void harness_couplings(const Couplings *couplings, uint32_t rows, const float *const *in, const uint8_t *wide,
                       float *const *out, int32_t direction, int32_t splines, Submit submit, Wait wait) {
    CouplingJob job{couplings, rows, {in, wide}, out, direction, splines != 0};
    const uint32_t blocks = (rows + BLOCK - 1) / BLOCK, tasks = (blocks + CHUNK - 1) / CHUNK;
    if (!submit || tasks < 2) {
        couple_blocks(job, 0, blocks);
        return;
    }
    CouplingJob *payload = &job;
    wait(submit(nullptr, nullptr, 0, tasks, couplings_task, &payload, sizeof(payload), nullptr, 1, 0));
}

// A flow's steps over `rows` rows. Columns in: the condition's, x and y, and `active` (0 or not; if there is one).
// Out: x and y; but for ENDPOINT the determinant; for FORWARD derivatives by x and by y, for INVERSE whether found.
void harness_flow(const Flow *flow, uint32_t rows, const float *const *in, const uint8_t *wide,
                  int32_t masked, float *const *out, int32_t way, Submit submit, Wait wait) {
    FlowJob job{flow, rows, {in, wide}, masked != 0, out, way};
    const uint32_t tiles = (rows + TILE - 1) / TILE, tasks = (tiles + TILES - 1) / TILES;
    if (!submit || tasks < 2) {
        flow_tiles(job, 0, tiles);
        return;
    }
    FlowJob *payload = &job;
    wait(submit(nullptr, nullptr, 0, tasks, flow_task, &payload, sizeof(payload), nullptr, 1, 0));
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

// Exponential, sine, cosine, logistic function and hyperbolic tangent of n values (a multiple of WIDTH), for tests.
void harness_functions(const float *v, int32_t n, float *exponentials, float *sines, float *cosines,
                       float *logistics, float *tangents) {
    for (int i = 0; i < n; i += WIDTH) {
        Floats s, c, x = load(v + i);
        store(exponentials + i, exponential(x));
        sine_and_cosine(x, s, c);
        store(sines + i, s);
        store(cosines + i, c);
        store(logistics + i, logistic(x));
        store(tangents + i, hyperbolic_tangent(x));
    }
}

}

// Measures the device's peak rates: multiply-adds on registers, and streaming through arrays far larger than any cache.
// Uses operators only: PoCL's built-in functions on float16 abort the process on some CPUs.

#define CHAINS 12  // independent chains hide latency: within a chain, each multiply-add waits for the previous one

__kernel void multiply_add(const int steps, __global float *results) {
    const VECTOR factor = (VECTOR)(0.999f), addend = (VECTOR)(0.001f * (get_global_id(0) + 1));
    VECTOR chains[CHAINS];
    for (int i = 0; i < CHAINS; i++) chains[i] = (VECTOR)(0.1f * i);
    for (int step = 0; step < steps; step++) {
#pragma unroll
        for (int i = 0; i < CHAINS; i++) chains[i] = chains[i] * factor + addend;
    }
    VECTOR sum = chains[0];
    for (int i = 1; i < CHAINS; i++) sum += chains[i];
    float lanes[LANES];
    *(VECTOR *)lanes = sum;
    float total = 0;
    for (int i = 0; i < LANES; i++) total += lanes[i];
    results[get_global_id(0)] = total;  // keeps the compiler from eliminating the loop
}

// Each work-group streams through `vectors` consecutive elements; neighbouring work-items access neighbouring elements.
__kernel void stream_read(const int vectors, __global const VECTOR *values, __global float *results) {
    __global const VECTOR *run = values + (size_t)get_group_id(0) * vectors;
    VECTOR sum = (VECTOR)(0.0f);
    for (int i = get_local_id(0); i < vectors; i += get_local_size(0)) sum += run[i];
    float lanes[LANES];
    *(VECTOR *)lanes = sum;
    float total = 0;
    for (int i = 0; i < LANES; i++) total += lanes[i];
    results[get_global_id(0)] = total;
}

__kernel void stream_write(const int vectors, __global VECTOR *values, __global float *results) {
    __global VECTOR *run = values + (size_t)get_group_id(0) * vectors;
    for (int i = get_local_id(0); i < vectors; i += get_local_size(0)) run[i] = (VECTOR)(1.0f);
}

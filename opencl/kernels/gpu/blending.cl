// Front-to-back alpha blending, one work-group per tile and one work-item per pixel.
//
// The work-group stages a batch of Gaussians in local memory; all pixels then read the same Gaussian at the same time.
// The features blended so far stay in registers.

// Gaussians per batch. A batch takes at most 12 KiB of local memory (24 KiB in double precision), so that several
// work-groups fit on a compute unit.
#if FEATURE_DIM <= 16
#define BLEND_BATCH 128
#elif FEATURE_DIM <= 32
#define BLEND_BATCH 64
#else
#define BLEND_BATCH 32
#endif

__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void blend(
    const int width,
    const int height,
    __global const REAL *records,
    __global const REAL *features,
    __global const REAL *background,
    __global const int *tile_starts,
    __global const int *entries,
    __global REAL *feature_map,
    __global REAL *alphas,
    __global int *walked,
    __global int *pixel_counts
) {
    __local REAL4 staged_records[BLEND_BATCH * RECORD_QUARTETS], staged_features[BLEND_BATCH * FEATURE_QUARTETS];
    __local int furthest, open_pixels[2];  // open_pixels: nonzero if any is open; batches alternate
#ifdef COUNT_PIXELS
    __local int drawn[BLEND_BATCH];
#endif
    const int item = get_local_id(0), index = get_group_id(0), column = item % TILE, row = item / TILE;
    const Tile tile = tile_of(index, width, height);
    const REAL x = column + R(0.5), y = row + R(0.5);
    const int inside = column < tile.columns && row < tile.rows;
    const int first = tile_starts[index], end = tile_starts[index + 1];

    REAL transmittance = 1;
    REAL4 blended[FEATURE_QUARTETS];
    #pragma unroll
    for (int q = 0; q < FEATURE_QUARTETS; q++) blended[q] = 0;
    int open = inside, reached = 0;  // reached: entries visited by this pixel
    if (item == 0) furthest = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int batch = first, turn = 0; batch < end; batch += BLEND_BATCH, turn ^= 1) {
        const int here = end - batch < BLEND_BATCH ? end - batch : BLEND_BATCH;
        if (item == 0) open_pixels[turn] = 0;
#ifdef COUNT_PIXELS
        for (int n = item; n < BLEND_BATCH; n += GROUP_SIZE) drawn[n] = 0;
#endif
        stage_records(records, entries + batch, here, here, tile, staged_records);
        stage_features(features, entries + batch, here, here, staged_features);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int n = 0; n < here && open; n++) {
            const REAL unclamped = alpha_of(staged_records + n * RECORD_QUARTETS, x, y);
            reached++;
            if (!(unclamped >= ALPHA_MINIMUM)) continue;
            const REAL alpha = unclamped > ALPHA_MAXIMUM ? ALPHA_MAXIMUM : unclamped, weight = alpha * transmittance;
            const REAL behind = light_behind(alpha, transmittance);
            open = behind >= TRANSMITTANCE_MINIMUM;
            if (!open) break;
            transmittance = behind;
#ifdef COUNT_PIXELS
            atomic_inc(drawn + n);
#endif
            #pragma unroll
            for (int q = 0; q < FEATURE_QUARTETS; q++)
                blended[q] += weight * staged_features[n * FEATURE_QUARTETS + q];
        }
        if (open) atomic_or(open_pixels + turn, 1);
        barrier(CLK_LOCAL_MEM_FENCE);
#ifdef COUNT_PIXELS
        // Deterministic despite the atomics: integer sums do not depend on the order of addition.
        for (int n = item; n < here; n += GROUP_SIZE)
            if (drawn[n]) atomic_add(pixel_counts + entries[batch + n], drawn[n]);
        barrier(CLK_LOCAL_MEM_FENCE);
#endif
        if (!open_pixels[turn]) break;
    }
    atomic_max(&furthest, reached);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item == 0) walked[index] = furthest;

    if (!inside) return;
    const size_t at = (size_t)(tile.top + row) * width + tile.left + column;
    alphas[at] = 1 - transmittance;
#if FEATURE_DIM % 4 == 0
    #pragma unroll
    for (int q = 0; q < FEATURE_QUARTETS; q++)
        ((__global REAL4 *)feature_map)[at * FEATURE_QUARTETS + q] = blended[q] + transmittance * vload4(q, background);
#else
    #pragma unroll
    for (int k = 0; k < FEATURE_DIM; k++)
        feature_map[at * FEATURE_DIM + k] = ((const REAL *)blended)[k] + transmittance * background[k];
#endif
}

// Front-to-back alpha blending, one work-item per tile, for processors that run one work-item per core.

// add_N_features: adds the features of `count` Gaussians, times their weights, to the sums of N consecutive channels.
// `sums` and `features` point to the first of these channels.
#define LOAD_SUM(k) sum[k] = sums[k];
#define ADD_FEATURE(k) sum[k] += weight * feature[k];
#define STORE_SUM(k) sums[k] = sum[k];
#define DEFINE_ADD_FEATURES(channels)                                                                     \
    static inline void add_##channels##_features(                                                         \
        LANES *sums, __global const REAL *features, const int *gaussians, const LANES *weights, int count \
    ) {                                                                                                   \
        LANES sum[channels];                                                                              \
        EACH_##channels(LOAD_SUM, 0)                                                                      \
        for (int i = 0; i < count; i++) {                                                                 \
            __global const REAL *feature = features + (size_t)FEATURE_DIM * gaussians[i];                 \
            const LANES weight = weights[i];                                                              \
            EACH_##channels(ADD_FEATURE, 0)                                                               \
        }                                                                                                 \
        EACH_##channels(STORE_SUM, 0)                                                                     \
    }
DEFINE_ADD_FEATURES(1)
DEFINE_ADD_FEATURES(2)
DEFINE_ADD_FEATURES(4)
DEFINE_ADD_FEATURES(8)
DEFINE_ADD_FEATURES(16)

// Takes as many channels at a time as the registers can hold.
WHOLE_REGISTERS static inline void add_features(
    LANES *sums, __global const REAL *features, const int *gaussians, const LANES *weights, int count
) {
    int k = 0;
#ifdef __AVX512F__
    for (; k + 16 <= FEATURE_DIM; k += 16) add_16_features(sums + k, features + k, gaussians, weights, count);
    if (FEATURE_DIM & 8) add_8_features(sums + k, features + k, gaussians, weights, count), k += 8;
    if (FEATURE_DIM & 4) add_4_features(sums + k, features + k, gaussians, weights, count), k += 4;
#else
    for (; k + 4 <= FEATURE_DIM; k += 4) add_4_features(sums + k, features + k, gaussians, weights, count);
#endif
    if (FEATURE_DIM & 2) add_2_features(sums + k, features + k, gaussians, weights, count), k += 2;
    if (FEATURE_DIM & 1) add_1_features(sums + k, features + k, gaussians, weights, count);
}

#ifdef COUNT_PIXELS
static inline int drawn_lanes(LANES weights) {
    int count = 0;
    for (int lane = 0; lane < 16; lane++) count += ((const REAL *)&weights)[lane] > R(0);
    return count;
}
#endif

// Blends the chunk's Gaussians into one block.
WHOLE_REGISTERS static inline void blend_block(
    const Chunk *chunk,
    int index,
    __global const REAL *features,
    Transmittance *transmittance,
    LANES *sums,
    __global int *pixel_counts
) {
    const Block block = block_of(index);
    LANES weights[CHUNK];
    int gaussians[CHUNK], count = 0;
    Transmittance t = *transmittance;
    for (ulong left = chunk->reaching[index]; left; left &= left - 1, count++) {
        const Splat *splat = chunk->splats + FIRST_BIT(left);
        const LANES alpha = spread_of(splat, block).alpha;
        weights[count] = alpha > ALPHA_MAXIMUM ? (LANES)(ALPHA_MAXIMUM) : alpha;
        gaussians[count] = splat->gaussian;
    }
    for (int i = 0; i < count; i++) weights[i] = weights_of(weights[i], &t);
    *transmittance = t;
#ifdef COUNT_PIXELS
    // Deterministic despite the atomics: integer sums do not depend on the order of addition.
    for (int i = 0; i < count; i++) atomic_add(pixel_counts + gaussians[i], drawn_lanes(weights[i]));
#endif
    add_features(sums, features, gaussians, weights, count);
}

// Writes a block's pixels: the features, blended over the background, and the alphas. `left` is the transmittance.
WHOLE_REGISTERS static inline void write_block(
    Tile tile, int index, int width, LANES left, LANES *sums, __global const REAL *background,
    __global REAL *feature_map, __global REAL *alphas
) {
    const Block block = block_of(index);
    const LANES covered = R(1) - left;
    for (int lane = 0; lane < SIDE * SIDE; lane++)
        if (in_picture(tile, block, lane)) alphas[pixel_of(tile, block, lane, width)] = ((const REAL *)&covered)[lane];
    for (int k = 0; k < FEATURE_DIM; k++) sums[k] += left * background[k];
    for (int channel = 0; channel < FEATURE_DIM; channel += 16) {
        LANES pixels[16];
#define TAKE_CHANNEL(k) pixels[k] = channel + (k) < FEATURE_DIM ? sums[channel + (k)] : (LANES)(R(0));
        EACH_16(TAKE_CHANNEL, 0)
        transpose(pixels);
        for (int lane = 0; lane < SIDE * SIDE; lane++) {
            if (!in_picture(tile, block, lane)) continue;
            __global REAL *pixel = feature_map + pixel_of(tile, block, lane, width) * FEATURE_DIM + channel;
#if defined(LARGE_PICTURE) && FEATURE_DIM % 16 == 0
            STREAM(pixel, pixels[lane]);
#else
            if (channel + 16 <= FEATURE_DIM)
                *(__global UNALIGNED_LANES *)pixel = pixels[lane];
            else
                for (int k = 0; k < FEATURE_DIM - channel; k++) pixel[k] = ((const REAL *)(pixels + lane))[k];
#endif
        }
    }
}

WHOLE_REGISTERS __kernel void blend(
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
    const int index = get_global_id(0);
    const Tile tile = tile_of(index, width, height);
    Transmittance transmittance[BLOCKS];
    LANES sums[BLOCKS * FEATURE_DIM];
    for (int block = 0; block < BLOCKS; block++) {
        transmittance[block].product = fresh_transmittance(tile, block_of(block));
        transmittance[block].counted = (LANES)(R(1));
        for (int k = 0; k < FEATURE_DIM; k++) sums[block * FEATURE_DIM + k] = (LANES)(R(0));
    }

    Chunk chunk;
    int entry = tile_starts[index], open = 1;
    const int end = tile_starts[index + 1];
    while (entry < end && open) {
        const int count = end - entry < CHUNK ? end - entry : CHUNK;
        read_chunk(&chunk, tile, records, features, entries, entry, count, end);
        open = 0;
        for (int block = 0; block < BLOCKS; block++) {
            if (all_finished(transmittance[block])) continue;
            blend_block(&chunk, block, features, transmittance + block, sums + block * FEATURE_DIM, pixel_counts);
            open = 1;
        }
        entry += count;
    }
    walked[index] = entry - tile_starts[index];

    for (int block = 0; block < BLOCKS; block++)
        write_block(
            tile, block, width, transmittance[block].counted, sums + block * FEATURE_DIM, background,
            feature_map, alphas
        );
}

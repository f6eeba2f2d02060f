// Gradients of `blend`, one work-item per tile. No atomics: each (tile, Gaussian) pair writes a row of its own.
//
// Walks front to back, as `blend` does. With features c, transmittance T, weight w = T alpha and a pixel's gradient g,
// dL/dalpha_i = T_i (c_i . g) - rest_i / (1 - alpha_i). `rest`, what is blended behind Gaussian i, starts
// as (out . g) and loses w_i (c_i . g) at each step. Alpha is one more channel, of value 1 over a background of 0.
//
// Sums over a block's pixels are matrix products: a Gaussian's weights times the pixels' gradients, with channels in
// the lanes, and s = dL/dpower times the pixels' powers 1, x, y, x^2, xy, y^2. This avoids sums across lanes, except
// for ABSOLUTE_GRADIENTS.

// A gradient row holds sums over the tile's pixels: s, s u, s dy, s u^2, s u dy and s dy^2, where u = dx - slope dy;
// |dL/dx| and |dL/dy| of the centre if ABSOLUTE_GRADIENTS is defined, else 0; then the gradients of the features.
#define MOMENTS 8
#define GRADIENT_ROW (MOMENTS + (FEATURE_DIM + 7) / 8 * 8)
#define CHANNEL_GROUPS ((FEATURE_DIM + 15) / 16)

// A block's gradients of the picture, stored twice: `channels` has the pixels in the lanes, one value per channel;
// `pixels` has the channels in the lanes, one value per pixel of each group of 16 channels.
typedef struct {
    LANES channels[CHANNEL_GROUPS * 16], pixels[CHANNEL_GROUPS * 16];
    LANES alpha, rest;
    REAL8 powers[SIDE * SIDE];  // of each pixel: 1, x, y, x^2, xy, y^2
} BlockGradients;

// A Gaussian's gradient row while it is being summed. Its moments are still in x and y rather than u and dy.
typedef struct {
    REAL8 moments;
    LANES features[CHANNEL_GROUPS];
} Row;

// Reads `count` values, at most 16; the remaining lanes are 0.
static inline LANES read_lanes(__global const REAL *values, int count) {
    if (count >= 16) return *(__global const UNALIGNED_LANES *)values;
    LANES read = (LANES)(R(0));
    for (int k = 0; k < count; k++) ((REAL *)&read)[k] = values[k];
    return read;
}

// Prefetches the picture and its gradient at the block below, which is read SIDE blocks later.
static inline void fetch_block_below(
    Tile tile,
    Block block,
    int width,
    __global const REAL *feature_map,
    __global const REAL *alphas,
    __global const REAL *grad_feature_map,
    __global const REAL *grad_alphas
) {
    block.row += SIDE;
    for (int lane = 0; lane < SIDE * SIDE; lane++) {
        if (!in_picture(tile, block, lane)) continue;
        const size_t at = pixel_of(tile, block, lane, width), from = at * FEATURE_DIM;
        if (lane % SIDE == 0) {
            FETCH(alphas + at);
            FETCH(grad_alphas + at);
        }
        for (int k = 0; k < FEATURE_DIM; k += 16) {
            FETCH(feature_map + from + k);
            FETCH(grad_feature_map + from + k);
        }
    }
}

WHOLE_REGISTERS static inline void read_powers(REAL8 *powers, Block block) {
    const LANES none = (LANES)(R(0));
    LANES v[16] = {(LANES)(R(1)), block.x, block.y, block.x * block.x, block.x * block.y, block.y * block.y, none, none,
                   none, none, none, none, none, none, none, none};
    transpose(v);
#define PUT_POWERS(lane) powers[lane] = v[lane].lo;
    EACH_16(PUT_POWERS, 0)
}

// Reads the gradients of the picture for one block, and starts `rest`.
WHOLE_REGISTERS static inline void read_gradients(
    BlockGradients *g,
    Tile tile,
    int index,
    int width,
    __global const REAL *feature_map,
    __global const REAL *alphas,
    __global const REAL *grad_feature_map,
    __global const REAL *grad_alphas
) {
    const Block block = block_of(index);
    fetch_block_below(tile, block, width, feature_map, alphas, grad_feature_map, grad_alphas);
    read_powers(g->powers, block);
    LANES products[16];
#define NO_PRODUCT(lane) products[lane] = (LANES)(R(0));
    EACH_16(NO_PRODUCT, 0)
    REAL *grad_alpha = (REAL *)&g->alpha, *rest = (REAL *)&g->rest;
    for (int lane = 0; lane < SIDE * SIDE; lane++) {
        const int inside = in_picture(tile, block, lane);
        const size_t at = inside ? pixel_of(tile, block, lane, width) : 0;
        const REAL alpha = inside ? alphas[at] : R(0);
        grad_alpha[lane] = inside ? grad_alphas[at] : R(0);
        rest[lane] = alpha * grad_alpha[lane];
        for (int group = 0; group < CHANNEL_GROUPS; group++) {
            const int count = inside ? FEATURE_DIM - group * 16 : 0;
            const size_t from = at * FEATURE_DIM + group * 16;
            const LANES grad = read_lanes(grad_feature_map + from, count);
            products[lane] += read_lanes(feature_map + from, count) * grad;
            g->pixels[group * 16 + lane] = grad;
        }
    }
    for (int group = 0; group < CHANNEL_GROUPS; group++) {
        LANES turned[16];
#define TAKE_PIXEL(lane) turned[lane] = g->pixels[group * 16 + (lane)];
#define PUT_CHANNEL(k) g->channels[group * 16 + (k)] = turned[k];
        EACH_16(TAKE_PIXEL, 0)
        transpose(turned);
        EACH_16(PUT_CHANNEL, 0)
    }
    transpose(products);
#define ADD_PRODUCT(k) g->rest += products[k];
    EACH_16(ADD_PRODUCT, 0)
}

// The chunk's Gaussians that reach a block: their numbers in the chunk and, per pixel, c . g (`products`), weights and
// s (`slopes`).
typedef struct {
    int count, numbers[CHUNK], gaussians[CHUNK];
    LANES products[CHUNK], weights[CHUNK], slopes[CHUNK];
} Reaching;

// multiply_N_features: adds N channels of c . g to the products, which start as the gradient of alpha. (Here and below,
// two alternating accumulators hide the latency of the multiply-add.)
#define LOAD_GRADIENT(k) grad[k] = g->channels[channel + (k)];
#define ADD_CHANNEL(k) product[(k) & 1] += grad[k] * feature[k];
#define DEFINE_MULTIPLY_FEATURES(number)                                                                      \
    static inline void multiply_##number##_features(                                                          \
        Reaching *reaching, __global const REAL *features, const BlockGradients *g, int channel               \
    ) {                                                                                                       \
        LANES grad[number];                                                                                   \
        EACH_##number(LOAD_GRADIENT, 0)                                                                       \
        for (int i = 0; i < reaching->count; i++) {                                                           \
            __global const REAL *feature = features + (size_t)FEATURE_DIM * reaching->gaussians[i] + channel; \
            LANES product[2] = {channel ? reaching->products[i] : g->alpha, (LANES)(R(0))};                   \
            EACH_##number(ADD_CHANNEL, 0)                                                                     \
            reaching->products[i] = product[0] + product[1];                                                  \
        }                                                                                                     \
    }
DEFINE_MULTIPLY_FEATURES(1)
DEFINE_MULTIPLY_FEATURES(2)
DEFINE_MULTIPLY_FEATURES(4)
DEFINE_MULTIPLY_FEATURES(8)
DEFINE_MULTIPLY_FEATURES(16)

WHOLE_REGISTERS static inline void multiply_features(
    Reaching *reaching, __global const REAL *features, const BlockGradients *g
) {
    int k = 0;
#ifdef __AVX512F__
    for (; k + 16 <= FEATURE_DIM; k += 16) multiply_16_features(reaching, features, g, k);
    if (FEATURE_DIM & 8) multiply_8_features(reaching, features, g, k), k += 8;
    if (FEATURE_DIM & 4) multiply_4_features(reaching, features, g, k), k += 4;
#else
    for (; k + 4 <= FEATURE_DIM; k += 4) multiply_4_features(reaching, features, g, k);
#endif
    if (FEATURE_DIM & 2) multiply_2_features(reaching, features, g, k), k += 2;
    if (FEATURE_DIM & 1) multiply_1_features(reaching, features, g, k);
}

// Blends the chunk's Gaussians again to find the weights and s, which is alpha dL/dalpha, or 0 where alpha is clamped.
// A first loop computes every alpha, which does not depend on the previous Gaussian.
WHOLE_REGISTERS static inline void differentiate_block(
    const Chunk *chunk, Block block, Transmittance *transmittance, BlockGradients *g, Reaching *reaching
) {
    for (int i = 0; i < reaching->count; i++)
        reaching->weights[i] = spread_of(chunk->splats + reaching->numbers[i], block).alpha;
    Transmittance t = *transmittance;
    LANES rest = g->rest;
    for (int i = 0; i < reaching->count; i++) {
        const LANES_MASK clamped = reaching->weights[i] > ALPHA_MAXIMUM;
        const LANES alpha = clamped ? (LANES)(ALPHA_MAXIMUM) : reaching->weights[i];
        const LANES odds = alpha / (R(1) - alpha);
        const LANES weights = weights_of(alpha, &t);
        const LANES own = weights * reaching->products[i];
        rest -= own;
        reaching->weights[i] = weights;
        reaching->slopes[i] = (weights > R(0)) & ~clamped ? own - rest * odds : (LANES)(R(0));
    }
    *transmittance = t;
    g->rest = rest;
}

#ifdef ABSOLUTE_GRADIENTS
static inline REAL sum_of_sizes(LANES v) {
    REAL sum = 0;
    for (int lane = 0; lane < 16; lane++) sum += fabs(((const REAL *)&v)[lane]);
    return sum;
}

// Adds each pixel's |dL/dx| and |dL/dy| of the Gaussians' centres.
static inline void add_absolute_gradients(const Chunk *chunk, Block block, const Reaching *reaching, Row *rows) {
    for (int i = 0; i < reaching->count; i++) {
        const Splat *splat = chunk->splats + reaching->numbers[i];
        const Spread r = spread_of(splat, block);
        const REAL squares = R(-1.38629436111989061883);  // -2 ln 2: undoes the factor -1/2 log2(e) of the precisions
        const LANES by_x = reaching->slopes[i] * (r.across * (splat->across * squares));
        const LANES by_y = reaching->slopes[i] * (r.down * (splat->down * squares)) - splat->slope * by_x;
        rows[reaching->numbers[i]].moments.s6 += sum_of_sizes(by_x);
        rows[reaching->numbers[i]].moments.s7 += sum_of_sizes(by_y);
    }
}
#endif

// Adds one block's sums to the rows.
WHOLE_REGISTERS static inline void add_to_rows(const Reaching *reaching, const BlockGradients *g, Row *rows) {
    for (int i = 0; i < reaching->count; i++) {
        const REAL *slopes = (const REAL *)(reaching->slopes + i);
        REAL8 moments[2] = {rows[reaching->numbers[i]].moments, (REAL8)(R(0))};
#define ADD_POWERS(lane) moments[(lane) & 1] += slopes[lane] * g->powers[lane];
        EACH_16(ADD_POWERS, 0)
        rows[reaching->numbers[i]].moments = moments[0] + moments[1];
    }
    for (int group = 0; group < CHANNEL_GROUPS; group++) {
        LANES pixels[16];
#define LOAD_PIXEL(lane) pixels[lane] = g->pixels[group * 16 + (lane)];
        EACH_16(LOAD_PIXEL, 0)
        for (int i = 0; i < reaching->count; i++) {
            const REAL *weights = (const REAL *)(reaching->weights + i);
            LANES sum[2] = {rows[reaching->numbers[i]].features[group], (LANES)(R(0))};
#define ADD_PIXEL(lane) sum[(lane) & 1] += weights[lane] * pixels[lane];
            EACH_16(ADD_PIXEL, 0)
            rows[reaching->numbers[i]].features[group] = sum[0] + sum[1];
        }
    }
}

WHOLE_REGISTERS static inline void blend_block_backward(
    const Chunk *chunk,
    int index,
    __global const REAL *features,
    Transmittance *transmittance,
    BlockGradients *g,
    Row *rows
) {
    Reaching reaching;
    int count = 0;
    for (ulong left = chunk->reaching[index]; left; left &= left - 1, count++) {
        reaching.numbers[count] = FIRST_BIT(left);
        reaching.gaussians[count] = chunk->splats[FIRST_BIT(left)].gaussian;
    }
    reaching.count = count;
    multiply_features(&reaching, features, g);
    differentiate_block(chunk, block_of(index), transmittance, g, &reaching);
#ifdef ABSOLUTE_GRADIENTS
    add_absolute_gradients(chunk, block_of(index), &reaching, rows);
#endif
    add_to_rows(&reaching, g, rows);
}

// Adds a block's share of the background's gradient, from the transmittance `left` after its last Gaussian.
WHOLE_REGISTERS static inline void add_to_background(const BlockGradients *g, LANES left, LANES *behind) {
    for (int group = 0; group < CHANNEL_GROUPS; group++)
        for (int lane = 0; lane < SIDE * SIDE; lane++)
            behind[group] += g->pixels[group * 16 + lane] * ((const REAL *)&left)[lane];
}

// Writes a row, after converting its moments from x and y to u = x - slope y - offset and dy = y - s->y.
static inline void write_row(const Splat *s, const Row *row, __global REAL *gradient) {
    const REAL8 m = row->moments;
    const REAL offset = s->x - s->slope * s->y;
    const REAL along = m.s1 - s->slope * m.s2;
    const REAL su = along - offset * m.s0;
    const REAL square = m.s3 - s->slope * (2 * m.s4 - s->slope * m.s5);
    gradient[0] = m.s0;
    gradient[1] = su;
    gradient[2] = m.s2 - s->y * m.s0;
    gradient[3] = square - offset * (along + su);
    gradient[4] = m.s4 - s->slope * m.s5 - offset * m.s2 - s->y * su;
    gradient[5] = m.s5 - s->y * (2 * m.s2 - s->y * m.s0);
    gradient[6] = m.s6;
    gradient[7] = m.s7;
    for (int k = 0; k < GRADIENT_ROW - MOMENTS; k++) gradient[MOMENTS + k] = ((const REAL *)row->features)[k];
}

static inline Row empty_row() {
    Row row;
    row.moments = (REAL8)(R(0));
    for (int group = 0; group < CHANNEL_GROUPS; group++) row.features[group] = (LANES)(R(0));
    return row;
}

WHOLE_REGISTERS __kernel void blend_backward(
    const int width,
    const int height,
    __global const REAL *records,
    __global const REAL *features,
    __global const int *tile_starts,
    __global const int *entries,
    __global const int *slots,
    __global const int *walked,
    __global const REAL *feature_map,
    __global const REAL *alphas,
    __global const REAL *grad_feature_map,
    __global const REAL *grad_alphas,
    __global REAL *gradient_rows,
    __global REAL *background_rows
) {
    const int index = get_global_id(0);
    const Tile tile = tile_of(index, width, height);
    BlockGradients gradients[BLOCKS];
    Transmittance transmittance[BLOCKS];
    for (int block = 0; block < BLOCKS; block++) {
        read_gradients(
            gradients + block, tile, block, width, feature_map, alphas, grad_feature_map, grad_alphas
        );
        transmittance[block].product = fresh_transmittance(tile, block_of(block));
        transmittance[block].counted = (LANES)(R(1));
    }
    Chunk chunk;
    Row rows[CHUNK];
    const int first = tile_starts[index], end = first + walked[index];
    for (int entry = first; entry < end; entry += CHUNK) {
        const int count = end - entry < CHUNK ? end - entry : CHUNK;
        read_chunk(&chunk, tile, records, features, entries, entry, count, end);
        for (int i = 0; i < count; i++) {
            rows[i] = empty_row();
            FETCH(gradient_rows + (size_t)GRADIENT_ROW * slots[entry + i]);
        }
        for (int block = 0; block < BLOCKS; block++)
            if (!all_finished(transmittance[block]))
                blend_block_backward(&chunk, block, features, transmittance + block, gradients + block, rows);
        for (int i = 0; i < count; i++)
            write_row(chunk.splats + i, rows + i, gradient_rows + (size_t)GRADIENT_ROW * slots[entry + i]);
    }
    LANES behind[CHANNEL_GROUPS];
    for (int group = 0; group < CHANNEL_GROUPS; group++) behind[group] = (LANES)(R(0));
    for (int block = 0; block < BLOCKS; block++)
        add_to_background(gradients + block, transmittance[block].counted, behind);
    for (int k = 0; k < FEATURE_DIM; k++)
        background_rows[(size_t)index * FEATURE_DIM + k] = ((const REAL *)behind)[k];
    for (int entry = end; entry < tile_starts[index + 1]; entry++) {
        __global REAL *gradient = gradient_rows + (size_t)GRADIENT_ROW * slots[entry];
        for (int k = 0; k < GRADIENT_ROW; k++) gradient[k] = 0;
    }
}

#define SUM_CHUNK 128

// Sums each Gaussian's gradient rows, which are contiguous, in order: the result is bitwise reproducible.
__kernel void sum_gradients(
    const int count,
    __global const REAL *records,
    __global const int *tile_counts,
    __global const int *first_slots,
    __global const REAL *gradient_rows,
    __global REAL *grad_means2d,
    __global REAL *grad_absolute,
    __global REAL *grad_records,
    __global REAL *grad_features
) {
    const int first = get_global_id(0) * SUM_CHUNK;
    const int last = first + SUM_CHUNK < count ? first + SUM_CHUNK : count;
    for (int i = first; i < last; i++) {
        REAL sums[GRADIENT_ROW];
        for (int k = 0; k < GRADIENT_ROW; k++) sums[k] = 0;
        const int rows = tile_counts[i];
        if (rows > 0) {
            __global const REAL *row = gradient_rows + (size_t)GRADIENT_ROW * first_slots[i];
            for (int n = 0; n < rows; n++, row += GRADIENT_ROW)
                for (int k = 0; k < GRADIENT_ROW; k++) sums[k] += row[k];
        }
        __global const REAL *record = records + (size_t)RECORD * i;
        __global REAL *grad_record = grad_records + (size_t)RECORD * i;
        const REAL slope = record[2], across = record[3], down = record[4], opacity = record[5];
        const REAL grad_x = across * sums[1];
        grad_means2d[2 * i] = grad_x;
        grad_means2d[2 * i + 1] = down * sums[2] - slope * grad_x;
#ifdef ABSOLUTE_GRADIENTS
        grad_absolute[2 * i] = sums[6];
        grad_absolute[2 * i + 1] = sums[7];
#endif
        grad_record[0] = grad_record[1] = grad_record[6] = grad_record[7] = 0;
        grad_record[2] = across * sums[4];
        grad_record[3] = R(-0.5) * sums[3];
        grad_record[4] = R(-0.5) * sums[5];
        grad_record[5] = opacity > 0 ? sums[0] / opacity : 0;
        for (int k = 0; k < FEATURE_DIM; k++) grad_features[(size_t)FEATURE_DIM * i + k] = sums[MOMENTS + k];
    }
}

// The background's gradient: sums the tiles' shares in order.
__kernel void sum_background(const int tiles, __global const REAL *background_rows, __global REAL *grad_background) {
    for (int k = 0; k < FEATURE_DIM; k++) {
        REAL sum = 0;
        for (int tile = 0; tile < tiles; tile++) sum += background_rows[(size_t)tile * FEATURE_DIM + k];
        grad_background[k] = sum;
    }
}

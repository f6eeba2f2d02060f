// Gradients of `blend`, one work-group per tile. No atomics: each (tile, Gaussian) pair writes a row of its own.
//
// Walks front to back, as `blend` does. With features c, transmittance T, weight w = T alpha and a pixel's gradient g,
// dL/dalpha_i = T_i (c_i . g) - rest_i / (1 - alpha_i). `rest`, what is blended behind Gaussian i, starts
// as (out . g) and loses w_i (c_i . g) at each step. Alpha is one more channel, of value 1 over a background of 0.
//
// Gaussians are processed in small batches, in two phases. In the first, a work-item is a pixel and writes the
// Gaussians' weights w and s = dL/dpower to local memory. In the second, it is a task on a slice of the pixels and sums
// either the gradients of some features (w g) of all Gaussians of the batch, or the moments (of s) of one. Each value
// read from a pixel thus serves several Gaussians. The slices' sums are added in a fixed order.

// A gradient row holds sums over the tile's pixels: s, s u, s dy, s u^2, s u dy and s dy^2, where u = dx - slope dy;
// |dL/dx| and |dL/dy| of the centre if ABSOLUTE_GRADIENTS is defined; from ROW_FEATURES on, the gradients of the
// features. It is padded to whole memory sectors.
#ifdef ABSOLUTE_GRADIENTS
#define MOMENTS 8
#else
#define MOMENTS 6
#endif
#define ROW_FEATURES 8
#define GRADIENT_ROW ((ROW_FEATURES + FEATURE_DIM + 7) / 8 * 8)

// Gaussians per batch, chosen so that a work-group needs less than 32 KiB of local memory.
#ifdef REAL_IS_DOUBLE
#define BACKWARD_BATCH 4
#else
#define BACKWARD_BATCH 8
#endif
#define WEIGHT_QUARTETS (BACKWARD_BATCH / 4)

// A block is TASKS tasks on TILE slices each, work for half a work-group. It covers 16 features of all Gaussians, two
// per task; the last block covers the moments, one Gaussian per task. The halves of the group take alternate blocks.
#define TASKS 8
#define BLOCK_FEATURES (2 * TASKS)
#define FEATURE_BLOCKS ((FEATURE_DIM + BLOCK_FEATURES - 1) / BLOCK_FEATURES)
#define ROUNDS ((FEATURE_BLOCKS + 2) / 2)
#define TASK_SUMS (2 * BACKWARD_BATCH)
#define BLOCK_SUMS (TASKS * TASK_SUMS)

// Pitches in local memory, padded to avoid bank conflicts.
#define WEIGHT_PITCH (GROUP_SIZE + 4)
#define SLICE_PITCH (BLOCK_SUMS + 8)

// A work-group's local memory: first what the pixels hand to the tasks, then the sums of two blocks.
typedef union {
    struct {
        REAL4 weights[WEIGHT_QUARTETS * WEIGHT_PITCH], power_gradients[WEIGHT_QUARTETS * WEIGHT_PITCH];
    } pixels;
    REAL sums[2 * TILE * SLICE_PITCH];
} BackwardSpace;

// A pixel's state: its centre from the tile's corner, gradients, transmittance, `rest` (see above), and whether it is
// still open, that is, not finished.
typedef struct {
    REAL x, y, transmittance, rest, grad_alpha;
    REAL4 grads[FEATURE_QUARTETS];
    int open;
} Pixel;

static inline Pixel pixel_of(
    int width,
    Tile tile,
    __global const REAL *feature_map,
    __global const REAL *alphas,
    __global const REAL *grad_feature_map,
    __global const REAL *grad_alphas
) {
    const int column = get_local_id(0) % TILE, row = get_local_id(0) / TILE;
    Pixel p;
    p.x = column + R(0.5);
    p.y = row + R(0.5);
    p.open = column < tile.columns && row < tile.rows;
    p.transmittance = 1;
    p.rest = p.grad_alpha = 0;
    #pragma unroll
    for (int q = 0; q < FEATURE_QUARTETS; q++) p.grads[q] = 0;
    if (!p.open) return p;
    const size_t at = (size_t)(tile.top + row) * width + tile.left + column;
    p.grad_alpha = grad_alphas[at];
    p.rest = alphas[at] * p.grad_alpha;
    #pragma unroll
    for (int k = 0; k < FEATURE_DIM; k++) {
        const REAL grad = grad_feature_map[at * FEATURE_DIM + k];
        ((REAL *)p.grads)[k] = grad;
        p.rest += feature_map[at * FEATURE_DIM + k] * grad;
    }
    return p;
}

// Blends one Gaussian into an open pixel. If it is drawn, sets `weight` and `power_gradient`, both 0 on entry.
static inline void blend_pixel(
    Pixel *p, __local const REAL4 *record, __local const REAL4 *feature, REAL *weight, REAL *power_gradient
) {
    const REAL unclamped = alpha_of(record, p->x, p->y), alpha = unclamped > ALPHA_MAXIMUM ? ALPHA_MAXIMUM : unclamped;
    const REAL before = p->transmittance, blended = alpha * before, behind = light_behind(alpha, before);
    const int seen = unclamped >= ALPHA_MINIMUM, drawn = seen && behind >= TRANSMITTANCE_MINIMUM;
    p->open = drawn == seen;
    if (!drawn) return;
    *weight = blended;
    p->transmittance = behind;
    REAL4 products = 0;
    #pragma unroll
    for (int q = 0; q < FEATURE_QUARTETS; q++) products += p->grads[q] * feature[q];
    const REAL product = p->grad_alpha + (products.x + products.y) + (products.z + products.w);
    p->rest -= blended * product;
    *power_gradient = unclamped > ALPHA_MAXIMUM ? 0 : alpha * (before * product - p->rest / (1 - alpha));
}

// Adds up, over a slice (a column of the tile), two features' gradients times the weights of all Gaussians:
// sums[c * WEIGHT_QUARTETS + q] holds those of four Gaussians for the feature `channel` + c * TASKS.
static inline void add_features(
    int width, Tile tile, int slice, int channel, __global const REAL *grads, __local const REAL4 *weights, REAL4 *sums
) {
    // A missing pixel or feature is replaced by another one, whose weight is 0 or whose sum is not used.
    const int column = slice < tile.columns ? slice : 0;
    const int one = channel < FEATURE_DIM ? channel : 0, other = channel + TASKS < FEATURE_DIM ? channel + TASKS : 0;
    grads += ((size_t)tile.top * width + tile.left + column) * FEATURE_DIM;
    #pragma unroll 2
    for (int row = 0; row < tile.rows; row++, grads += (size_t)width * FEATURE_DIM) {
        const REAL first = grads[one], second = grads[other];
        #pragma unroll
        for (int q = 0; q < WEIGHT_QUARTETS; q++) {
            const REAL4 weight = weights[q * WEIGHT_PITCH + row * TILE + slice];
            sums[q] += weight * first;
            if (FEATURE_DIM > TASKS) sums[WEIGHT_QUARTETS + q] += weight * second;
        }
    }
}

// Adds up one Gaussian's moments over a slice.
static inline void add_moments(
    int slice, __local const REAL4 *record, __local const REAL *power_gradients, REAL *sums
) {
    const REAL4 place = record[0];
#ifdef ABSOLUTE_GRADIENTS
    const REAL squares = R(-1.38629436111989061883);  // -2 ln 2: undoes the factor -1/2 log2(e) of the precisions
    const REAL precision_across = place.w * squares, precision_down = record[1].x * squares;
#endif
    for (int row = 0; row < TILE; row++) {
        const REAL s = power_gradients[(row * TILE + slice) * 4];
        const REAL down = row + R(0.5) - place.y, across = slice + R(0.5) - place.x - place.z * down;
        const REAL s_across = s * across, s_down = s * down;
        sums[0] += s;
        sums[1] += s_across;
        sums[2] += s_down;
        sums[3] += s_across * across;
        sums[4] += s_across * down;
        sums[5] += s_down * down;
#ifdef ABSOLUTE_GRADIENTS
        sums[6] += fabs(precision_across * s_across);
        sums[7] += fabs(precision_down * s_down - place.z * precision_across * s_across);
#endif
    }
}

// The gradient of the background: g times the final transmittance, summed over the tile. A slice is a row here. (The
// picture's 1 - alpha would not do: where little light is left, cancellation leaves hardly a correct digit.)
static inline void sum_behind(
    int width,
    Tile tile,
    REAL transmittance,
    __global const REAL *grad_feature_map,
    __local REAL *sums,
    __global REAL *background_row
) {
    __local REAL *left = sums + GROUP_SIZE;
    left[get_local_id(0)] = transmittance;
    barrier(CLK_LOCAL_MEM_FENCE);
    const int slice = get_local_id(0) / TILE;
    for (int first = 0; first < FEATURE_DIM; first += TILE) {
        const int k = first + get_local_id(0) % TILE;
        REAL sum = 0;
        for (int column = 0; column < tile.columns && slice < tile.rows && k < FEATURE_DIM; column++) {
            const size_t at = (size_t)(tile.top + slice) * width + tile.left + column;
            sum += grad_feature_map[at * FEATURE_DIM + k] * left[slice * TILE + column];
        }
        sums[get_local_id(0)] = sum;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (slice == 0 && k < FEATURE_DIM) {
            for (int row = 1; row < TILE; row++) sum += sums[row * TILE + get_local_id(0)];
            background_row[k] = sum;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

// Adds up one of a block's sums over all slices and writes it to its Gaussian's row. `number` selects the sum.
static inline void write_sum(
    int block, int number, int here, __local const REAL *slices, __local const int *slots, __global REAL *gradient_rows
) {
    const int task = number % TASKS, value = number / TASKS;
    const int channel = block * BLOCK_FEATURES + value / BACKWARD_BATCH * TASKS + task;
    const int is_moment = block == FEATURE_BLOCKS;
    const int n = is_moment ? task : value % BACKWARD_BATCH;
    if (number >= BLOCK_SUMS || n >= here || (is_moment ? value >= MOMENTS : channel >= FEATURE_DIM)) return;
    REAL sum = 0;
    for (int slice = 0; slice < TILE; slice++) sum += slices[slice * SLICE_PITCH + number];
    gradient_rows[(size_t)GRADIENT_ROW * slots[n] + (is_moment ? value : ROW_FEATURES + channel)] = sum;
}

__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void blend_backward(
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
    __local BackwardSpace space;
    __local REAL4 staged_records[BACKWARD_BATCH * RECORD_QUARTETS], staged_features[BACKWARD_BATCH * FEATURE_QUARTETS];
    __local int staged_slots[BACKWARD_BATCH];
    const int item = get_local_id(0), index = get_group_id(0);
    const int half_group = item / (TASKS * TILE), task = item % TASKS, slice = item / TASKS % TILE;
    __local REAL *slices = space.sums + half_group * TILE * SLICE_PITCH;
    const Tile tile = tile_of(index, width, height);
    const int first = tile_starts[index], end = first + walked[index];

    Pixel pixel = pixel_of(width, tile, feature_map, alphas, grad_feature_map, grad_alphas);
    for (int batch = first; batch < end; batch += BACKWARD_BATCH) {
        const int here = end - batch < BACKWARD_BATCH ? end - batch : BACKWARD_BATCH;
        stage_records(records, entries + batch, here, BACKWARD_BATCH, tile, staged_records);
        stage_features(features, entries + batch, here, BACKWARD_BATCH, staged_features);
        if (item < here) staged_slots[item] = slots[batch + item];
        barrier(CLK_LOCAL_MEM_FENCE);

        #pragma unroll
        for (int q = 0; q < WEIGHT_QUARTETS; q++) {
            REAL4 weights = 0, power_gradients = 0;
            #pragma unroll
            for (int n = 0; n < 4; n++)
                if (pixel.open)
                    blend_pixel(
                        &pixel, staged_records + (4 * q + n) * RECORD_QUARTETS,
                        staged_features + (4 * q + n) * FEATURE_QUARTETS, (REAL *)&weights + n,
                        (REAL *)&power_gradients + n
                    );
            space.pixels.weights[q * WEIGHT_PITCH + item] = weights;
            space.pixels.power_gradients[q * WEIGHT_PITCH + item] = power_gradients;
        }
        barrier(CLK_LOCAL_MEM_FENCE);

        REAL4 sums[ROUNDS][TASK_SUMS / 4];
        #pragma unroll
        for (int round = 0; round < ROUNDS; round++) {
            const int block = 2 * round + half_group;
            #pragma unroll
            for (int k = 0; k < TASK_SUMS / 4; k++) sums[round][k] = 0;
            if (block < FEATURE_BLOCKS)
                add_features(
                    width, tile, slice, block * BLOCK_FEATURES + task, grad_feature_map, space.pixels.weights,
                    sums[round]
                );
            else if (block == FEATURE_BLOCKS && task < here)
                add_moments(
                    slice, staged_records + task * RECORD_QUARTETS,
                    (__local const REAL *)(space.pixels.power_gradients + task / 4 * WEIGHT_PITCH) + task % 4,
                    (REAL *)sums[round]
                );
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        #pragma unroll
        for (int round = 0; round < ROUNDS; round++) {
            #pragma unroll
            for (int k = 0; k < TASK_SUMS; k++)
                slices[slice * SLICE_PITCH + k * TASKS + task] = ((const REAL *)sums[round])[k];
            barrier(CLK_LOCAL_MEM_FENCE);
            write_sum(
                2 * round + half_group, item % (TASKS * TILE), here, slices, staged_slots, gradient_rows
            );
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }
    __global REAL *background_row = background_rows + (size_t)index * FEATURE_DIM;
    sum_behind(width, tile, pixel.transmittance, grad_feature_map, space.sums, background_row);
    const size_t left = (size_t)(tile_starts[index + 1] - end) * GRADIENT_ROW;
    for (size_t i = item; i < left; i += GROUP_SIZE)
        gradient_rows[(size_t)GRADIENT_ROW * slots[end + i / GRADIENT_ROW] + i % GRADIENT_ROW] = 0;
}

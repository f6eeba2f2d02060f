// Gradients of `blend`, one work-group a tile, without atomics: each (tile, Gaussian) has a row of its own to write.
//
// Walks front to back as `blend` does. With a pixel's gradient g and what is blended behind Gaussian i, `rest`:
// dL/dalpha_i = T_i (c_i . g) - rest_i / (1 - alpha_i), where rest starts as (out . g) and loses w_i (c_i . g) at each
// step. Alpha counts as one more channel, of value 1, over a background of 0.
//
// A few Gaussians at once, in two phases. First a work-item is a pixel: it writes the Gaussians' weights w and their
// s = dL/dpower to local memory. Then it is a task over a slice of the pixels: the gradients of some features (sums of
// w g) of all these Gaussians, or the moments (of s) of one. What is read of a pixel thus serves several Gaussians. The
// slices' sums are added up in a fixed order.

// A gradient row, sums over the pixels: of s with u = dx - slope dy: s, s u, s dy, s u^2, s u dy, s dy^2, then of
// |dL/dx| and |dL/dy| of the centre where ABSOLUTE_GRADIENTS are wanted, and of the gradients of the features; filled
// up to whole sectors of memory.
#ifdef ABSOLUTE_GRADIENTS
#define MOMENTS 8
#else
#define MOMENTS 6
#endif
#define ROW_FEATURES 8
#define GRADIENT_ROW ((ROW_FEATURES + FEATURE_DIM + 7) / 8 * 8)

// Gaussians at once, so that a group needs less than 32 KiB of local memory.
#ifdef REAL_IS_DOUBLE
#define BACKWARD_BATCH 4
#else
#define BACKWARD_BATCH 8
#endif
#define WEIGHT_QUARTETS (BACKWARD_BATCH / 4)

// Tasks come in blocks of 8 times TILE slices, half a group: 16 features of all Gaussians, two a task; or, the last
// block, the moments, a Gaussian a task. Each half of the group takes every other block.
#define TASKS 8
#define BLOCK_FEATURES (2 * TASKS)
#define FEATURE_BLOCKS ((FEATURE_DIM + BLOCK_FEATURES - 1) / BLOCK_FEATURES)
#define ROUNDS ((FEATURE_BLOCKS + 2) / 2)
#define TASK_SUMS (2 * BACKWARD_BATCH)
#define BLOCK_SUMS (TASKS * TASK_SUMS)

// Distances in local memory: a little more than needed, so that what is read at once lies in different banks.
#define WEIGHT_PITCH (GROUP_SIZE + 4)
#define SLICE_PITCH (BLOCK_SUMS + 8)

// A group's local memory: what the pixels give to the tasks; then the sums of two blocks.
typedef union {
    struct {
        REAL4 weights[WEIGHT_QUARTETS * WEIGHT_PITCH], power_gradients[WEIGHT_QUARTETS * WEIGHT_PITCH];
    } pixels;
    REAL sums[2 * TILE * SLICE_PITCH];
} BackwardSpace;

// What a pixel knows: its gradients, how much of the light comes through, and what is blended behind (see above).
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

// Blends one Gaussian into an open pixel: its weight, and the gradient of its power, which are 0 so far.
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

// Sums over a slice, which is a column of the tile, of two features' gradients times the weights of all Gaussians:
// sums[c * WEIGHT_QUARTETS + q] holds four Gaussians' of the feature `channel` + c * TASKS.
static inline void add_features(
    int width, Tile tile, int slice, int channel, __global const REAL *grads, __local const REAL4 *weights, REAL4 *sums
) {
    // Where there is no such pixel or feature, some other is read: its weight is 0, or its sum is not used.
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

// Sums over a slice of one Gaussian's moments.
static inline void add_moments(
    int slice, __local const REAL4 *record, __local const REAL *power_gradients, REAL *sums
) {
    const REAL4 place = record[0];
#ifdef ABSOLUTE_GRADIENTS
    const REAL squares = R(-1.38629436111989061883);  // undoes the exponents' factor
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

// The gradient of the background: g times the light that is left, summed over the tile. (1 - alpha would not do: hardly
// a digit of it is sound where little light is left.)
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

// Adds the slices' sums of a block, of which this work-item takes one, and writes it into its Gaussian's row.
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

// Sums gradients over tiles: each Gaussian's gradient rows, and the tiles' shares of the background's gradient.

// ROW_FEATURES * ROW_SLICES work-items share a Gaussian: each sums every ROW_SLICES-th row and, of it, every
// ROW_FEATURES-th value. They split the rows because a Gaussian that covers the whole picture has thousands.
#define ROW_SLICES 4
#define VALUES_EACH (GRADIENT_ROW / ROW_FEATURES)
#define GROUP_GAUSSIANS (GROUP_SIZE / (ROW_FEATURES * ROW_SLICES))

// Whether value k of the v-th run of ROW_FEATURES values in a row is in use; others are never written.
static inline int in_row(int v, int k) {
    return v == 0 ? k < MOMENTS : (v - 1) * ROW_FEATURES + k < FEATURE_DIM;
}

// Sums each Gaussian's gradient rows, which are contiguous, in a fixed order: the result is bitwise reproducible.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void sum_gradients(
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
    __local REAL slices[VALUES_EACH][ROW_SLICES][GROUP_GAUSSIANS][ROW_FEATURES];
    const int k = get_local_id(0) % ROW_FEATURES, own = get_local_id(0) / ROW_FEATURES % GROUP_GAUSSIANS;
    const int slice = get_local_id(0) / (ROW_FEATURES * GROUP_GAUSSIANS), i = get_group_id(0) * GROUP_GAUSSIANS + own;
    const int rows = i < count ? tile_counts[i] : 0;
    REAL sums[VALUES_EACH];
    #pragma unroll
    for (int v = 0; v < VALUES_EACH; v++) sums[v] = 0;
    for (int n = slice; n < rows; n += ROW_SLICES) {
        __global const REAL *row = gradient_rows + (size_t)GRADIENT_ROW * (first_slots[i] + n) + k;
        #pragma unroll
        for (int v = 0; v < VALUES_EACH; v++)
            if (in_row(v, k)) sums[v] += row[v * ROW_FEATURES];
    }
    #pragma unroll
    for (int v = 0; v < VALUES_EACH; v++) slices[v][slice][own][k] = sums[v];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int v = slice; v < VALUES_EACH; v += ROW_SLICES)
        for (int other = 1; other < ROW_SLICES; other++) slices[v][0][own][k] += slices[v][other][own][k];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i >= count) return;
    for (int v = slice; v < VALUES_EACH; v += ROW_SLICES) {
        const size_t channel = (v - 1) * ROW_FEATURES + k;
        if (v > 0 && in_row(v, k)) grad_features[FEATURE_DIM * (size_t)i + channel] = slices[v][0][own][k];
    }
    if (slice > 0) return;
    __local const REAL *moments = slices[0][0][own];
    __global const REAL *record = records + (size_t)RECORD * i;
    const REAL slope = record[2], across = record[3], down = record[4], opacity = record[5];
    const REAL grad_x = across * moments[1], grad_y = down * moments[2] - slope * grad_x;
    if (k < 2) grad_means2d[2 * i + k] = k == 0 ? grad_x : grad_y;
#ifdef ABSOLUTE_GRADIENTS
    if (k >= 6) grad_absolute[2 * i + k - 6] = moments[k];
#endif
    grad_records[(size_t)RECORD * i + k] = k == 2 ? across * moments[4]
        : k == 3                                  ? R(-0.5) * moments[3]
        : k == 4                                  ? R(-0.5) * moments[5]
        : k == 5 && opacity > 0                   ? moments[0] / opacity
                                                  : 0;
}

// The background's gradient, one work-group per channel.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void sum_background(
    const int tiles, __global const REAL *background_rows, __global REAL *grad_background
) {
    __local REAL sums[GROUP_SIZE];
    const int item = get_local_id(0), k = get_group_id(0);
    REAL sum = 0;
    for (int tile = item; tile < tiles; tile += GROUP_SIZE) sum += background_rows[(size_t)tile * FEATURE_DIM + k];
    sums[item] = sum;
    for (int distance = GROUP_SIZE / 2; distance > 0; distance /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < distance) sums[item] += sums[item + distance];
    }
    if (item == 0) grad_background[k] = sums[0];
}

// Structural similarity. Each work-group takes a tile of SSIM_ROWS rows of SSIM_COLUMNS values.
//
// First, each work-item takes half of the tile's rows in one column, which may lie beside the tile, within reach of the
// window. It reads each value of the column once and adds it to the sums down of all rows that need it, kept in
// registers. These sums go to local memory, of which a work-group needs 32 KiB. Then the work-items sum across, each
// for other values of the tile.

#define BESIDE (3 * REACH)
#define COLUMNS_READ (SSIM_COLUMNS + 2 * BESIDE)  // half of GROUP_SIZE: a work-item for each half of the rows
#define OWN_ROWS (SSIM_ROWS / 2)
#define PITCH (SSIM_ROWS * COLUMNS_READ)  // distance between quantities in local memory

// Where a work-group's tile lies.
typedef struct {
    int top;     // the tile's first row, relative to its picture
    int origin;  // the picture's first row among all rows
    int left;    // the tile's first value within a row
} Patch;

static inline Patch patch_of(int rows, int length) {
    const int across = (length + SSIM_COLUMNS - 1) / SSIM_COLUMNS, down = (rows + SSIM_ROWS - 1) / SSIM_ROWS;
    const int group = get_group_id(0);
    Patch patch;
    patch.left = group % across * SSIM_COLUMNS;
    patch.top = group / across % down * SSIM_ROWS;
    patch.origin = group / across / down * rows;
    return patch;
}

// A work-item's column, as an index into a padded row; negative if it lies beyond the row.
static inline int own_column(Patch patch, int stride) {
    const int column = PADDING + patch.left - BESIDE + (int)get_local_id(0) % COLUMNS_READ;
    return column < stride ? column : -1;
}

// Adds a value of the column to the sums of all rows whose window contains it. `step` counts from the first row that
// the windows reach.
static inline void add_down(REAL sums[OWN_ROWS], int step, REAL value) {
    #pragma unroll
    for (int k = 0; k < OWN_ROWS; k++)
        if (step >= k && step - k < TAPS) sums[k] += window[step - k] * value;
}

static inline void keep_down(const REAL sums[OWN_ROWS], __local REAL *down) {
    #pragma unroll
    for (int k = 0; k < OWN_ROWS; k++) down[k * COLUMNS_READ] = sums[k];
}

static inline REAL sum_across(__local const REAL *down) {
    REAL sum = 0;
    #pragma unroll
    for (int tap = 0; tap < TAPS; tap++) sum += window[tap] * down[3 * (tap - REACH)];
    return sum;
}

__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void similarities(
    const int total,
    const int rows,
    const int length,
    const int stride,
    __global const REAL *pictures,
    __global const REAL *truths,
    __global REAL *by_mean,
    __global REAL *by_product,
    __global REAL *by_square,
    __global REAL *tile_sums
) {
    __local REAL down[4 * PITCH];
    const int item = get_local_id(0), first = item / COLUMNS_READ * OWN_ROWS;
    const Patch patch = patch_of(rows, length);
    const int column = own_column(patch, stride);

    REAL means[OWN_ROWS], means_of_truth[OWN_ROWS], products[OWN_ROWS], squares[OWN_ROWS];
    #pragma unroll
    for (int k = 0; k < OWN_ROWS; k++) means[k] = means_of_truth[k] = products[k] = squares[k] = 0;
    #pragma unroll
    for (int step = 0; step < OWN_ROWS + TAPS - 1; step++) {
        const int row = patch.top + first + step - REACH;
        if (column < 0 || row < 0 || row >= rows) continue;
        const size_t place = (size_t)(patch.origin + row) * stride + column;
        const REAL value = pictures[place], truth = truths[place];
        add_down(means, step, value);
        add_down(means_of_truth, step, truth);
        add_down(products, step, value * truth);
        add_down(squares, step, value * value + truth * truth);
    }
    __local REAL *own = down + first * COLUMNS_READ + item % COLUMNS_READ;
    keep_down(means, own);
    keep_down(means_of_truth, own + PITCH);
    keep_down(products, own + 2 * PITCH);
    keep_down(squares, own + 3 * PITCH);
    barrier(CLK_LOCAL_MEM_FENCE);

    REAL sum = 0;
    for (int i = item; i < SSIM_ROWS * SSIM_COLUMNS; i += GROUP_SIZE) {
        const int row = i / SSIM_COLUMNS, k = i % SSIM_COLUMNS;
        if (patch.top + row >= rows || patch.left + k >= length) continue;
        __local const REAL *at = down + row * COLUMNS_READ + BESIDE + k;
        const Similarity s = similarity_of(
            sum_across(at), sum_across(at + PITCH), sum_across(at + 2 * PITCH), sum_across(at + 3 * PITCH)
        );
        const size_t place = (size_t)(patch.origin + patch.top + row) * stride + PADDING + patch.left + k;
        sum += s.similarity;
        by_mean[place] = s.by_mean;
        by_product[place] = s.by_product;
        by_square[place] = s.by_square;
    }
    barrier(CLK_LOCAL_MEM_FENCE);  // all work-items have read the sums down; reuse their memory
    down[item] = sum;
    for (int others = GROUP_SIZE / 2; others > 0; others /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < others) down[item] += down[item + others];
    }
    if (item == 0) tile_sums[get_group_id(0)] = down[0];
}

// The gradient of the sum of all similarities with respect to each value of the pictures. The window is symmetric, so a
// value's gradient needs the windowed means of its neighbours' derivatives, by the same window.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void similarity_gradient(
    const int total,
    const int rows,
    const int length,
    const int stride,
    __global const REAL *pictures,
    __global const REAL *truths,
    __global const REAL *by_mean,
    __global const REAL *by_product,
    __global const REAL *by_square,
    __global REAL *gradients
) {
    __local REAL down[3 * PITCH];
    const int item = get_local_id(0), first = item / COLUMNS_READ * OWN_ROWS;
    const Patch patch = patch_of(rows, length);
    const int column = own_column(patch, stride);

    REAL means[OWN_ROWS], products[OWN_ROWS], squares[OWN_ROWS];
    #pragma unroll
    for (int k = 0; k < OWN_ROWS; k++) means[k] = products[k] = squares[k] = 0;
    #pragma unroll
    for (int step = 0; step < OWN_ROWS + TAPS - 1; step++) {
        const int row = patch.top + first + step - REACH;
        if (column < 0 || row < 0 || row >= rows) continue;
        const size_t place = (size_t)(patch.origin + row) * stride + column;
        add_down(means, step, by_mean[place]);
        add_down(products, step, by_product[place]);
        add_down(squares, step, by_square[place]);
    }
    __local REAL *own = down + first * COLUMNS_READ + item % COLUMNS_READ;
    keep_down(means, own);
    keep_down(products, own + PITCH);
    keep_down(squares, own + 2 * PITCH);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = item; i < SSIM_ROWS * SSIM_COLUMNS; i += GROUP_SIZE) {
        const int row = i / SSIM_COLUMNS, k = i % SSIM_COLUMNS;
        if (patch.top + row >= rows || patch.left + k >= length) continue;
        __local const REAL *at = down + row * COLUMNS_READ + BESIDE + k;
        const size_t place = (size_t)(patch.origin + patch.top + row) * stride + PADDING + patch.left + k;
        gradients[place] = sum_across(at) + sum_across(at + PITCH) * truths[place]
            + 2 * sum_across(at + 2 * PITCH) * pictures[place];
    }
}

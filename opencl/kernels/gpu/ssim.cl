// Structural similarity, each work-group a tile of SSIM_ROWS rows of SSIM_COLUMNS values.
//
// First each work-item takes a column, of the tile or of what the window reaches beside it, and half of the tile's
// rows: it reads each value once and adds it to all of its rows' sums down, which are in registers. These go to local
// memory, of which a group needs 32 KiB. Then it is any value of the tile, and sums across.

#define BESIDE (3 * REACH)
#define COLUMNS_READ (SSIM_COLUMNS + 2 * BESIDE)  // two of these times half of the rows are the group's work-items
#define OWN_ROWS (SSIM_ROWS / 2)
#define PITCH (SSIM_ROWS * COLUMNS_READ)  // from one quantity to the next

// Where a group's tile lies.
typedef struct {
    int top;     // its first row, counted from the picture's first
    int origin;  // the picture's first row
    int left;    // its first value in a row
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

// Where in the pictures a work-item's column begins, in their first row; negative where there is none.
static inline int own_column(Patch patch, int stride) {
    const int column = PADDING + patch.left - BESIDE + (int)get_local_id(0) % COLUMNS_READ;
    return column < stride ? column : -1;
}

// Adds a value of the column, the `step`th that its rows' windows reach, to the sums of all rows that it is for.
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
    barrier(CLK_LOCAL_MEM_FENCE);  // what was summed down is read, and its memory free
    down[item] = sum;
    for (int others = GROUP_SIZE / 2; others > 0; others /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < others) down[item] += down[item + others];
    }
    if (item == 0) tile_sums[get_group_id(0)] = down[0];
}

// The gradient of the sum of all similarities by each value of the pictures: the window is symmetric, so that every
// value passes on what the windows about its neighbours say of it.
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

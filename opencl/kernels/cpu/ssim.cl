// Structural similarity. Each work-item takes a strip of SSIM_STRIP values of one row.

static inline LANES lanes_at(__global const REAL *values) { return *(__global const UNALIGNED_LANES *)values; }

static inline void keep_lanes(__global REAL *values, LANES lanes) { *(__global UNALIGNED_LANES *)values = lanes; }

// The windowed mean across, from the windowed means down.
static inline LANES across(const REAL *down) {
    LANES sum = (LANES)(0);
    for (int tap = 0; tap < TAPS; tap++) sum += window[tap] * *(const UNALIGNED_LANES *)(down + 3 * (tap - REACH));
    return sum;
}

static inline int groups_of_lanes(int start, int length) {
    const int left = length - start < SSIM_STRIP ? length - start : SSIM_STRIP;
    return (left + 15) / 16;
}

__kernel void similarities(
    const int total,
    const int rows,
    const int length,
    const int stride,
    __global const REAL *pictures,
    __global const REAL *truths,
    __global REAL *by_mean,
    __global REAL *by_product,
    __global REAL *by_square,
    __global REAL *strip_sums
) {
    const int strips = (length + SSIM_STRIP - 1) / SSIM_STRIP;
    const int row = get_global_id(0) / strips, start = get_global_id(0) % strips * SSIM_STRIP, within = row % rows;
    if (row >= total) return;
    const int first = within < REACH ? -within : -REACH, last = within + REACH < rows ? REACH : rows - 1 - within;
    const LANES order = (LANES)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    REAL down[4][SSIM_STRIP + 2 * PADDING];
    LANES sums = (LANES)(0);
    const int groups = groups_of_lanes(start, length);
    for (int group = 0; group < groups + 2; group++) {
        LANES mean = (LANES)(0), mean_of_truth = mean, product = mean, squares = mean;
        for (int offset = first; offset <= last; offset++) {
            const size_t place = (size_t)(row + offset) * stride + start + 16 * group;
            const LANES value = lanes_at(pictures + place), truth = lanes_at(truths + place);
            const LANES weighted = window[offset + REACH] * value, weighted_truth = window[offset + REACH] * truth;
            mean += weighted;
            mean_of_truth += weighted_truth;
            product += weighted * truth;
            squares += weighted * value + weighted_truth * truth;
        }
        *(UNALIGNED_LANES *)(down[0] + 16 * group) = mean;
        *(UNALIGNED_LANES *)(down[1] + 16 * group) = mean_of_truth;
        *(UNALIGNED_LANES *)(down[2] + 16 * group) = product;
        *(UNALIGNED_LANES *)(down[3] + 16 * group) = squares;
    }
    for (int group = 0; group < groups; group++) {
        const int inside = PADDING + 16 * group;
        const LANES mean = across(down[0] + inside), mean_of_truth = across(down[1] + inside);
        const Similarity s = similarity_of(mean, mean_of_truth, across(down[2] + inside), across(down[3] + inside));

        // Lanes past the end of the row contribute nothing.
        const LANES_MASK within_row = order < (LANES)(length - start - 16 * group);
        const size_t place = (size_t)row * stride + PADDING + start + 16 * group;
        sums += within_row ? s.similarity : (LANES)(0);
        keep_lanes(by_mean + place, within_row ? s.by_mean : (LANES)(0));
        keep_lanes(by_product + place, within_row ? s.by_product : (LANES)(0));
        keep_lanes(by_square + place, within_row ? s.by_square : (LANES)(0));
    }
    REAL sum = 0;
    for (int lane = 0; lane < 16; lane++) sum += ((const REAL *)&sums)[lane];
    strip_sums[get_global_id(0)] = sum;
}

// The gradient of the sum of all similarities with respect to each value of the pictures. The window is symmetric, so a
// value's gradient needs the windowed means of its neighbours' derivatives, by the same window.
__kernel void similarity_gradient(
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
    const int strips = (length + SSIM_STRIP - 1) / SSIM_STRIP;
    const int row = get_global_id(0) / strips, start = get_global_id(0) % strips * SSIM_STRIP, within = row % rows;
    if (row >= total) return;
    const int first = within < REACH ? -within : -REACH, last = within + REACH < rows ? REACH : rows - 1 - within;
    REAL down[3][SSIM_STRIP + 2 * PADDING];
    const int groups = groups_of_lanes(start, length);
    for (int group = 0; group < groups + 2; group++) {
        LANES mean = (LANES)(0), product = mean, square = mean;
        for (int offset = first; offset <= last; offset++) {
            const size_t place = (size_t)(row + offset) * stride + start + 16 * group;
            mean += window[offset + REACH] * lanes_at(by_mean + place);
            product += window[offset + REACH] * lanes_at(by_product + place);
            square += window[offset + REACH] * lanes_at(by_square + place);
        }
        *(UNALIGNED_LANES *)(down[0] + 16 * group) = mean;
        *(UNALIGNED_LANES *)(down[1] + 16 * group) = product;
        *(UNALIGNED_LANES *)(down[2] + 16 * group) = square;
    }
    for (int group = 0; group < groups; group++) {
        const int inside = PADDING + 16 * group;
        const size_t place = (size_t)row * stride + PADDING + start + 16 * group;
        keep_lanes(
            gradients + place,
            across(down[0] + inside) + across(down[1] + inside) * lanes_at(truths + place)
                + 2 * across(down[2] + inside) * lanes_at(pictures + place)
        );
    }
}

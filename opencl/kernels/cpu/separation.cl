// The penalty that separates pictures which share their Gaussians' features, and its gradients, in one pass over the
// Gaussians (see separation.py).
//
// A linear layer projects the centred features x = sigmoid(f) - 1/2 onto three groups of vectors: all readings
// (`filled_readings` outputs), the directions of all pictures (`filled_pictures` outputs), which yield the shares, and,
// for each reading, the direction of its own picture (`filled_readings` outputs). Groups are padded to multiples of 16;
// padding has zero weights and biases.

// Replaces all values f of a block by sigmoid(f) - 1/2; NaN stays NaN.
WHOLE_REGISTERS static inline void centre(__global REAL *block, int width) {
    for (int place = 0; place < width * PIXEL_CHUNK; place += 16) {
        const LANES value = *(LANES_IN)(block + place);
        const LANES below = value < 0 ? value : -value;
        const LANES power = exp2_of_lanes(below * R(1.4426950408889634));
        const LANES positive = R(0.5) - power / (1 + power);
        *(LANES_OUT)(block + place) = value != value ? value : value < 0 ? -positive : positive;
    }
}

static inline LANES as_share(LANES value) {
    const LANES positive = value < 0 ? (LANES)(0) : value;
    return positive > 1 ? (LANES)(1) : positive;
}

// Sums how far each reading's absolute value exceeds half its share. Replaces each reading by `slope` times its sign
// where it does, and by 0 elsewhere.
WHOLE_REGISTERS static inline REAL beyond_shares(
    __global REAL *readings, __global const REAL *shares, int width, int rows, REAL slope
) {
    LANES sum = 0;
    for (int channel = 0; channel < width; channel += 16)
        for (int row = 0; row < rows; row++) {
            const int place = channel * PIXEL_CHUNK + row * 16;
            const LANES value = *(LANES_IN)(readings + place);
            const LANES over = (value < 0 ? -value : value) - R(0.5) * as_share(*(LANES_IN)(shares + place));
            sum += over < 0 ? (LANES)(0) : over;
            const LANES way = value < 0 ? (LANES)(-slope) : value > 0 ? (LANES)(slope) : (LANES)(0);
            *(LANES_OUT)(readings + place) = over < 0 ? (LANES)(0) : way;
        }
    const REAL8 eight = sum.lo + sum.hi;
    REAL total = 0;
    for (int place = 0; place < 8; place++) total += ((const REAL *)&eight)[place];
    return total;
}

// Sums the products of the shares of every pair of pictures. Replaces each share by `slope` times the sum's gradient.
static inline REAL common_shares(__global REAL *shares, int pictures, int rows, REAL slope) {
    REAL total = 0;
    for (int row = 0; row < rows; row++) {
        REAL sum = 0;
        for (int picture = 0; picture < pictures; picture++) {
            const REAL value = shares[picture / 16 * PIXEL_CHUNK * 16 + row * 16 + picture % 16];
            const REAL share = value < 0 ? 0 : value > 1 ? 1 : value;
            total += sum * share;
            sum += share;
        }
        for (int picture = 0; picture < pictures; picture++) {
            __global REAL *place = shares + picture / 16 * PIXEL_CHUNK * 16 + row * 16 + picture % 16;
            const REAL value = *place;
            *place = value < 0 || value > 1 ? 0 : slope * (sum - value);
        }
    }
    return total;
}

// `slopes` are the factors of the two sums. Per work-item, `sums` holds the gradient of all readings,
// [filled_channels][filled_readings], that of a bias, which is not used, and the two sums, common_shares first. If
// `gradient`, that of the features, is null, no gradients are computed.
__kernel void separation(
    const int count,
    const int channels,
    const int pictures,
    const int filled_channels,
    const int filled_readings,
    const int filled_pictures,
    const int scratch_size,
    __global REAL *scratch,
    __global const REAL *slopes,
    __global const REAL *features,
    __global const REAL *weights,
    __global const REAL *turned,
    __global REAL *gradient,
    __global REAL *sums
) {
    const int passing = filled_readings + filled_pictures, weight_count = (filled_channels + 1) * filled_readings;
    __global REAL *centred = scratch + get_group_id(0) * (size_t)scratch_size;
    __global REAL *readings = centred + PIXEL_CHUNK * filled_channels;
    __global REAL *shares = readings + PIXEL_CHUNK * filled_readings, *own = shares + PIXEL_CHUNK * filled_pictures;
    __global REAL *passed = own + PIXEL_CHUNK * filled_readings;
    __global REAL *totals = sums + get_group_id(0) * (size_t)(weight_count + 2);
    for (int place = 0; place < weight_count; place++) totals[place] = 0;
    REAL common = 0, beyond = 0;
    for (int first = get_group_id(0) * PIXEL_CHUNK; first < count; first += get_num_groups(0) * PIXEL_CHUNK) {
        const int rows = first + PIXEL_CHUNK < count ? PIXEL_CHUNK : count - first;
        read_block(features, channels, first, count, filled_channels, centred);
        centre(centred, filled_channels);
        show_layer(centred, filled_channels, weights, passing + filled_readings, 0, readings);
        common += common_shares(shares, pictures, rows, slopes[0]);
        beyond += beyond_shares(readings, own, filled_readings, rows, slopes[1]);
        if (!gradient) continue;
        add_gradients(centred, filled_channels, readings, filled_readings, totals);
        pass_gradient(readings, passing, turned, centred, filled_channels, 0, passed);
        for (int place = 0; place < filled_channels * PIXEL_CHUNK; place += 16) {
            const LANES value = *(LANES_IN)(centred + place);
            *(LANES_OUT)(passed + place) = *(LANES_IN)(passed + place) * (R(0.25) - value * value);
        }
        write_block(passed, channels, first, count, gradient);
    }
    totals[weight_count] = common;
    totals[weight_count + 1] = beyond;
}

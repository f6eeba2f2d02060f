// Gradients of `blend`, one work-item a tile, without atomics: each (tile, Gaussian) has a row of its own to write.
//
// Walks front to back as `blend` does. With a pixel's gradient g and what is blended behind Gaussian i, `rest`:
// dL/dalpha_i = T_i (c_i . g) - rest_i / (1 - alpha_i), where rest starts as (out . g) and loses w_i (c_i . g) at each
// step. Alpha counts as one more channel, of value 1, over a background of 0.

// A gradient row, sums over the pixels: of s = dL/dpower with u = dx - slope dy: s, s u, s dy, s u^2, s u dy, s dy^2,
// and of the gradients of the features; then padding.
#define MOMENTS 6
#define SUMS (MOMENTS + FEATURE_DIM)
#define SUM_GROUPS ((SUMS + TILE - 1) / TILE)
#define GRADIENT_ROW (SUM_GROUPS * TILE)

// Asks for the row that is written FETCH_AHEAD after this entry's.
inline void fetch_row_ahead(__global const REAL *gradient_rows, __global const int *slots, int entry, int end) {
    const int slot = slots[entry + FETCH_AHEAD < end ? entry + FETCH_AHEAD : entry];
    for (int group = 0; group < SUM_GROUPS; group++) FETCH(gradient_rows + (size_t)GRADIENT_ROW * slot + group * TILE);
}

__kernel void blend_backward(
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
    LANES transmittance[TILE], rest[TILE], grad_alpha[TILE], by_channel[TILE * FEATURE_DIM];
    REAL behind[FEATURE_DIM];
    for (int k = 0; k < FEATURE_DIM; k++) behind[k] = 0;
    for (int row = 0; row < TILE; row++) {
        transmittance[row] = fresh_transmittance(tile.columns);
        rest[row] = grad_alpha[row] = (LANES)(R(0));
        for (int k = 0; k < FEATURE_DIM; k++) by_channel[row * FEATURE_DIM + k] = (LANES)(R(0));
        for (int column = 0; column < tile.columns && row < tile.rows; column++) {
            const size_t at = (size_t)(tile.top + row) * width + tile.left + column;
            const REAL left = 1 - alphas[at];
            REAL product = alphas[at] * grad_alphas[at];
            for (int k = 0; k < FEATURE_DIM; k++) {
                const REAL grad = grad_feature_map[at * FEATURE_DIM + k];
                product += feature_map[at * FEATURE_DIM + k] * grad;
                behind[k] += grad * left;
                ((REAL *)(by_channel + row * FEATURE_DIM + k))[column] = grad;
            }
            ((REAL *)(rest + row))[column] = product;
            ((REAL *)(grad_alpha + row))[column] = grad_alphas[at];
        }
    }
    for (int k = 0; k < FEATURE_DIM; k++) background_rows[(size_t)index * FEATURE_DIM + k] = behind[k];

    const int first = tile_starts[index], end = first + walked[index];
    int open_rows = (1 << tile.rows) - 1;
    for (int entry = first; entry < end; entry++) {
        fetch_ahead(records, features, entries, entry, end);
        fetch_row_ahead(gradient_rows, slots, entry, end);
        const int gaussian = entries[entry];
        const Splat splat = splat_of(records + (size_t)RECORD * gaussian, tile);
        __global const REAL *feature = features + (size_t)FEATURE_DIM * gaussian;
        const LANES zero = (LANES)(R(0));
        LANES sums[SUM_GROUPS * TILE];
        for (int k = 0; k < SUM_GROUPS * TILE; k++) sums[k] = zero;
        REAL middle = splat.first_row + R(0.5);
        for (int row = splat.first_row; row <= splat.last_row; row++, middle += 1) {
            if (!(open_rows >> row & 1)) continue;
            const SplatRow r = splat_row_of(splat, middle);
            const LANES_MASK clamped = r.alpha > ALPHA_MAXIMUM;
            const LANES alpha = clamped ? (LANES)(ALPHA_MAXIMUM) : r.alpha;
            const LANES before = transmittance[row];
            const LANES weights = weights_of(alpha, transmittance + row);
            LANES product = grad_alpha[row];
            for (int k = 0; k < FEATURE_DIM; k++) {
                const LANES grad = by_channel[row * FEATURE_DIM + k];
                product += grad * feature[k];
                sums[MOMENTS + k] += grad * weights;
            }
            rest[row] -= weights * product;
            const LANES grad = before * product - rest[row] / (R(1) - alpha);
            const LANES s = (weights > R(0)) & ~clamped ? grad * alpha : zero;
            const LANES su = s * r.across;
            sums[0] += s;
            sums[1] += su;
            sums[2] += s * r.down;
            sums[3] += su * r.across;
            sums[4] += su * r.down;
            sums[5] += s * (r.down * r.down);
        }
        __global REAL *gradient = gradient_rows + (size_t)GRADIENT_ROW * slots[entry];
        for (int group = 0; group < SUM_GROUPS; group++)
            *(__global UNALIGNED_LANES *)(gradient + group * TILE) = sums_of_lanes(sums + group * TILE);
        if ((entry & (LOOK_AGAIN - 1)) == LOOK_AGAIN - 1) open_rows = open_rows_of(transmittance, tile.rows);
    }
    for (int entry = end; entry < tile_starts[index + 1]; entry++) {
        __global REAL *gradient = gradient_rows + (size_t)GRADIENT_ROW * slots[entry];
        for (int k = 0; k < GRADIENT_ROW; k++) gradient[k] = 0;
    }
}

#define SUM_CHUNK 128

// Adds up each Gaussian's gradient rows, which lie side by side, in their order: the same bits every time.
__kernel void sum_gradients(
    const int count,
    __global const REAL *records,
    __global const int *tile_counts,
    __global const int *first_slots,
    __global const REAL *gradient_rows,
    __global REAL *grad_means2d,
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
        grad_record[0] = grad_record[1] = grad_record[6] = grad_record[7] = 0;
        grad_record[2] = across * sums[4];
        grad_record[3] = R(-0.5) * sums[3];
        grad_record[4] = R(-0.5) * sums[5];
        grad_record[5] = opacity > 0 ? sums[0] / opacity : 0;
        for (int k = 0; k < FEATURE_DIM; k++) grad_features[(size_t)FEATURE_DIM * i + k] = sums[MOMENTS + k];
    }
}

// The background's gradient: the tiles' shares, in order.
__kernel void sum_background(const int tiles, __global const REAL *background_rows, __global REAL *grad_background) {
    for (int k = 0; k < FEATURE_DIM; k++) {
        REAL sum = 0;
        for (int tile = 0; tile < tiles; tile++) sum += background_rows[(size_t)tile * FEATURE_DIM + k];
        grad_background[k] = sum;
    }
}

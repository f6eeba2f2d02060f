// Which Gaussians each tile of 16 x 16 pixels draws, nearest first.
//
// Gaussians are sorted by depth once; a counting sort by tile, stable and therefore keeping that order, makes the
// lists. It runs in TILING_BLOCKS runs of the depth order: each counts its own, one scan gives every (run, tile) its
// place, each writes its own. What comes out does not depend on how many run at once.

#define DIGIT_BITS 11
#define DIGITS (1 << DIGIT_BITS)

// Visible Gaussians by depth, equal depths by index: a radix sort by one work-item, over all digits of the key.
__kernel void sort_by_depth(
    const int count,
    __global const int *radii,
    __global const DEPTH_KEY *depth_keys,
    __global int *order,
    __global int *spare_order,
    __global int *visible_count
) {
    int visible = 0;
    for (int i = 0; i < count; i++)
        if (radii[i] > 0) order[visible++] = i;
    visible_count[0] = visible;
    __global int *from = order, *to = spare_order;
    for (int shift = 0; shift < 8 * (int)sizeof(DEPTH_KEY); shift += DIGIT_BITS) {
        int starts[DIGITS];
        for (int digit = 0; digit < DIGITS; digit++) starts[digit] = 0;
        for (int i = 0; i < visible; i++) starts[(depth_keys[from[i]] >> shift) & (DIGITS - 1)]++;
        int start = 0;
        for (int digit = 0; digit < DIGITS; digit++) {
            const int size = starts[digit];
            starts[digit] = start;
            start += size;
        }
        for (int i = 0; i < visible; i++) to[starts[(depth_keys[from[i]] >> shift) & (DIGITS - 1)]++] = from[i];
        __global int *swap = from;
        from = to;
        to = swap;
    }
    if (from != order)
        for (int i = 0; i < visible; i++) order[i] = from[i];
}

// Rows of pixels, or none (first > last), that a Gaussian reaches, before the slack that rounding needs.
inline void tile_rows_of(__global const REAL *record, int height, int *first, int *last) {
    const REAL half_height = sqrt((record[6] + REACH_SLACK) / record[4]);
    REAL low = record[1] - half_height - R(0.51), high = record[1] + half_height - R(0.49);
    low = low < 0 ? 0 : low;
    high = high > height - 1 ? height - 1 : high;
    *first = low > high ? 1 : (int)low / TILE;
    *last = low > high ? 0 : (int)high / TILE;
}

// Tiles that a Gaussian reaches in one row of tiles: the ellipse of alpha >= ALPHA_MINIMUM, cut to that strip.
inline void tile_columns_of(__global const REAL *record, int row, int width, int *first, int *last) {
    const REAL slope = record[2], reach = record[6] + REACH_SLACK;
    const REAL variance_across = 1 / record[3], variance_y = 1 / record[4];
    const REAL half_height = sqrt(reach * variance_y);
    REAL top = row * TILE - record[1], bottom = top + TILE;
    top = top < -half_height ? -half_height : top;
    bottom = bottom > half_height ? half_height : bottom;
    *first = 1;
    *last = 0;
    if (top > bottom) return;
    // The rightmost point of the whole ellipse, or what of the strip is nearest to it; the leftmost lies opposite.
    const REAL extreme = slope * variance_y * sqrt(reach / (variance_across + slope * slope * variance_y));
    const REAL right = extreme < top ? top : extreme > bottom ? bottom : extreme;
    const REAL left = -extreme < top ? top : -extreme > bottom ? bottom : -extreme;
    const REAL over_right = reach - right * right * record[4], over_left = reach - left * left * record[4];
    const REAL half_right = sqrt(variance_across * (over_right > 0 ? over_right : 0));
    const REAL half_left = sqrt(variance_across * (over_left > 0 ? over_left : 0));
    const REAL slack = R(0.51) + R(1e-5) * (half_height * (slope < 0 ? -slope : slope) + half_right);
    REAL low = record[0] + slope * left - half_left - slack;
    REAL high = record[0] + slope * right + half_right + slack - 1;
    low = low < 0 ? 0 : low;
    high = high > width - 1 ? width - 1 : high;
    if (low > high) return;
    *first = (int)low / TILE;
    *last = (int)high / TILE;
}

inline int run_start(int run, int visible) { return (int)((long)visible * run / TILING_BLOCKS); }

// How many Gaussians of its run fall on each tile, and in all.
__kernel void count_tiles(
    const int width,
    const int height,
    __global const int *visible_count,
    __global const int *order,
    __global const REAL *records,
    __global int *tile_counts,
    __global int *places,
    __global long *run_totals
) {
    const int run = get_global_id(0), visible = visible_count[0];
    const int columns = (width + TILE - 1) / TILE, tiles = columns * ((height + TILE - 1) / TILE);
    __global int *counts = places + (size_t)run * tiles;
    for (int tile = 0; tile < tiles; tile++) counts[tile] = 0;
    long run_total = 0;
    for (int i = run_start(run, visible); i < run_start(run + 1, visible); i++) {
        __global const REAL *record = records + (size_t)RECORD * order[i];
        int first_row, last_row, total = 0;
        tile_rows_of(record, height, &first_row, &last_row);
        for (int row = first_row; row <= last_row; row++) {
            int first, last;
            tile_columns_of(record, row, width, &first, &last);
            for (int column = first; column <= last; column++) counts[row * columns + column]++;
            total += last - first + 1;
        }
        tile_counts[order[i]] = total;
        run_total += total;
    }
    run_totals[run] = run_total;
}

// Counts become places: tile by tile, and in each tile run by run.
__kernel void place_tiles(const int tiles, __global int *places, __global int *tile_starts, __global long *run_totals) {
    long total = 0;
    for (int run = 0; run < TILING_BLOCKS; run++) {
        const long run_total = run_totals[run];
        run_totals[run] = total;
        total += run_total;
    }
    run_totals[TILING_BLOCKS] = total;
    if (total > INT_MAX) return;
    int place = 0;
    for (int tile = 0; tile < tiles; tile++) {
        tile_starts[tile] = place;
        for (int run = 0; run < TILING_BLOCKS; run++) {
            const int count = places[(size_t)run * tiles + tile];
            places[(size_t)run * tiles + tile] = place;
            place += count;
        }
    }
    tile_starts[tiles] = place;
}

// The lists: for each entry its Gaussian and its slot, where all slots of one Gaussian lie side by side.
__kernel void fill_tiles(
    const int width,
    const int height,
    __global const int *visible_count,
    __global const int *order,
    __global const REAL *records,
    __global int *places,
    __global const long *run_totals,
    __global int *first_slots,
    __global int *entries,
    __global int *slots
) {
    const int run = get_global_id(0), visible = visible_count[0];
    const int columns = (width + TILE - 1) / TILE, tiles = columns * ((height + TILE - 1) / TILE);
    __global int *place = places + (size_t)run * tiles;
    int slot = (int)run_totals[run];
    for (int i = run_start(run, visible); i < run_start(run + 1, visible); i++) {
        __global const REAL *record = records + (size_t)RECORD * order[i];
        first_slots[order[i]] = slot;
        int first_row, last_row;
        tile_rows_of(record, height, &first_row, &last_row);
        for (int row = first_row; row <= last_row; row++) {
            int first, last;
            tile_columns_of(record, row, width, &first, &last);
            for (int column = first; column <= last; column++) {
                const int at = place[row * columns + column]++;
                entries[at] = order[i];
                slots[at] = slot++;
            }
        }
    }
}

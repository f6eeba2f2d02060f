// Lists the Gaussians that each tile of 16 x 16 pixels draws, nearest first.
//
// Gaussians are sorted by depth once. A counting sort by tile then makes the lists; it is stable, so it preserves the
// depth order. It splits that order into TILING_RUNS runs, one per work-item: each run counts its entries per tile, one
// scan assigns every (run, tile) pair its place, and each run writes its entries. The result does not depend on how
// many runs execute at once.

#define DIGIT_BITS 11
#define DIGITS (1 << DIGIT_BITS)

// Sorts the visible Gaussians by depth, ties by index: a radix sort over all digits of the key, by one work-item.
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

// Prefetches the record that is read FETCH_AHEAD Gaussians later.
static inline void fetch_record(__global const REAL *records, __global const int *order, int i, int end) {
    FETCH(records + (size_t)RECORD * order[i + FETCH_AHEAD < end ? i + FETCH_AHEAD : i]);
}

static inline int run_start(int run, int visible) { return (int)((long)visible * run / TILING_RUNS); }

// Each work-item counts the (tile, Gaussian) pairs of its run: per tile, per Gaussian and in total.
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
    const int end = run_start(run + 1, visible);
    for (int i = run_start(run, visible); i < end; i++) {
        fetch_record(records, order, i, end);
        const Ellipse ellipse = ellipse_of(records + (size_t)RECORD * order[i], height);
        int total = 0;
        for (int row = ellipse.first_row; row <= ellipse.last_row; row++) {
            int first, last;
            columns_of(ellipse, row, width, &first, &last);
            for (int column = first; column <= last; column++) counts[row * columns + column]++;
            total += last - first + 1;
        }
        if (tile_counts) tile_counts[order[i]] = total;
        run_total += total;
    }
    run_totals[run] = run_total;
}

// Turns counts into places in the lists, ordered by tile and, within a tile, by run; and the runs' totals into their
// first slots, followed by the grand total.
__kernel void place_tiles(const int tiles, __global int *places, __global int *tile_starts, __global long *run_totals) {
    long total = 0;
    for (int run = 0; run < TILING_RUNS; run++) {
        const long run_total = run_totals[run];
        run_totals[run] = total;
        total += run_total;
    }
    run_totals[TILING_RUNS] = total;
    if (total > INT_MAX) return;
    int place = 0;
    for (int tile = 0; tile < tiles; tile++) {
        tile_starts[tile] = place;
        for (int run = 0; run < TILING_RUNS; run++) {
            const int count = places[(size_t)run * tiles + tile];
            places[(size_t)run * tiles + tile] = place;
            place += count;
        }
    }
    tile_starts[tiles] = place;
}

// Writes the lists: for each entry, its Gaussian and its slot. All slots of a Gaussian are contiguous.
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
    const int end = run_start(run + 1, visible);
    for (int i = run_start(run, visible); i < end; i++) {
        fetch_record(records, order, i, end);
        if (first_slots) first_slots[order[i]] = slot;
        const Ellipse ellipse = ellipse_of(records + (size_t)RECORD * order[i], height);
        for (int row = ellipse.first_row; row <= ellipse.last_row; row++) {
            int first, last;
            columns_of(ellipse, row, width, &first, &last);
            for (int column = first; column <= last; column++) {
                const int at = place[row * columns + column]++;
                entries[at] = order[i];
                if (slots) slots[at] = slot++;
            }
        }
    }
}

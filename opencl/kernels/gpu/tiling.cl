// Lists the Gaussians that each tile of 16 x 16 pixels draws, nearest first.
//
// Gaussians are sorted by depth. Each then gets one slot per tile that it reaches, all contiguous, and the slots are
// sorted by tile. That sort is stable, so it preserves the depth order.
//
// Two kernels test which tiles a Gaussian reaches: one counts them, the other fills the slots. Should a compiler round
// them differently after all (see footprint.cl), tiles without a slot are dropped, and slots without a tile are
// assigned to an extra tile after the last, which is never drawn.

// Keys for the sort by depth; invisible Gaussians come last. The order is the same whether keys are compared as signed
// or as unsigned integers: depths are positive, and the largest signed integer is the bit pattern of a NaN.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void key_by_depth(
    const int count,
    __global const int *radii,
    __global const DEPTH_KEY *depth_keys,
    __global DEPTH_KEY *keys,
    __global int *order
) {
    const int i = get_global_id(0);
    if (i >= count) return;
    keys[i] = radii[i] > 0 ? depth_keys[i] : ~(DEPTH_KEY)0 >> 1;
    order[i] = i;
}

// Counts the tiles of each Gaussian, stored both by Gaussian and in depth order.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void count_tiles(
    const int count,
    const int width,
    const int height,
    __global const int *radii,
    __global const int *order,
    __global const REAL *records,
    __global int *tile_counts,
    __global long *ordered_counts
) {
    const int i = get_global_id(0);
    if (i >= count) return;
    const int gaussian = order[i];
    int total = 0;
    if (radii[gaussian] > 0) {
        const Ellipse ellipse = ellipse_of(records + (size_t)RECORD * gaussian, height);
        for (int row = ellipse.first_row; row <= ellipse.last_row; row++) {
            int first, last;
            columns_of(ellipse, row, width, &first, &last);
            total += last - first + 1;
        }
    }
    tile_counts[gaussian] = total;
    ordered_counts[i] = total;
}

// The first index in an ascending array whose value is at least `value`; `count` if there is none.
static inline int find_slot_start(__global const long *starts, int count, long value) {
    int low = 0, high = count;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (starts[middle] < value) low = middle + 1;
        else high = middle;
    }
    return low;
}

static inline int find_key(__global const DEPTH_KEY *keys, int count, DEPTH_KEY key) {
    int low = 0, high = count;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (keys[middle] < key) low = middle + 1;
        else high = middle;
    }
    return low;
}

// Finds the Gaussian and the tile of each slot. One work-item per slot, not per Gaussian: a Gaussian that fills the
// picture would hold up its work-item.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void fill_slots(
    const int total,
    const int count,
    const int width,
    const int height,
    __global const int *order,
    __global const long *slot_starts,
    __global const REAL *records,
    __global int *tile_counts,
    __global int *first_slots,
    __global int *gaussians,
    __global DEPTH_KEY *tiles,
    __global int *slots
) {
    const int slot = get_global_id(0);
    if (slot >= total) return;
    // Gaussians without tiles start where the next one does: the last that starts at or before this slot owns it.
    const int place = find_slot_start(slot_starts, count, (long)slot + 1) - 1;
    const int gaussian = order[place], start = (int)slot_starts[place];
    const int columns = (width + TILE - 1) / TILE, rows = (height + TILE - 1) / TILE;
    if (slot == start) first_slots[gaussian] = slot;
    const Ellipse ellipse = ellipse_of(records + (size_t)RECORD * gaussian, height);
    int left = slot - start, row = ellipse.first_row, first, last;
    for (; row <= ellipse.last_row; row++) {
        columns_of(ellipse, row, width, &first, &last);
        if (left <= last - first) break;
        left -= last - first + 1;
    }
    const bool has_tile = row <= ellipse.last_row;
    if (!has_tile && left == 0) tile_counts[gaussian] = slot - start;  // the first surplus slot
    gaussians[slot] = gaussian;
    tiles[slot] = has_tile ? row * columns + first + left : rows * columns;
    slots[slot] = slot;
}

// Finds where each tile's entries start in the sorted lists. The start of the tile after the last is the number of
// entries that are drawn.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void start_tiles(
    const int tiles, const int total, __global const DEPTH_KEY *sorted_tiles, __global int *tile_starts
) {
    const int tile = get_global_id(0);
    if (tile <= tiles) tile_starts[tile] = find_key(sorted_tiles, total, (DEPTH_KEY)tile);
}

__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void fill_entries(
    const int total, __global const int *gaussians, __global const int *slots, __global int *entries
) {
    const int entry = get_global_id(0);
    if (entry < total) entries[entry] = gaussians[slots[entry]];
}

// Exclusive prefix sums over arrays of any length: work-groups scan a chunk each, then the chunks' totals are scanned.

#define SCAN_ITEMS (SCAN_CHUNK / GROUP_SIZE)

// Returns the sum of the values of all work-items before this one; `total` receives that of the whole work-group. All
// work-items of the group must call it. `sums` has room for 2 * GROUP_SIZE values.
static inline long scan_of_group(long value, __local long *sums, long *total) {
    const int item = get_local_id(0);
    __local long *from = sums, *to = sums + GROUP_SIZE;
    from[item] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int distance = 1; distance < GROUP_SIZE; distance *= 2) {
        to[item] = from[item] + (item >= distance ? from[item - distance] : 0);
        barrier(CLK_LOCAL_MEM_FENCE);
        __local long *swap = from;
        from = to;
        to = swap;
    }
    *total = from[GROUP_SIZE - 1];
    return from[item] - value;
}

// Replaces each value by the sum of those before it in its chunk.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void scan_chunks(
    const int count, __global long *values, __global long *chunk_totals
) {
    __local long sums[2 * GROUP_SIZE];
    const int first = get_global_id(0) * SCAN_ITEMS;
    long items[SCAN_ITEMS], own = 0, total;
    for (int k = 0; k < SCAN_ITEMS; k++) {
        items[k] = first + k < count ? values[first + k] : 0;
        own += items[k];
    }
    long before = scan_of_group(own, sums, &total);
    for (int k = 0; k < SCAN_ITEMS; k++) {
        if (first + k < count) values[first + k] = before;
        before += items[k];
    }
    if (get_local_id(0) == 0) chunk_totals[get_group_id(0)] = total;
}

// Adds to each value the sum of all chunks before its own.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void add_chunk_starts(
    const int count, __global const long *chunk_starts, __global long *values
) {
    const int first = get_group_id(0) * SCAN_CHUNK;
    for (int i = get_local_id(0); i < SCAN_CHUNK; i += GROUP_SIZE)
        if (first + i < count) values[first + i] += chunk_starts[get_group_id(0)];
}

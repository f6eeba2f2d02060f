// A stable radix sort of keys, each with a payload, by DIGIT_BITS of the key per pass, lowest bits first.
//
// Work-groups count the digits in their chunks. A scan of the counts, ordered by digit and then by chunk, yields where
// each chunk's items of each digit go. Work-groups then sort their chunks in local memory, so that neighbouring items
// are written to neighbouring addresses. No atomics: the result is the same on every run.

#define DIGIT_BITS 4
#define DIGITS (1 << DIGIT_BITS)
#define SORT_ITEMS (SORT_CHUNK / GROUP_SIZE)

// Items per digit and work-item, [DIGITS][GROUP_SIZE]. For the scan, each work-item reads DIGITS consecutive counts;
// two unused places after every DIGITS counts avoid bank conflicts in local memory.
#define PLACE_OF_COUNT(i) ((i) + (i) / DIGITS * 2)
#define COUNTS (GROUP_SIZE * (DIGITS + 2))

static inline int digit_of(DEPTH_KEY key, int shift) { return (int)(key >> shift) & (DIGITS - 1); }

// Reads this work-item's keys, SORT_ITEMS consecutive ones from `first` on, and counts their digits. `ranks` receives,
// for each key, how many of them before it have the same digit.
static inline void count_own_digits(
    int first, int count, int shift, __global const DEPTH_KEY *keys, __local ushort *counts, DEPTH_KEY *own, int *ranks
) {
    const int item = get_local_id(0);
    for (int digit = 0; digit < DIGITS; digit++) counts[PLACE_OF_COUNT(digit * GROUP_SIZE + item)] = 0;
    for (int k = 0; k < SORT_ITEMS; k++) {
        if (first + k >= count) continue;
        own[k] = keys[first + k];
        ranks[k] = counts[PLACE_OF_COUNT(digit_of(own[k], shift) * GROUP_SIZE + item)]++;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}

__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void count_digits(
    const int count, const int shift, __global const DEPTH_KEY *keys, __global long *digit_counts
) {
    __local ushort counts[COUNTS];
    __local int parts[GROUP_SIZE];
    const int item = get_local_id(0);
    DEPTH_KEY own[SORT_ITEMS];
    int ranks[SORT_ITEMS], part = 0;
    count_own_digits(get_global_id(0) * SORT_ITEMS, count, shift, keys, counts, own, ranks);
    for (int k = 0; k < DIGITS; k++) part += counts[PLACE_OF_COUNT(item * DIGITS + k)];
    parts[item] = part;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item >= DIGITS) return;
    long total = 0;
    for (int k = 0; k < GROUP_SIZE / DIGITS; k++) total += parts[item * (GROUP_SIZE / DIGITS) + k];
    digit_counts[(size_t)item * get_num_groups(0) + get_group_id(0)] = total;
}

// A work-group's local memory: first the counts, then the sorted chunk.
typedef union {
    ushort counts[COUNTS];
    struct {
        DEPTH_KEY keys[SORT_CHUNK];
        int payloads[SORT_CHUNK];
    } sorted;
} SortSpace;

// Moves items to their places for this pass's digit. `digit_starts` is the exclusive scan of count_digits' counts.
__kernel __attribute__((reqd_work_group_size(GROUP_SIZE, 1, 1))) void move_by_digit(
    const int count,
    const int shift,
    __global const DEPTH_KEY *keys,
    __global const int *payloads,
    __global const long *digit_starts,
    __global DEPTH_KEY *moved_keys,
    __global int *moved_payloads
) {
    __local SortSpace space;
    __local long sums[2 * GROUP_SIZE];
    __local int moves[DIGITS];  // per digit, offset from an item's place in the sorted chunk to its place in the output
    const int item = get_local_id(0), chunk = get_group_id(0) * SORT_CHUNK, first = chunk + item * SORT_ITEMS;
    DEPTH_KEY own[SORT_ITEMS];
    int ranks[SORT_ITEMS];
    count_own_digits(first, count, shift, keys, space.counts, own, ranks);

    int before = 0;
    for (int k = 0; k < DIGITS; k++) before += space.counts[PLACE_OF_COUNT(item * DIGITS + k)];
    long total;
    before = scan_of_group(before, sums, &total);
    for (int k = 0; k < DIGITS; k++) {
        const int place = PLACE_OF_COUNT(item * DIGITS + k), here = space.counts[place];
        space.counts[place] = before;
        before += here;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < DIGITS)
        moves[item] = (int)digit_starts[(size_t)item * get_num_groups(0) + get_group_id(0)]
            - space.counts[PLACE_OF_COUNT(item * GROUP_SIZE)];
    for (int k = 0; k < SORT_ITEMS; k++)
        if (first + k < count) ranks[k] += space.counts[PLACE_OF_COUNT(digit_of(own[k], shift) * GROUP_SIZE + item)];
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int k = 0; k < SORT_ITEMS; k++) {
        if (first + k >= count) continue;
        space.sorted.keys[ranks[k]] = own[k];
        space.sorted.payloads[ranks[k]] = payloads[first + k];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const int here = count - chunk < SORT_CHUNK ? count - chunk : SORT_CHUNK;
    for (int i = item; i < here; i += GROUP_SIZE) {
        const DEPTH_KEY key = space.sorted.keys[i];
        const int to = i + moves[digit_of(key, shift)];
        moved_keys[to] = key;
        moved_payloads[to] = space.sorted.payloads[i];
    }
}

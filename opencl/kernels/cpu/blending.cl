// Front-to-back alpha blending, one work-item a tile, for processors that run one work-item a core.
//
// The 16 pixels of a tile's row are the lanes. Nothing in a row depends on how many of them a Gaussian reaches:
// a branch on that would be mispredicted at nearly every row and cost more than the arithmetic that it saves.

// The part of the picture that a tile covers.
typedef struct {
    int left, top, columns, rows;
} Tile;

inline Tile tile_of(int index, int width, int height) {
    const int across = (width + TILE - 1) / TILE;
    Tile tile;
    tile.left = index % across * TILE;
    tile.top = index / across * TILE;
    tile.columns = width - tile.left < TILE ? width - tile.left : TILE;
    tile.rows = height - tile.top < TILE ? height - tile.top : TILE;
    return tile;
}

inline LANES lane_numbers() {
    return (LANES)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
}

// A Gaussian as the tile sees it, and the rows that it may reach.
typedef struct {
    REAL x, y, slope, across, down, opacity;
    int first_row, last_row;
} Splat;

inline Splat splat_of(__global const REAL *record, Tile tile) {
    Splat s;
    s.x = record[0] - tile.left;
    s.y = record[1] - tile.top;
    s.slope = record[2];
    s.across = record[3] * R(-0.72134752044448170368);  // -1/2 log2(e): exponents are of 2
    s.down = record[4] * R(-0.72134752044448170368);
    s.opacity = record[5];
    const REAL half_height = sqrt((record[6] + REACH_SLACK) / record[4]);
    const REAL low = s.y - half_height + R(0.49), high = s.y + half_height - R(0.49);
    s.first_row = low < 0 ? 0 : low > TILE ? TILE : (int)low;
    s.last_row = high < 0 ? -1 : high > tile.rows - 1 ? tile.rows - 1 : (int)high;
    return s;
}

// One row of a Gaussian: the pixels' distances from its centre, down and along the row from its middle there, and
// alpha before the clamp.
typedef struct {
    REAL down;
    LANES across, alpha;
} SplatRow;

// `middle` is the row's number and a half. It is counted in REAL: converting the integer in every row makes LLVM 14 wait
// for the row before (the conversion keeps the rest of its register, which that row writes).
inline SplatRow splat_row_of(const Splat s, REAL middle) {
    SplatRow r;
    r.down = middle - s.y;
    r.across = lane_numbers() + (R(0.5) - s.x - s.slope * r.down);
    r.alpha = exp2_of_lanes(r.across * r.across * s.across + s.down * r.down * r.down) * s.opacity;
    return r;
}

// Transmittance of the pixels. Negative once a pixel is finished: its size is then what was left.
inline LANES fresh_transmittance(int columns) {
    return lane_numbers() < (LANES)(columns) ? (LANES)(R(1)) : (LANES)(R(-1));
}

// Blends a row's alphas (clamped) into its transmittance and returns their weights, 0 where nothing is drawn.
inline LANES weights_of(LANES alpha, LANES *transmittance) {
    const LANES before = *transmittance;
    const LANES weight = alpha * before;
    const LANES after = before - weight;
    const LANES_MASK seen = alpha >= ALPHA_MINIMUM;
    const LANES_MASK drawn = seen & (after >= TRANSMITTANCE_MINIMUM);
    const LANES finished = before < R(0) ? before : -before;
    *transmittance = drawn ? after : (seen ? finished : before);
    return drawn ? weight : (LANES)(R(0));
}

// Rows of the tile that still have an unfinished pixel, a bit each.
inline int open_rows_of(const LANES *transmittance, int rows) {
    int open = 0;
    for (int row = 0; row < rows; row++) open |= any_lane(transmittance[row] > R(0)) << row;
    return open;
}

// Asks for the Gaussian that is drawn FETCH_AHEAD after this entry.
inline void fetch_ahead(
    __global const REAL *records, __global const REAL *features, __global const int *entries, int entry, int end
) {
    const int gaussian = entries[entry + FETCH_AHEAD < end ? entry + FETCH_AHEAD : entry];
    FETCH(records + (size_t)RECORD * gaussian);
    FETCH(features + (size_t)FEATURE_DIM * gaussian);
}

// How often finished rows are looked for, in Gaussians.
#define LOOK_AGAIN 16

__kernel void blend(
    const int width,
    const int height,
    __global const REAL *records,
    __global const REAL *features,
    __global const REAL *background,
    __global const int *tile_starts,
    __global const int *entries,
    __global REAL *feature_map,
    __global REAL *alphas,
    __global int *walked
) {
    const int index = get_global_id(0);
    const Tile tile = tile_of(index, width, height);
    LANES transmittance[TILE], blended[TILE * FEATURE_DIM];
    for (int row = 0; row < TILE; row++) transmittance[row] = fresh_transmittance(tile.columns);
    for (int k = 0; k < TILE * FEATURE_DIM; k++) blended[k] = (LANES)(R(0));

    int open_rows = (1 << tile.rows) - 1, entry = tile_starts[index];
    const int end = tile_starts[index + 1];
    for (; entry < end && open_rows; entry++) {
        fetch_ahead(records, features, entries, entry, end);
        const int gaussian = entries[entry];
        const Splat splat = splat_of(records + (size_t)RECORD * gaussian, tile);
        __global const REAL *feature = features + (size_t)FEATURE_DIM * gaussian;
        REAL middle = splat.first_row + R(0.5);
        for (int row = splat.first_row; row <= splat.last_row; row++, middle += 1) {
            if (!(open_rows >> row & 1)) continue;
            const LANES alpha = splat_row_of(splat, middle).alpha;
            const LANES weights = weights_of(alpha > ALPHA_MAXIMUM ? (LANES)(ALPHA_MAXIMUM) : alpha, transmittance + row);
            for (int k = 0; k < FEATURE_DIM; k++) blended[row * FEATURE_DIM + k] += weights * feature[k];
        }
        if ((entry & (LOOK_AGAIN - 1)) == LOOK_AGAIN - 1) open_rows = open_rows_of(transmittance, tile.rows);
    }
    walked[index] = entry - tile_starts[index];

    for (int row = 0; row < tile.rows; row++) {
        const LANES left = transmittance[row] < R(0) ? -transmittance[row] : transmittance[row];
        const REAL *left_values = (const REAL *)&left, *values = (const REAL *)(blended + row * FEATURE_DIM);
        const size_t at = (size_t)(tile.top + row) * width + tile.left;
        for (int column = 0; column < tile.columns; column++) {
            alphas[at + column] = 1 - left_values[column];
            for (int k = 0; k < FEATURE_DIM; k++)
                feature_map[(at + column) * FEATURE_DIM + k] = values[k * TILE + column]
                    + left_values[column] * background[k];
        }
    }
}

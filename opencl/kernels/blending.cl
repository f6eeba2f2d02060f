// Front-to-back alpha blending, one work-item a tile, for processors that run one work-item a core.
//
// Pixels of a tile's row are the lanes where alpha is computed; channels are the lanes where features are added up, so
// that only pixels which a Gaussian reaches cost anything and the picture needs no transposition.

#define PIXELS (TILE * TILE)

#if FEATURE_DIM <= 4
#define CHANNELS 4
typedef REAL4 CHANNEL_LANES;
#elif FEATURE_DIM <= 8
#define CHANNELS 8
typedef REAL8 CHANNEL_LANES;
#else
#define CHANNELS 16
typedef LANES CHANNEL_LANES;
#endif
#define CHUNKS ((FEATURE_DIM + CHANNELS - 1) / CHANNELS)
#define PADDED_DIM (CHUNKS * CHANNELS)

typedef union {
    CHANNEL_LANES lanes[CHUNKS];
    REAL values[PADDED_DIM];
} Channels;

typedef union {
    LANES lanes;
    REAL values[TILE];
} Row;

inline Channels channels_of(__global const REAL *values) {
    Channels channels;
    for (int k = FEATURE_DIM; k < PADDED_DIM; k++) channels.values[k] = 0;
    for (int k = 0; k < FEATURE_DIM; k++) channels.values[k] = values[k];
    return channels;
}

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
    REAL x, y, slope, across, down, opacity, reach, variance_across;
    int first_row, last_row;
} Splat;

inline Splat splat_of(__global const REAL *record, Tile tile) {
    Splat s;
    s.x = record[0] - tile.left;
    s.y = record[1] - tile.top;
    s.slope = record[2];
    s.across = record[3];
    s.down = record[4];
    s.opacity = record[5];
    s.reach = record[6] + REACH_SLACK;
    s.variance_across = 1 / s.across;
    const REAL half_height = sqrt(s.reach / s.down);
    const REAL low = s.y - half_height + R(0.49), high = s.y + half_height - R(0.49);
    s.first_row = low < 0 ? 0 : low > TILE ? TILE : (int)low;
    s.last_row = high < 0 ? -1 : high > tile.rows - 1 ? tile.rows - 1 : (int)high;
    return s;
}

// One row of a Gaussian: which pixels it may reach, their distance from its middle there, and alpha before the clamp.
typedef struct {
    REAL dy;
    LANES across, alpha;
    int first, last;
} SplatRow;

inline SplatRow splat_row_of(const Splat s, int row, int columns) {
    SplatRow r;
    r.dy = row + R(0.5) - s.y;
    const REAL middle = s.x + s.slope * r.dy;
    const REAL fallen = s.down * r.dy * r.dy;
    const REAL left = s.reach - fallen;
    const REAL half_width = sqrt(s.variance_across * (left > 0 ? left : 0));
    const REAL low = middle - half_width + R(0.49), high = middle + half_width - R(0.49);
    r.first = low < 0 ? 0 : low > TILE ? TILE : (int)low;
    r.last = high < 0 ? -1 : high > columns - 1 ? columns - 1 : (int)high;
    r.across = lane_numbers() + (R(0.5) - middle);
    const LANES power = (r.across * r.across * s.across + fallen) * R(-0.5);
    r.alpha = exp_of_lanes(power) * s.opacity;
    return r;
}

// Transmittance of the pixels. Negative once a pixel is finished: its size is then what was left.
inline LANES fresh_transmittance(int columns) {
    Row row;
    for (int column = 0; column < TILE; column++) row.values[column] = column < columns ? 1 : -1;
    return row.lanes;
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
    LANES transmittance[TILE];
    CHANNEL_LANES blended[PIXELS * CHUNKS];
    for (int row = 0; row < TILE; row++) transmittance[row] = fresh_transmittance(tile.columns);
    for (int k = 0; k < PIXELS * CHUNKS; k++) blended[k] = (CHANNEL_LANES)(R(0));

    int open_rows = (1 << tile.rows) - 1, entry = tile_starts[index];
    const int end = tile_starts[index + 1];
    for (; entry < end && open_rows; entry++) {
        const int gaussian = entries[entry];
        const Splat splat = splat_of(records + (size_t)RECORD * gaussian, tile);
        const Channels feature = channels_of(features + (size_t)FEATURE_DIM * gaussian);
        for (int row = splat.first_row; row <= splat.last_row; row++) {
            if (!(open_rows >> row & 1)) continue;
            const SplatRow r = splat_row_of(splat, row, tile.columns);
            Row weights;
            weights.lanes = weights_of(r.alpha > ALPHA_MAXIMUM ? (LANES)(ALPHA_MAXIMUM) : r.alpha, transmittance + row);
            for (int column = r.first; column <= r.last; column++)
                for (int chunk = 0; chunk < CHUNKS; chunk++)
                    blended[(row * TILE + column) * CHUNKS + chunk] += feature.lanes[chunk] * weights.values[column];
        }
        if ((entry & (LOOK_AGAIN - 1)) == LOOK_AGAIN - 1) open_rows = open_rows_of(transmittance, tile.rows);
    }
    walked[index] = entry - tile_starts[index];

    const Channels behind = channels_of(background);
    for (int row = 0; row < tile.rows; row++) {
        Row left;
        left.lanes = transmittance[row] < R(0) ? -transmittance[row] : transmittance[row];
        const size_t at = (size_t)(tile.top + row) * width + tile.left;
        for (int column = 0; column < tile.columns; column++) {
            Channels pixel;
            for (int chunk = 0; chunk < CHUNKS; chunk++)
                pixel.lanes[chunk] = blended[(row * TILE + column) * CHUNKS + chunk]
                    + behind.lanes[chunk] * left.values[column];
            for (int k = 0; k < FEATURE_DIM; k++) feature_map[(at + column) * FEATURE_DIM + k] = pixel.values[k];
            alphas[at + column] = 1 - left.values[column];
        }
    }
}

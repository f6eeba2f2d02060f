// Divides a tile of 16 x 16 pixels into 16 blocks of 4 x 4, one pixel per lane, and its Gaussians into chunks.
//
// Most Gaussians reach only a few blocks of a tile. One vector test per Gaussian finds these blocks; each block then
// walks only the Gaussians of the chunk that reach it, with its sums in registers. Coordinates are relative to the
// tile's centre.

#define SIDE 4
#define BLOCKS 16
#define CHUNK 64

static inline LANES lane_columns() { return (LANES)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3); }
static inline LANES lane_rows() { return (LANES)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3); }

// The pixels of a block: column and row of the first within the tile, and the centres of all.
typedef struct {
    int column, row;
    LANES x, y;
} Block;

static inline Block block_of(int index) {
    Block block;
    block.column = index % SIDE * SIDE;
    block.row = index / SIDE * SIDE;
    block.x = lane_columns() + (block.column + R(0.5) - R(0.5) * TILE);
    block.y = lane_rows() + (block.row + R(0.5) - R(0.5) * TILE);
    return block;
}

// Whether a block's pixel lies inside the picture, and its index there.
static inline int in_picture(Tile tile, Block block, int lane) {
    return block.column + lane % SIDE < tile.columns && block.row + lane / SIDE < tile.rows;
}

static inline size_t pixel_of(Tile tile, Block block, int lane, int width) {
    return (size_t)(tile.top + block.row + lane / SIDE) * width + tile.left + block.column + lane % SIDE;
}

// 1 inside the picture, 0 beyond its border.
static inline LANES fresh_transmittance(Tile tile, Block block) {
    const LANES columns = lane_columns() + block.column, rows = lane_rows() + block.row;
    return columns < (LANES)(tile.columns) & rows < (LANES)(tile.rows) ? (LANES)(R(1)) : (LANES)(R(0));
}

// What a tile needs of a Gaussian to compute its alpha, with the precisions scaled for exponents of base 2.
typedef struct {
    REAL x, y, slope, across, down, opacity;
    int gaussian;
} Splat;

// A chunk of the tile's Gaussians. In `reaching`, bit i of a block is set if Gaussian i may reach it.
typedef struct {
    Splat splats[CHUNK];
    ulong reaching[BLOCKS];
} Chunk;

// Prefetches the Gaussian that is FETCH_AHEAD entries ahead.
static inline void fetch_ahead(
    __global const REAL *records, __global const REAL *features, __global const int *entries, int entry, int end
) {
    const int gaussian = entries[entry + FETCH_AHEAD < end ? entry + FETCH_AHEAD : entry];
    FETCH(records + (size_t)RECORD * gaussian);
    for (int k = 0; k < FEATURE_DIM; k += 16) FETCH(features + (size_t)FEATURE_DIM * gaussian + k);
}

// Tests all blocks at once, one per lane: whether the ellipse of alpha >= ALPHA_MINIMUM, plus some slack, reaches the
// rectangle spanned by the block's pixel centres. The point of a rectangle with the least squared Mahalanobis distance
// lies on the vertical or the horizontal side that faces the Gaussian's centre. Along a side the distance is a
// parabola: its minimum, clamped to the side.
WHOLE_REGISTERS static inline LANES_MASK reaching_blocks(__global const REAL *record, REAL x, REAL y) {
    const REAL slope = record[2], across = record[3], down = record[4];
    const REAL lean = across * slope / (across * slope * slope + down);  // y of the least distance, per unit of x
    const LANES left = lane_columns() * SIDE + (R(0.5) - R(0.5) * TILE - x), right = left + (SIDE - 1);
    const LANES top = lane_rows() * SIDE + (R(0.5) - R(0.5) * TILE - y), bottom = top + (SIDE - 1);
    const LANES zero = (LANES)(R(0));
    const LANES side = left > zero ? left : right < zero ? right : zero;
    const LANES edge = top > zero ? top : bottom < zero ? bottom : zero;
    LANES along_side = lean * side, along_edge = slope * edge;
    along_side = along_side < top ? top : along_side > bottom ? bottom : along_side;
    along_edge = along_edge < left ? left : along_edge > right ? right : along_edge;
    const LANES off_side = side - slope * along_side, off_edge = along_edge - slope * edge;
    const LANES on_side = across * off_side * off_side + down * along_side * along_side;
    const LANES on_edge = across * off_edge * off_edge + down * edge * edge;
    // Rounding adds an error relative to the distance, and one equal to the effect of moving the centre by an ulp.
    const REAL reach = record[6] * R(1.001) + REACH_SLACK;
    return (on_side < on_edge ? on_side : on_edge) <= (LANES)(reach);
}

// Reads `count` entries, at most CHUNK, and finds the blocks that they reach.
WHOLE_REGISTERS static inline void read_chunk(
    Chunk *chunk,
    Tile tile,
    __global const REAL *records,
    __global const REAL *features,
    __global const int *entries,
    int entry,
    int count,
    int end
) {
    LANES_MASK low = (LANES_MASK)(0), high = (LANES_MASK)(0);
    for (int i = 0; i < count; i++) {
        fetch_ahead(records, features, entries, entry + i, end);
        const int gaussian = entries[entry + i];
        __global const REAL *record = records + (size_t)RECORD * gaussian;
        Splat s;
        s.x = record[0] - (tile.left + TILE / 2);
        s.y = record[1] - (tile.top + TILE / 2);
        s.slope = record[2];
        s.across = record[3] * R(-0.72134752044448170368);  // -1/2 log2(e)
        s.down = record[4] * R(-0.72134752044448170368);
        s.opacity = record[5];
        s.gaussian = gaussian;
        chunk->splats[i] = s;
        const LANES_MASK reached = reaching_blocks(record, s.x, s.y);
        if (i < CHUNK / 2)
            low |= reached & (LANES_MASK)(1 << i);
        else
            high |= reached & (LANES_MASK)(1 << (i - CHUNK / 2));
    }
    const LANES_INDEX *lows = (const LANES_INDEX *)&low, *highs = (const LANES_INDEX *)&high;
    for (int block = 0; block < BLOCKS; block++)
        chunk->reaching[block] = (ulong)(uint)lows[block] | (ulong)(uint)highs[block] << (CHUNK / 2);
}

// For a block's pixels: the distance `down` from a Gaussian's centre, the distance `across` from its midpoint in the
// pixel's row, and alpha before the clamp.
typedef struct {
    LANES across, down, alpha;
} Spread;

static inline Spread spread_of(const Splat *s, Block block) {
    Spread r;
    r.down = block.y - s->y;
    r.across = block.x - s->x - s->slope * r.down;
    r.alpha = exp2_of_lanes(r.across * r.across * s->across + r.down * r.down * s->down) * s->opacity;
    return r;
}

// Transmittance of a block's pixels: `product` includes every Gaussian so far, `counted` only those that are drawn. A
// pixel is finished once `product` falls below the minimum; it never rises again, so no separate flag is needed.
typedef struct {
    LANES product, counted;
} Transmittance;

// Blends one Gaussian's clamped alphas and returns its weights, 0 where it is not drawn.
static inline LANES weights_of(LANES alpha, Transmittance *transmittance) {
    const LANES zero = (LANES)(R(0));
    const LANES weight = (alpha >= ALPHA_MINIMUM ? alpha : zero) * transmittance->product;
    transmittance->product -= weight;
    const LANES_MASK drawn = transmittance->product >= TRANSMITTANCE_MINIMUM;
    transmittance->counted = drawn ? transmittance->product : transmittance->counted;
    return drawn ? weight : zero;
}

static inline int all_finished(Transmittance transmittance) {
    return !any_lane(transmittance.product >= TRANSMITTANCE_MINIMUM);
}

// A tile of 16 x 16 pixels as 16 blocks of 4 x 4, whose pixels are the lanes; the tile's Gaussians are taken in chunks.
//
// Most Gaussians reach a few blocks of a tile only. Which ones is found for all blocks at once; each block then walks
// those of the chunk that reach it, with what it sums in registers. Coordinates are counted from the tile's centre.

#define SIDE 4
#define BLOCKS 16
#define CHUNK 64

static inline LANES lane_columns() { return (LANES)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3); }
static inline LANES lane_rows() { return (LANES)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3); }

// The pixels of a block: its first one's column and row within the tile, and all centres.
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

// A pixel of a block: whether it is in the picture, and where.
static inline int in_picture(Tile tile, Block block, int lane) {
    return block.column + lane % SIDE < tile.columns && block.row + lane / SIDE < tile.rows;
}

static inline size_t pixel_of(Tile tile, Block block, int lane, int width) {
    return (size_t)(tile.top + block.row + lane / SIDE) * width + tile.left + block.column + lane % SIDE;
}

// 1 in the picture, 0 beyond its border.
static inline LANES fresh_transmittance(Tile tile, Block block) {
    const LANES columns = lane_columns() + block.column, rows = lane_rows() + block.row;
    return columns < (LANES)(tile.columns) & rows < (LANES)(tile.rows) ? (LANES)(R(1)) : (LANES)(R(0));
}

// A Gaussian as the tile sees it: what alpha is computed from. Exponents are of 2.
typedef struct {
    REAL x, y, slope, across, down, opacity;
    int gaussian;
} Splat;

// A chunk of the tile's Gaussians, and for each block a bit for each of them that may reach it.
typedef struct {
    Splat splats[CHUNK];
    ulong reaching[BLOCKS];
} Chunk;

// Asks for the Gaussian that is drawn FETCH_AHEAD after this entry.
static inline void fetch_ahead(
    __global const REAL *records, __global const REAL *features, __global const int *entries, int entry, int end
) {
    const int gaussian = entries[entry + FETCH_AHEAD < end ? entry + FETCH_AHEAD : entry];
    FETCH(records + (size_t)RECORD * gaussian);
    for (int k = 0; k < FEATURE_DIM; k += 16) FETCH(features + (size_t)FEATURE_DIM * gaussian + k);
}

// For all blocks at once, whether the ellipse of alpha >= ALPHA_MINIMUM reaches a pixel's centre, or all but does.
// The least squared Mahalanobis distance in a rectangle lies on the side that faces the centre, left or right, or on
// the one above or below; along each it is a parabola's lowest point, clamped.
WHOLE_REGISTERS static inline LANES_MASK reaching_blocks(__global const REAL *record, REAL x, REAL y) {
    const REAL slope = record[2], across = record[3], down = record[4];
    const REAL lean = across * slope / (across * slope * slope + down);  // y of the lowest point for each x
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
    // Rounding moves the distance by a part of itself, and by what a shift of the centre by an ulp is worth.
    const REAL reach = record[6] * R(1.001) + REACH_SLACK;
    return (on_side < on_edge ? on_side : on_edge) <= (LANES)(reach);
}

// Reads `count` entries, at most CHUNK.
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

// Distances of a block's pixels from a Gaussian's centre, down and along the row from its middle there, and alpha
// before the clamp.
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

// Transmittance of a block's pixels: what the Gaussians so far let through, and what of it counts. A pixel is finished
// once the product falls under the minimum; it never rises again, so that nothing else need be remembered.
typedef struct {
    LANES product, counted;
} Transmittance;

// Blends alphas (clamped) and returns their weights, 0 where nothing is drawn.
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

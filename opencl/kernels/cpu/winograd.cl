// Winograd's minimal filtering F(4 x 4, 3 x 3): a tile of 4 x 4 pixels and the ring of pixels around it are transformed
// into 36 values, one per point. At each point, a 3 x 3 convolution is a matrix product over the channels.
//
// Pictures are stored channels last, one after the other; tiles are numbered consecutively through all pictures. A
// LANES value holds 16 channels. Loops over small arrays are written out, see EACH_1 in lanes.cl.

#define SIDE 4
#define REACH 6
#define POINTS 36
#define EACH_6(step, k) EACH_4(step, k) EACH_2(step, (k) + 4)

// B^T along one direction: transforms six values to the points 0, 1, -1, 2, -2 and infinity.
WHOLE_REGISTERS static inline void at_points(LANES *v) {
    const LANES far = v[4] - 4 * v[2], far_odd = v[3] - 4 * v[1], near = v[4] - v[2], near_odd = 2 * (v[3] - v[1]);
    v[0] = 4 * v[0] - 5 * v[2] + v[4];
    v[5] = 4 * v[1] - 5 * v[3] + v[5];
    v[1] = far + far_odd;
    v[2] = far - far_odd;
    v[3] = near + near_odd;
    v[4] = near - near_odd;
}

// A^T: transforms six values at the points to the four values of a tile.
WHOLE_REGISTERS static inline void of_points(LANES *v) {
    const LANES one = v[1] + v[2], one_odd = v[1] - v[2], two = v[3] + v[4], two_odd = v[3] - v[4];
    v[0] = v[0] + one + two;
    v[1] = one_odd + 2 * two_odd;
    v[2] = one + 4 * two;
    v[3] = one_odd + 8 * two_odd + v[5];
}

// A, the transpose of `of_points`: transforms four values of a gradient to the points.
WHOLE_REGISTERS static inline void gradients_at_points(LANES *v) {
    const LANES one = v[0] + v[2], one_odd = v[1] + v[3], two = v[0] + 4 * v[2], two_odd = 2 * v[1] + 8 * v[3];
    v[5] = v[3];
    v[1] = one + one_odd;
    v[2] = one - one_odd;
    v[3] = two + two_odd;
    v[4] = two - two_odd;
}

// A tile in its picture: the index of its first value, the strides in values to the next pixel `down` and `across`, and
// the pixels from its first to each edge of the picture (`below` and `right` include the first).
typedef struct {
    size_t start;
    int down, across;
    int above, left, below, right;
} Tile;

static inline int tiles_along(int length) { return (length + SIDE - 1) / SIDE; }

static inline Tile tile_at(int number, int height, int width, int channels) {
    const int in_row = tiles_along(width), in_picture = in_row * tiles_along(height);
    Tile tile;
    tile.above = number % in_picture / in_row * SIDE;
    tile.left = number % in_row * SIDE;
    tile.below = height - tile.above;
    tile.right = width - tile.left;
    tile.across = channels;
    tile.down = width * channels;
    tile.start = ((size_t)(number / in_picture) * height + tile.above) * tile.down + tile.left * tile.across;
    return tile;
}

// Whether the picture contains all pixels [first, end) in both directions, counted from the tile's first pixel.
static inline int is_whole(Tile tile, int first, int end) {
    return tile.above >= -first && tile.left >= -first && tile.below >= end && tile.right >= end;
}

// A pixel at y, x from the tile's first: zero beyond the picture's edges and where `shown`, the output of a ReLU, is
// zero (if given). `exists` skips the test of the edges.
WHOLE_REGISTERS static inline LANES pixel(
    __global const REAL *values, __global const REAL *shown, Tile tile, int exists, int y, int x
) {
    if (!exists && (y < -tile.above || y >= tile.below || x < -tile.left || x >= tile.right)) return (LANES)(0);
    const long place = (long)y * tile.down + x * tile.across;
    const LANES value = *(LANES_IN)(values + place);
    if (!shown) return value;
    return *(LANES_IN)(shown + place) <= 0 ? (LANES)(0) : value;
}

#define KEEP_COLUMN(y) columns[REACH * (y) + x] = v[y];
#define READ_ROW(x) v[x] = columns[REACH * y + (x)];
#define KEEP_POINT(x) *(LANES_OUT)(points + (long)(REACH * y + (x)) * step) = v[x];

// Transforms a tile and the ring around it to the points, which are `step` values apart.
WHOLE_REGISTERS static inline void tile_at_points(
    __global const REAL *values, __global const REAL *shown, Tile tile, __global REAL *points, int step
) {
    LANES columns[POINTS];
    const int exists = is_whole(tile, -1, SIDE + 1);
    for (int x = 0; x < REACH; x++) {
        LANES v[REACH];
#define READ(y) v[y] = pixel(values, shown, tile, exists, (y) - 1, x - 1);
        EACH_6(READ, 0)
#undef READ
        at_points(v);
        EACH_6(KEEP_COLUMN, 0)
    }
    for (int y = 0; y < REACH; y++) {
        LANES v[REACH];
        EACH_6(READ_ROW, 0)
        at_points(v);
        EACH_6(KEEP_POINT, 0)
    }
}

// Transforms a tile's gradient to the points. Its value at the eighth, (1, 1), is the sum over the tile.
WHOLE_REGISTERS static inline void tile_gradient_at_points(
    __global const REAL *values, __global const REAL *shown, Tile tile, __global REAL *points, int step
) {
    LANES columns[POINTS];
    const int exists = is_whole(tile, 0, SIDE);
    for (int x = 0; x < SIDE; x++) {
        LANES v[REACH];
#define READ(y) v[y] = pixel(values, shown, tile, exists, y, x);
        EACH_4(READ, 0)
#undef READ
        gradients_at_points(v);
        EACH_6(KEEP_COLUMN, 0)
    }
    for (int y = 0; y < REACH; y++) {
        LANES v[REACH];
        EACH_4(READ_ROW, 0)
        gradients_at_points(v);
        EACH_6(KEEP_POINT, 0)
    }
}

// Transforms values at the points to a tile, adds the bias and, if `rectifies`, applies a ReLU.
WHOLE_REGISTERS static inline void tile_of_points(
    __global const REAL *points, int step, LANES bias, int rectifies, __global REAL *values, Tile tile
) {
    LANES columns[REACH * SIDE];
    for (int y = 0; y < REACH; y++) {
        LANES v[REACH];
#define READ_POINT(x) v[x] = *(LANES_IN)(points + (long)(REACH * y + (x)) * step);
        EACH_6(READ_POINT, 0)
        of_points(v);
#define KEEP_ROW(x) columns[SIDE * y + (x)] = v[x];
        EACH_4(KEEP_ROW, 0)
    }
    for (int x = 0; x < SIDE && x < tile.right; x++) {
        LANES v[REACH];
#define READ_COLUMN(y) v[y] = columns[SIDE * (y) + x];
        EACH_6(READ_COLUMN, 0)
        of_points(v);
        for (int y = 0; y < SIDE && y < tile.below; y++) {
            const LANES value = v[y] + bias;
            *(LANES_OUT)(values + (long)y * tile.down + x * tile.across) = rectifies && value < 0 ? (LANES)(0) : value;
        }
    }
}

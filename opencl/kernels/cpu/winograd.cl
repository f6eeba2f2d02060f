// Winograd's minimal filtering F(4 x 4, 3 x 3): a tile of 4 x 4 pixels and what surrounds it become 36 values, its
// values at 36 points, for each of which a convolution 3 x 3 is a product of matrices over the channels.
//
// Pictures are channels last, one after the other; tiles are numbered through all of them. A LANES value holds 16
// channels. Vectors are written out: what an array holds stays in registers only where each index is a constant.

#define SIDE 4
#define REACH 6
#define POINTS 36
#define EACH_6(step, k) EACH_4(step, k) EACH_2(step, (k) + 4)

// B^T along one direction: what six values are at the points 0, 1, -1, 2, -2 and infinity.
WHOLE_REGISTERS static inline void at_points(LANES *v) {
    const LANES far = v[4] - 4 * v[2], far_odd = v[3] - 4 * v[1], near = v[4] - v[2], near_odd = 2 * (v[3] - v[1]);
    v[0] = 4 * v[0] - 5 * v[2] + v[4];
    v[5] = 4 * v[1] - 5 * v[3] + v[5];
    v[1] = far + far_odd;
    v[2] = far - far_odd;
    v[3] = near + near_odd;
    v[4] = near - near_odd;
}

// A^T: the four values of a tile, of six at the points.
WHOLE_REGISTERS static inline void of_points(LANES *v) {
    const LANES one = v[1] + v[2], one_odd = v[1] - v[2], two = v[3] + v[4], two_odd = v[3] - v[4];
    v[0] = v[0] + one + two;
    v[1] = one_odd + 2 * two_odd;
    v[2] = one + 4 * two;
    v[3] = one_odd + 8 * two_odd + v[5];
}

// A: `of_points` transposed, four values of a gradient at the points.
WHOLE_REGISTERS static inline void gradients_at_points(LANES *v) {
    const LANES one = v[0] + v[2], one_odd = v[1] + v[3], two = v[0] + 4 * v[2], two_odd = 2 * v[1] + 8 * v[3];
    v[5] = v[3];
    v[1] = one + one_odd;
    v[2] = one - one_odd;
    v[3] = two + two_odd;
    v[4] = two - two_odd;
}

// A tile in its picture: where its values begin, how many of them there are from one pixel to the next below and beside
// it, and how many pixels there are from its first to the picture's edges.
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

// Whether all pixels from `first` up to `end` of it exist in both directions.
static inline int is_whole(Tile tile, int first, int end) {
    return tile.above >= -first && tile.left >= -first && tile.below >= end && tile.right >= end;
}

// A pixel: zero beyond the picture's edges, and where the rectified picture `shown`, if there is one, is zero.
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

// A tile and what surrounds it at the points, which lie `step` values apart.
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

// A tile's gradient at the points; at the eighth it is its sum.
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

// The tile, of its values at the points; where `rectifies`, nothing below zero.
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

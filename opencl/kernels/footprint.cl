// Finds the tiles that a Gaussian reaches.
//
// One kernel counts these tiles and another lists them, so both must round identically. Contraction into fma is
// therefore off: a compiler might contract in one kernel and not in the other. (NVIDIA's assembler may contract anyway,
// unless the PTX names a rounding mode: see ptx.py.)

// The ellipse where alpha >= ALPHA_MINIMUM, enlarged by a slack for rounding errors.
typedef struct {
    REAL x, y, slope, down, reach, variance_across, half_height;
    REAL extreme;  // how far the rightmost point lies below the centre; the leftmost lies as far above it
    int first_row, last_row;  // of tiles; first > last if there are none
} Ellipse;

static inline Ellipse ellipse_of(__global const REAL *record, int height) {
    #pragma OPENCL FP_CONTRACT OFF
    Ellipse e;
    e.x = record[0];
    e.y = record[1];
    e.slope = record[2];
    e.down = record[4];
    e.reach = record[6] + REACH_SLACK;
    e.variance_across = 1 / record[3];
    const REAL variance_y = 1 / record[4];
    e.half_height = sqrt(e.reach * variance_y);
    e.extreme = e.slope * variance_y * sqrt(e.reach / (e.variance_across + e.slope * e.slope * variance_y));
    REAL low = e.y - e.half_height - R(0.51), high = e.y + e.half_height - R(0.49);
    low = low < 0 ? 0 : low;
    high = high > height - 1 ? height - 1 : high;
    e.first_row = low > high ? 1 : (int)low / TILE;
    e.last_row = low > high ? 0 : (int)high / TILE;
    return e;
}

// The columns of tiles that an ellipse reaches in one row of tiles; first > last if there are none.
static inline void columns_of(const Ellipse e, int row, int width, int *first, int *last) {
    #pragma OPENCL FP_CONTRACT OFF
    REAL top = row * TILE - e.y, bottom = top + TILE;
    top = top < -e.half_height ? -e.half_height : top;
    bottom = bottom > e.half_height ? e.half_height : bottom;
    *first = 1;
    *last = 0;
    if (top > bottom) return;
    // y of the ellipse's rightmost point, clamped to the row of tiles; its leftmost point is the mirror image.
    const REAL right = e.extreme < top ? top : e.extreme > bottom ? bottom : e.extreme;
    const REAL left = -e.extreme < top ? top : -e.extreme > bottom ? bottom : -e.extreme;
    const REAL over_right = e.reach - right * right * e.down, over_left = e.reach - left * left * e.down;
    const REAL half_right = sqrt(e.variance_across * (over_right > 0 ? over_right : 0));
    const REAL half_left = sqrt(e.variance_across * (over_left > 0 ? over_left : 0));
    const REAL slack = R(0.51) + R(1e-5) * (e.half_height * (e.slope < 0 ? -e.slope : e.slope) + half_right);
    REAL low = e.x + e.slope * left - half_left - slack;
    REAL high = e.x + e.slope * right + half_right + slack - 1;
    low = low < 0 ? 0 : low;
    high = high > width - 1 ? width - 1 : high;
    if (low > high) return;
    *first = (int)low / TILE;
    *last = (int)high / TILE;
}

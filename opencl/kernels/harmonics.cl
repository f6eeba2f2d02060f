// Colours of Gaussians from spherical harmonics in the direction from the camera, and their gradients.
//
// Constants and signs are those of 3D Gaussian Splatting. Each work-item takes PROJECTION_CHUNK consecutive Gaussians
// of `count`. `base` holds the coefficients of the constant harmonic, `rest` those of `others` further harmonics, of
// which the ones up to `degree` are used.

#define HARMONICS 16

#define Y0 R(0.28209479177387814)
#define Y1 R(0.48860251190291992)
#define Y2_CROSS R(1.0925484305920792)
#define Y2_AXIS R(0.31539156525252005)
#define Y2_PLANE R(0.54627421529603959)
#define Y3_OUTER R(0.59004358992664352)
#define Y3_CROSS R(2.8906114426405538)
#define Y3_INNER R(0.45704579946446572)
#define Y3_AXIS R(0.37317633259011546)
#define Y3_PLANE R(1.4453057213202769)

// The least length by which torch.nn.functional.normalize divides.
#define SHORTEST R(1e-12)

typedef struct {
    REAL x, y, z;   // unit vector from the camera to the Gaussian
    REAL inverse;   // 1 / distance
} Direction;

static inline Direction direction_to(__global const REAL *mean, __global const REAL *centre) {
    const REAL x = mean[0] - centre[0], y = mean[1] - centre[1], z = mean[2] - centre[2];
    const REAL distance = sqrt(x * x + y * y + z * z);
    Direction d;
    d.inverse = 1 / (distance > SHORTEST ? distance : SHORTEST);
    d.x = x * d.inverse;
    d.y = y * d.inverse;
    d.z = z * d.inverse;
    return d;
}

// Evaluates the harmonics other than the constant one, from index 1 on. Returns their number, including the constant.
static inline int harmonics_of(Direction d, int degree, REAL value[HARMONICS]) {
    const REAL x = d.x, y = d.y, z = d.z;
    if (degree < 1) return 1;
    value[1] = -Y1 * y;
    value[2] = Y1 * z;
    value[3] = -Y1 * x;
    if (degree < 2) return 4;
    const REAL xx = x * x, yy = y * y, zz = z * z;
    value[4] = Y2_CROSS * x * y;
    value[5] = -Y2_CROSS * y * z;
    value[6] = Y2_AXIS * (2 * zz - xx - yy);
    value[7] = -Y2_CROSS * x * z;
    value[8] = Y2_PLANE * (xx - yy);
    if (degree < 3) return 9;
    value[9] = -Y3_OUTER * y * (3 * xx - yy);
    value[10] = Y3_CROSS * x * y * z;
    value[11] = -Y3_INNER * y * (4 * zz - xx - yy);
    value[12] = Y3_AXIS * z * (2 * zz - 3 * xx - 3 * yy);
    value[13] = -Y3_INNER * x * (4 * zz - xx - yy);
    value[14] = Y3_PLANE * z * (xx - yy);
    value[15] = -Y3_OUTER * x * (xx - 3 * yy);
    return HARMONICS;
}

// The gradient of sum_k weight[k] Y_k with respect to the direction's three components, treated as independent.
static inline void gradient_of_harmonics(Direction d, int degree, const REAL weight[HARMONICS], REAL gradient[3]) {
    const REAL x = d.x, y = d.y, z = d.z;
    gradient[0] = gradient[1] = gradient[2] = 0;
    if (degree < 1) return;
    gradient[0] = -Y1 * weight[3];
    gradient[1] = -Y1 * weight[1];
    gradient[2] = Y1 * weight[2];
    if (degree < 2) return;
    const REAL w4 = Y2_CROSS * weight[4], w5 = -Y2_CROSS * weight[5], w6 = Y2_AXIS * weight[6];
    const REAL w7 = -Y2_CROSS * weight[7], w8 = Y2_PLANE * weight[8];
    gradient[0] += w4 * y + w7 * z + 2 * (w8 - w6) * x;
    gradient[1] += w4 * x + w5 * z - 2 * (w8 + w6) * y;
    gradient[2] += w5 * y + w7 * x + 4 * w6 * z;
    if (degree < 3) return;
    const REAL xx = x * x, yy = y * y, zz = z * z;
    const REAL w9 = -Y3_OUTER * weight[9], w10 = Y3_CROSS * weight[10], w11 = -Y3_INNER * weight[11];
    const REAL w12 = Y3_AXIS * weight[12], w13 = -Y3_INNER * weight[13], w14 = Y3_PLANE * weight[14];
    const REAL w15 = -Y3_OUTER * weight[15];
    gradient[0] += w9 * 6 * x * y + w10 * y * z - w11 * 2 * x * y - w12 * 6 * x * z + w13 * (4 * zz - 3 * xx - yy)
        + w14 * 2 * x * z + w15 * 3 * (xx - yy);
    gradient[1] += w9 * 3 * (xx - yy) + w10 * x * z + w11 * (4 * zz - xx - 3 * yy) - w12 * 6 * y * z - w13 * 2 * x * y
        - w14 * 2 * y * z - w15 * 6 * x * y;
    gradient[2] += w10 * x * y + w11 * 8 * y * z + w12 * 3 * (2 * zz - xx - yy) + w13 * 8 * x * z + w14 * (xx - yy);
}

// Colours before the clamp at zero.
static inline void sum_harmonics(
    __global const REAL *base, __global const REAL *row, const REAL value[HARMONICS], int used, REAL colors[3]
) {
    REAL red = 0, green = 0, blue = 0;
    for (int k = 1; k < used; k++) {
        red += value[k] * row[3 * k - 3];
        green += value[k] * row[3 * k - 2];
        blue += value[k] * row[3 * k - 1];
    }
    colors[0] = red + Y0 * base[0] + R(0.5);
    colors[1] = green + Y0 * base[1] + R(0.5);
    colors[2] = blue + Y0 * base[2] + R(0.5);
}

__kernel void colors_of_harmonics(
    const int count,
    const int others,
    const int degree,
    __global const REAL *base,
    __global const REAL *rest,
    __global const REAL *means,
    __global const REAL *centre,
    __global REAL *colors
) {
    const int first = get_global_id(0) * PROJECTION_CHUNK;
    const int last = first + PROJECTION_CHUNK < count ? first + PROJECTION_CHUNK : count;
    for (int i = first; i < last; i++) {
        __global const REAL *row = rest + (size_t)3 * others * i;
        REAL value[HARMONICS], sums[3];
        const int used = harmonics_of(direction_to(means + (size_t)3 * i, centre), degree, value);
        sum_harmonics(base + (size_t)3 * i, row, value, used, sums);
        for (int c = 0; c < 3; c++) colors[(size_t)3 * i + c] = sums[c] < 0 ? 0 : sums[c];  // NaN stays NaN
    }
}

// How far below zero rounding alone may put a colour. A channel that starts out black lies at zero give or take this
// much; if its gradient were cut off, it could never leave.
#define ROUNDING R(1e-5)

// The gradient `g` that passes through the clamp to a Gaussian's harmonics. Returns 0 if none does.
static inline int gradient_through_colors(const REAL colors[3], __global const REAL *grad_colors, REAL g[3]) {
    for (int c = 0; c < 3; c++) g[c] = colors[c] >= -ROUNDING ? grad_colors[c] : 0;
    return g[0] != 0 || g[1] != 0 || g[2] != 0;
}

// Backward pass of colors_of_harmonics. A colour that was clamped by more than ROUNDING passes no gradient on. For a
// Gaussian without gradient, as one out of view, no coefficient is read and zeros are written.
__kernel void colors_of_harmonics_backward(
    const int count,
    const int others,
    const int degree,
    __global const REAL *base,
    __global const REAL *rest,
    __global const REAL *means,
    __global const REAL *centre,
    __global const REAL *grad_colors,
    __global REAL *grad_base,
    __global REAL *grad_rest,
    __global REAL *grad_means
) {
    const int first = get_global_id(0) * PROJECTION_CHUNK;
    const int last = first + PROJECTION_CHUNK < count ? first + PROJECTION_CHUNK : count;
    for (int i = first; i < last; i++) {
        __global const REAL *row = rest + (size_t)3 * others * i;
        __global REAL *grad_row = grad_rest + (size_t)3 * others * i;
        __global const REAL *grad = grad_colors + (size_t)3 * i;
        for (int c = 0; c < 3; c++) grad_base[(size_t)3 * i + c] = grad_means[(size_t)3 * i + c] = 0;
        const int seen = grad[0] != 0 || grad[1] != 0 || grad[2] != 0;
        const Direction d = direction_to(means + (size_t)3 * i, centre);
        REAL value[HARMONICS], weight[HARMONICS], colors[3], g[3];
        const int used = harmonics_of(d, degree, value);
        if (seen) sum_harmonics(base + (size_t)3 * i, row, value, used, colors);
        if (!seen || !gradient_through_colors(colors, grad, g)) {
            for (int k = 0; k < 3 * others; k++) grad_row[k] = 0;
            continue;
        }
        for (int c = 0; c < 3; c++) grad_base[(size_t)3 * i + c] = Y0 * g[c];
        for (int k = 1; k < used; k++) {
            weight[k] = g[0] * row[3 * k - 3] + g[1] * row[3 * k - 2] + g[2] * row[3 * k - 1];
            for (int c = 0; c < 3; c++) grad_row[3 * k - 3 + c] = value[k] * g[c];
        }
        for (int k = 3 * used - 3; k < 3 * others; k++) grad_row[k] = 0;
        REAL free[3];
        gradient_of_harmonics(d, degree, weight, free);
        const REAL along = free[0] * d.x + free[1] * d.y + free[2] * d.z;
        grad_means[(size_t)3 * i] = (free[0] - along * d.x) * d.inverse;
        grad_means[(size_t)3 * i + 1] = (free[1] - along * d.y) * d.inverse;
        grad_means[(size_t)3 * i + 2] = (free[2] - along * d.z) * d.inverse;
    }
}

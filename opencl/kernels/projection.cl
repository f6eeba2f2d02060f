// Projection of Gaussians from the world to the screen, and its gradients.
//
// camera: 0..8 rotation by rows, 9..11 translation, 12 fx, 13 fy, 14 cx, 15 cy, 16..19 clamp of x/z (low, high) and
// y/z (low, high). A work-item takes PROJECTION_CHUNK consecutive Gaussians, PROJECTED_AT_ONCE at a time: a REALS value
// holds one number of each. They share one control flow without branches: invisible Gaussians are computed, too, and
// masked out at the end.

#if PROJECTED_AT_ONCE == 8
#ifdef REAL_IS_DOUBLE
typedef double8 REALS;
typedef long8 MASKS;
#else
typedef float8 REALS;
typedef int8 MASKS;
#endif
typedef int8 INTS;
#define TO_INTS convert_int8
#define LANE(values, lane) (((const REAL *)&(values))[lane])
#define INT_LANE(values, lane) (((const int *)&(values))[lane])
#else
typedef REAL REALS;
typedef int MASKS;
typedef int INTS;
#define TO_INTS convert_int
#define LANE(values, lane) (values)
#define INT_LANE(values, lane) (values)
#endif

// The Gaussians that are processed together. Lanes beyond the last Gaussian repeat it.
typedef struct {
    int first, count, last;
} Group;

static inline Group group_of(int first, int count) {
    Group group;
    group.first = first;
    group.count = count - first < PROJECTED_AT_ONCE ? count - first : PROJECTED_AT_ONCE;
    group.last = count - 1;
    return group;
}

static inline REALS read_reals(__global const REAL *values, int stride, int offset, Group group) {
#if PROJECTED_AT_ONCE == 8
    const size_t last = (size_t)stride * group.last + offset;
    size_t at[8];
    for (int lane = 0; lane < 8; lane++) {
        const size_t here = (size_t)stride * (group.first + lane) + offset;
        at[lane] = here < last ? here : last;
    }
    return (REALS)(
        values[at[0]], values[at[1]], values[at[2]], values[at[3]],
        values[at[4]], values[at[5]], values[at[6]], values[at[7]]
    );
#else
    return values[(size_t)stride * group.first + offset];
#endif
}

static inline void write_reals(__global REAL *values, int stride, int offset, Group group, REALS written) {
    for (int lane = 0; lane < group.count; lane++)
        values[(size_t)stride * (group.first + lane) + offset] = LANE(written, lane);
}

static inline REALS clamp_reals(REALS x, REAL low, REAL high) {
    return x < low ? (REALS)(low) : x > high ? (REALS)(high) : x;
}

static inline REALS or_zero(MASKS chosen, REALS x) { return chosen ? x : (REALS)(R(0)); }

// A gradient as it is written: 0 where not chosen, and clamped to finite numbers, since that of a quaternion of 1e-45,
// say, would be infinite.
static inline REALS gradient(MASKS chosen, REALS x) {
    return or_zero(chosen, clamp_reals(x, -LARGEST_REAL, LARGEST_REAL));
}

static inline MASKS finite(REALS x) { return x - x == R(0); }

typedef struct {
    REALS x, y, z;              // in the camera's frame
    REALS slant_x, slant_y;     // x/z and y/z, clamped
    MASKS inside_x, inside_y;   // whether x/z and y/z lie inside the clamp
    REALS axes[2][3];           // Jacobian · camera rotation · Gaussian's rotation: axes on the screen before scaling
    REALS turned[3][3];         // camera rotation · Gaussian's rotation
    REALS unit[4];              // normalised quaternion
    REALS length;               // of the quaternion
} Geometry;

static inline void rotation_of(const REALS q[4], REALS m[3][3]) {
    const REALS w = q[0], x = q[1], y = q[2], z = q[3];
    m[0][0] = 1 - 2 * (y * y + z * z);
    m[0][1] = 2 * (x * y - w * z);
    m[0][2] = 2 * (x * z + w * y);
    m[1][0] = 2 * (x * y + w * z);
    m[1][1] = 1 - 2 * (x * x + z * z);
    m[1][2] = 2 * (y * z - w * x);
    m[2][0] = 2 * (x * z - w * y);
    m[2][1] = 2 * (y * z + w * x);
    m[2][2] = 1 - 2 * (x * x + y * y);
}

static inline Geometry geometry_of(const REALS mean[3], const REALS quat[4], __global const REAL *camera) {
    Geometry g;
    g.x = camera[0] * mean[0] + camera[1] * mean[1] + camera[2] * mean[2] + camera[9];
    g.y = camera[3] * mean[0] + camera[4] * mean[1] + camera[5] * mean[2] + camera[10];
    g.z = camera[6] * mean[0] + camera[7] * mean[1] + camera[8] * mean[2] + camera[11];

    // Divide by the largest component first: squares of tiny or huge quaternions would underflow or overflow.
    REALS largest = (REALS)(R(0));
    for (int i = 0; i < 4; i++) {
        const REALS size = quat[i] < R(0) ? -quat[i] : quat[i];
        largest = size > largest ? size : largest;
    }
    REALS squares = (REALS)(R(0));
    for (int i = 0; i < 4; i++) {
        g.unit[i] = quat[i] / largest;
        squares += g.unit[i] * g.unit[i];
    }
    const REALS root = sqrt(squares);
    for (int i = 0; i < 4; i++) g.unit[i] /= root;
    g.length = root * largest;

    REALS rotation[3][3];
    rotation_of(g.unit, rotation);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            g.turned[i][k] = camera[3 * i] * rotation[0][k] + camera[3 * i + 1] * rotation[1][k]
                + camera[3 * i + 2] * rotation[2][k];

    const REALS slant_x = g.x / g.z, slant_y = g.y / g.z;
    g.inside_x = slant_x >= camera[16] & slant_x <= camera[17];
    g.inside_y = slant_y >= camera[18] & slant_y <= camera[19];
    g.slant_x = clamp_reals(slant_x, camera[16], camera[17]);
    g.slant_y = clamp_reals(slant_y, camera[18], camera[19]);
    const REALS across = camera[12] / g.z, down = camera[13] / g.z;
    for (int k = 0; k < 3; k++) {
        g.axes[0][k] = across * (g.turned[0][k] - g.slant_x * g.turned[2][k]);
        g.axes[1][k] = down * (g.turned[1][k] - g.slant_y * g.turned[2][k]);
    }
    return g;
}

static inline Geometry read_geometry(
    __global const REAL *means, __global const REAL *quats, __global const REAL *camera, Group group
) {
    REALS mean[3], quat[4];
    for (int k = 0; k < 3; k++) mean[k] = read_reals(means, 3, k, group);
    for (int k = 0; k < 4; k++) quat[k] = read_reals(quats, 4, k, group);
    return geometry_of(mean, quat, camera);
}

// A Gaussian's ellipse on the screen: its axes, scaled, and the covariance with the low-pass filter.
typedef struct {
    REALS rows[2][3];
    REALS minors[3];    // the rows' cross product
    REALS xx, xy, yy;
    REALS area;         // determinant before the filter: by Cauchy-Binet a sum of squares, so nothing cancels
    REALS determinant;
} Footprint;

static inline Footprint footprint_of(const Geometry *g, const REALS scale[3]) {
    Footprint f;
    f.xx = f.xy = f.yy = (REALS)(R(0));
    for (int k = 0; k < 3; k++) {
        f.rows[0][k] = g->axes[0][k] * scale[k];
        f.rows[1][k] = g->axes[1][k] * scale[k];
        f.xx += f.rows[0][k] * f.rows[0][k];
        f.xy += f.rows[0][k] * f.rows[1][k];
        f.yy += f.rows[1][k] * f.rows[1][k];
    }
    f.minors[0] = f.rows[0][1] * f.rows[1][2] - f.rows[0][2] * f.rows[1][1];
    f.minors[1] = f.rows[0][2] * f.rows[1][0] - f.rows[0][0] * f.rows[1][2];
    f.minors[2] = f.rows[0][0] * f.rows[1][1] - f.rows[0][1] * f.rows[1][0];
    f.area = f.minors[0] * f.minors[0] + f.minors[1] * f.minors[1] + f.minors[2] * f.minors[2];
    f.determinant = f.area + LOW_PASS * (f.xx + f.yy) + LOW_PASS * LOW_PASS;
    f.xx += LOW_PASS;
    f.yy += LOW_PASS;
    return f;
}

// The factor of opacity that keeps the filter from adding light (Yu et al. 2024, Mip-Splatting).
static inline REALS compensation_of(const Footprint *f) {
#ifdef ANTIALIASED
    return sqrt(f->area / f->determinant);
#else
    return (REALS)(R(1));
#endif
}

// Whether all of a Gaussian's features are finite.
static inline int finite_features(__global const REAL *features, int count) {
    REAL sums[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    int k = 0;
    for (; k + 8 <= count; k += 8)
        for (int i = 0; i < 8; i++) sums[i] += features[k + i] * 0;
    for (; k < count; k++) sums[0] += features[k] * 0;
    const REAL sum = sums[0] + sums[1] + sums[2] + sums[3] + sums[4] + sums[5] + sums[6] + sums[7];
    return sum == 0;
}

static inline MASKS all_features_finite(__global const REAL *features, int feature_dim, Group group) {
#if PROJECTED_AT_ONCE == 8
    REALS flags = (REALS)(R(1));
    for (int lane = 0; lane < group.count; lane++)
        ((REAL *)&flags)[lane] = finite_features(features + (size_t)feature_dim * (group.first + lane), feature_dim);
    return flags != R(0);
#else
    return finite_features(features + (size_t)feature_dim * group.first, feature_dim);
#endif
}

// Whether a pixel centre 0.5, 1.5 ... size - 0.5 lies within half_length of centre.
static inline MASKS holds_a_pixel(REALS centre, REALS half_length, int size) {
    REALS first = ceil(centre - half_length - R(0.5)), last = floor(centre + half_length - R(0.5));
    first = first < R(0) ? (REALS)(R(0)) : first;
    last = last > (REALS)(size - R(1)) ? (REALS)(size - R(1)) : last;
    return first <= last;
}

__kernel void project(
    const int count,
    const int feature_dim,
    const int width,
    const int height,
    __global const REAL *means,
    __global const REAL *quats,
    __global const REAL *scales,
    __global const REAL *opacities,
    __global const REAL *features,
    __global const REAL *camera,
    __global REAL *means2d,
    __global REAL *records,
    __global int *radii,
    __global DEPTH_KEY *depth_keys
) {
    const int begin = get_global_id(0) * PROJECTION_CHUNK;
    const int end = begin + PROJECTION_CHUNK < count ? begin + PROJECTION_CHUNK : count;
    for (int first = begin; first < end; first += PROJECTED_AT_ONCE) {
        const Group group = group_of(first, count);
        REALS mean[3], quat[4], scale[3];
        for (int k = 0; k < 3; k++) mean[k] = read_reals(means, 3, k, group);
        for (int k = 0; k < 4; k++) quat[k] = read_reals(quats, 4, k, group);
        for (int k = 0; k < 3; k++) scale[k] = read_reals(scales, 3, k, group);
        const REALS given_opacity = read_reals(opacities, 1, 0, group);
        MASKS sound = all_features_finite(features, feature_dim, group) & finite(given_opacity);
        for (int k = 0; k < 3; k++) sound &= finite(mean[k]) & finite(scale[k]);
        for (int k = 0; k < 4; k++) sound &= finite(quat[k]);
        sound &= quat[0] != R(0) | quat[1] != R(0) | quat[2] != R(0) | quat[3] != R(0);

        const Geometry g = geometry_of(mean, quat, camera);
        const Footprint f = footprint_of(&g, scale);
        const REALS x = camera[12] * g.x / g.z + camera[14], y = camera[13] * g.y / g.z + camera[15];
        const REALS opacity = given_opacity * compensation_of(&f);
        const REALS reach = 2 * (log(opacity) - (REALS)(log(ALPHA_MINIMUM)));  // opacity / minimum could overflow
        const MASKS visible = sound & opacity >= ALPHA_MINIMUM & g.z > NEAR
            & finite(f.determinant + x + y + f.xx * f.xx + f.yy * f.yy)
            & holds_a_pixel(x, sqrt(reach * f.xx), width) & holds_a_pixel(y, sqrt(reach * f.yy), height);

        const REALS half_difference = R(0.5) * (f.xx - f.yy);
        const REALS longest = R(0.5) * (f.xx + f.yy) + sqrt(half_difference * half_difference + f.xy * f.xy);
        const REALS radius = or_zero(visible, ceil(RADIUS_SIGMAS * sqrt(longest)));
        const INTS whole_radius = TO_INTS(radius < R(1 << 30) ? radius : (REALS)(R(1 << 30)));
        const REALS record[RECORD] = {
            or_zero(visible, x),
            or_zero(visible, y),
            or_zero(visible, f.xy / f.yy),
            or_zero(visible, f.yy / f.determinant),
            or_zero(visible, 1 / f.yy),
            or_zero(visible, opacity),
            or_zero(visible, reach),
            or_zero(visible, g.z),
        };
        for (int lane = 0; lane < group.count; lane++) {
            const int i = first + lane;
            for (int k = 0; k < RECORD; k++) records[(size_t)RECORD * i + k] = LANE(record[k], lane);
            means2d[2 * i] = LANE(record[0], lane);
            means2d[2 * i + 1] = LANE(record[1], lane);
            radii[i] = INT_LANE(whole_radius, lane);
            depth_keys[i] = AS_DEPTH_KEY(LANE(record[7], lane));
        }
    }
}

// Backward pass of the footprint: from the gradients of slope, precisions and opacity to those of the rows. Overwrites
// its outputs.
static inline void footprint_backward(
    const Footprint *f, __global const REAL *records, __global const REAL *grad_records, REALS opacity, Group group,
    REALS grad_rows[2][3], REALS *grad_opacity
) {
    const REALS slope = read_reals(records, RECORD, 2, group), across = read_reals(records, RECORD, 3, group);
    const REALS down = read_reals(records, RECORD, 4, group);
    const REALS grad_slope = read_reals(grad_records, RECORD, 2, group);
    const REALS grad_across = read_reals(grad_records, RECORD, 3, group);
    const REALS grad_down = read_reals(grad_records, RECORD, 4, group);
    *grad_opacity = read_reals(grad_records, RECORD, 5, group);

    // slope = xy / yy, across = 1 / (xx - xy^2 / yy), down = 1 / yy
    REALS grad_xx = -across * across * grad_across;
    const REALS grad_xy = -2 * slope * grad_xx + down * grad_slope;
    REALS grad_yy = slope * slope * grad_xx - slope * down * grad_slope - down * down * grad_down;
    REALS grad_minors[3];
    for (int k = 0; k < 3; k++) grad_minors[k] = (REALS)(R(0));
#ifdef ANTIALIASED
    // compensation = sqrt(area / determinant); the determinant contains area + LOW_PASS * (xx + yy), before the filter
    const REALS compensation = compensation_of(f);
    const REALS half_grad = R(0.5) * compensation * opacity * *grad_opacity;
    const REALS through_determinant = half_grad / f->determinant;
    grad_xx -= LOW_PASS * through_determinant;
    grad_yy -= LOW_PASS * through_determinant;
    for (int k = 0; k < 3; k++) grad_minors[k] = 2 * (half_grad / f->area - through_determinant) * f->minors[k];
    *grad_opacity *= compensation;
#endif
    for (int k = 0; k < 3; k++) {
        const int next = (k + 1) % 3, last = (k + 2) % 3;
        grad_rows[0][k] = 2 * grad_xx * f->rows[0][k] + grad_xy * f->rows[1][k]
            + f->rows[1][next] * grad_minors[last] - f->rows[1][last] * grad_minors[next];
        grad_rows[1][k] = 2 * grad_yy * f->rows[1][k] + grad_xy * f->rows[0][k]
            + f->rows[0][last] * grad_minors[next] - f->rows[0][next] * grad_minors[last];
    }
}

// Backward pass of the rotation: from d, the gradient of its matrix, through the quaternion's normalisation.
static inline void rotation_backward(const Geometry *g, const REALS d[3][3], REALS grad_quat[4]) {
    const REALS w = g->unit[0], x = g->unit[1], y = g->unit[2], z = g->unit[3];
    REALS grad_unit[4];
    grad_unit[0] = 2 * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
    grad_unit[1] = 2 * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2]))
        - 4 * x * (d[1][1] + d[2][2]);
    grad_unit[2] = 2 * (x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0]))
        - 4 * y * (d[0][0] + d[2][2]);
    grad_unit[3] = 2 * (x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1]))
        - 4 * z * (d[0][0] + d[1][1]);
    REALS along = (REALS)(R(0));
    for (int k = 0; k < 4; k++) along += grad_unit[k] * g->unit[k];
    for (int k = 0; k < 4; k++) grad_quat[k] = (grad_unit[k] - along * g->unit[k]) / g->length;
}

// Backward pass of `project`, step by step in reverse order.
__kernel void project_backward(
    const int count,
    __global const REAL *means,
    __global const REAL *quats,
    __global const REAL *scales,
    __global const REAL *opacities,
    __global const REAL *camera,
    __global const REAL *records,
    __global const REAL *grad_means2d,
    __global const REAL *grad_records,
    __global REAL *grad_means,
    __global REAL *grad_quats,
    __global REAL *grad_scales,
    __global REAL *grad_opacities
) {
    const int begin = get_global_id(0) * PROJECTION_CHUNK;
    const int end = begin + PROJECTION_CHUNK < count ? begin + PROJECTION_CHUNK : count;
    for (int first = begin; first < end; first += PROJECTED_AT_ONCE) {
        const Group group = group_of(first, count);
        const Geometry g = read_geometry(means, quats, camera, group);
        REALS scale[3], grad_rows[2][3], grad_opacity;
        for (int k = 0; k < 3; k++) scale[k] = read_reals(scales, 3, k, group);
        const Footprint f = footprint_of(&g, scale);
        const MASKS visible = read_reals(records, RECORD, 5, group) > R(0);  // a visible one's opacity is never 0
        footprint_backward(
            &f, records, grad_records, read_reals(opacities, 1, 0, group), group, grad_rows, &grad_opacity
        );
        write_reals(grad_opacities, 1, 0, group, gradient(visible, grad_opacity));

        const REAL fx = camera[12], fy = camera[13];
        const REALS inverse_z = 1 / g.z;
        REALS grad_turned[3][3], grad_slant_x = (REALS)(R(0)), grad_slant_y = (REALS)(R(0)), grad_z = (REALS)(R(0));
        for (int k = 0; k < 3; k++) {
            const REALS grad_scale = grad_rows[0][k] * g.axes[0][k] + grad_rows[1][k] * g.axes[1][k];
            write_reals(grad_scales, 3, k, group, gradient(visible, grad_scale));
            grad_turned[0][k] = fx * inverse_z * grad_rows[0][k] * scale[k];
            grad_turned[1][k] = fy * inverse_z * grad_rows[1][k] * scale[k];
            grad_turned[2][k] = -g.slant_x * grad_turned[0][k] - g.slant_y * grad_turned[1][k];
            grad_slant_x -= grad_turned[0][k] * g.turned[2][k];
            grad_slant_y -= grad_turned[1][k] * g.turned[2][k];
            grad_z -= grad_scale * scale[k] * inverse_z;
        }

        // Where the slant is clamped, x and y do not affect it.
        const REALS ratio_x = fx * read_reals(grad_means2d, 2, 0, group) + or_zero(g.inside_x, grad_slant_x);
        const REALS ratio_y = fy * read_reals(grad_means2d, 2, 1, group) + or_zero(g.inside_y, grad_slant_y);
        const REALS grad_x = ratio_x * inverse_z, grad_y = ratio_y * inverse_z;
        grad_z -= (ratio_x * (g.x / g.z) + ratio_y * (g.y / g.z)) * inverse_z;  // ratio_x * g.x could overflow
        for (int k = 0; k < 3; k++) {
            const REALS grad_mean = camera[k] * grad_x + camera[3 + k] * grad_y + camera[6 + k] * grad_z;
            write_reals(grad_means, 3, k, group, gradient(visible, grad_mean));
        }

        REALS grad_rotation[3][3], grad_quat[4];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                grad_rotation[j][k] = camera[j] * grad_turned[0][k] + camera[3 + j] * grad_turned[1][k]
                    + camera[6 + j] * grad_turned[2][k];
        rotation_backward(&g, grad_rotation, grad_quat);
        for (int k = 0; k < 4; k++) write_reals(grad_quats, 4, k, group, gradient(visible, grad_quat[k]));
    }
}

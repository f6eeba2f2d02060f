// From the world to the screen, one Gaussian at a time, and back.
//
// camera: 0..8 rotation by rows, 9..11 translation, 12 fx, 13 fy, 14 cx, 15 cy, 16..19 clamp of x/z (low, high) and
// y/z (low, high). Each work-item takes PROJECTION_CHUNK Gaussians in a row.

typedef struct {
    REAL x, y, z;              // in the camera's frame
    REAL slant_x, slant_y;     // x/z and y/z, clamped
    int inside_x, inside_y;    // whether they were inside the clamp
    REAL axes[2][3];           // Jacobian · camera rotation · Gaussian's rotation: the screen's axes before scaling
    REAL turned[3][3];         // camera rotation · Gaussian's rotation
    REAL rotation[3][3];       // Gaussian's rotation
    REAL unit[4];              // normalised quaternion
    REAL length;               // of the quaternion
} Geometry;

inline void rotation_of(const REAL q[4], REAL m[3][3]) {
    const REAL w = q[0], x = q[1], y = q[2], z = q[3];
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

inline Geometry geometry_of(
    __global const REAL *mean, __global const REAL *quat, __global const REAL *camera
) {
    Geometry g;
    g.x = camera[0] * mean[0] + camera[1] * mean[1] + camera[2] * mean[2] + camera[9];
    g.y = camera[3] * mean[0] + camera[4] * mean[1] + camera[5] * mean[2] + camera[10];
    g.z = camera[6] * mean[0] + camera[7] * mean[1] + camera[8] * mean[2] + camera[11];

    // Scaled by the largest component first: neither tiny nor huge quaternions leave the range.
    REAL largest = 0;
    for (int i = 0; i < 4; i++) {
        const REAL size = quat[i] < 0 ? -quat[i] : quat[i];
        largest = size > largest ? size : largest;
    }
    REAL squares = 0;
    for (int i = 0; i < 4; i++) {
        g.unit[i] = quat[i] / largest;
        squares += g.unit[i] * g.unit[i];
    }
    const REAL root = sqrt(squares);
    for (int i = 0; i < 4; i++) g.unit[i] /= root;
    g.length = root * largest;
    rotation_of(g.unit, g.rotation);

    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            g.turned[i][k] = camera[3 * i] * g.rotation[0][k] + camera[3 * i + 1] * g.rotation[1][k]
                + camera[3 * i + 2] * g.rotation[2][k];

    const REAL slant_x = g.x / g.z, slant_y = g.y / g.z;
    g.inside_x = slant_x >= camera[16] && slant_x <= camera[17];
    g.inside_y = slant_y >= camera[18] && slant_y <= camera[19];
    g.slant_x = slant_x < camera[16] ? camera[16] : slant_x > camera[17] ? camera[17] : slant_x;
    g.slant_y = slant_y < camera[18] ? camera[18] : slant_y > camera[19] ? camera[19] : slant_y;
    const REAL across = camera[12] / g.z, down = camera[13] / g.z;
    for (int k = 0; k < 3; k++) {
        g.axes[0][k] = across * (g.turned[0][k] - g.slant_x * g.turned[2][k]);
        g.axes[1][k] = down * (g.turned[1][k] - g.slant_y * g.turned[2][k]);
    }
    return g;
}

inline int all_finite(__global const REAL *values, int count) {
    int finite = 1;
    for (int i = 0; i < count; i++) finite &= values[i] - values[i] == 0;
    return finite;
}

// Whether a pixel centre 0.5, 1.5 ... size - 0.5 lies within half_length of centre.
inline int holds_a_pixel(REAL centre, REAL half_length, int size) {
    REAL first = ceil(centre - half_length - R(0.5)), last = floor(centre + half_length - R(0.5));
    first = first < 0 ? 0 : first;
    last = last > size - 1 ? size - 1 : last;
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
    const int first = get_global_id(0) * PROJECTION_CHUNK;
    const int last = first + PROJECTION_CHUNK < count ? first + PROJECTION_CHUNK : count;
    for (int i = first; i < last; i++) {
        __global REAL *record = records + (size_t)RECORD * i;
        for (int k = 0; k < RECORD; k++) record[k] = 0;
        means2d[2 * i] = means2d[2 * i + 1] = 0;
        radii[i] = 0;
        depth_keys[i] = 0;

        const REAL opacity = opacities[i];
        const __global REAL *quat = quats + (size_t)4 * i;
        if (!(opacity >= ALPHA_MINIMUM) || !all_finite(opacities + i, 1)) continue;
        if (!all_finite(means + (size_t)3 * i, 3) || !all_finite(quat, 4) || !all_finite(scales + (size_t)3 * i, 3)
            || !all_finite(features + (size_t)feature_dim * i, feature_dim))
            continue;
        if (quat[0] == 0 && quat[1] == 0 && quat[2] == 0 && quat[3] == 0) continue;
        const Geometry g = geometry_of(means + (size_t)3 * i, quat, camera);
        if (!(g.z > NEAR)) continue;

        REAL xx = 0, xy = 0, yy = 0, rows[2][3];
        for (int k = 0; k < 3; k++) {
            rows[0][k] = g.axes[0][k] * scales[(size_t)3 * i + k];
            rows[1][k] = g.axes[1][k] * scales[(size_t)3 * i + k];
            xx += rows[0][k] * rows[0][k];
            xy += rows[0][k] * rows[1][k];
            yy += rows[1][k] * rows[1][k];
        }
        // The determinant by Cauchy and Binet, a sum of squares: xx yy - xy^2 would cancel for needles.
        const REAL minor_0 = rows[0][1] * rows[1][2] - rows[0][2] * rows[1][1];
        const REAL minor_1 = rows[0][2] * rows[1][0] - rows[0][0] * rows[1][2];
        const REAL minor_2 = rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0];
        const REAL determinant = minor_0 * minor_0 + minor_1 * minor_1 + minor_2 * minor_2
            + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
        xx += LOW_PASS;
        yy += LOW_PASS;
        const REAL centre_x = camera[12] * g.x / g.z + camera[14];
        const REAL centre_y = camera[13] * g.y / g.z + camera[15];
        const REAL sum = determinant + centre_x + centre_y + xx * xx + yy * yy;
        if (!(sum - sum == 0)) continue;

        const REAL reach = 2 * log(opacity / ALPHA_MINIMUM);
        if (!holds_a_pixel(centre_x, sqrt(reach * xx), width) || !holds_a_pixel(centre_y, sqrt(reach * yy), height))
            continue;
        const REAL half_difference = R(0.5) * (xx - yy);
        const REAL longest = R(0.5) * (xx + yy) + sqrt(half_difference * half_difference + xy * xy);
        const REAL radius = ceil(RADIUS_SIGMAS * sqrt(longest));
        radii[i] = radius < R(1 << 30) ? (int)radius : 1 << 30;
        depth_keys[i] = AS_DEPTH_KEY(g.z);
        means2d[2 * i] = record[0] = centre_x;
        means2d[2 * i + 1] = record[1] = centre_y;
        record[2] = xy / yy;
        record[3] = yy / determinant;
        record[4] = 1 / yy;
        record[5] = opacity;
        record[6] = reach;
        record[7] = g.z;
    }
}

// The chain rule of `project`, in the reverse order of its lines.
__kernel void project_backward(
    const int count,
    __global const REAL *means,
    __global const REAL *quats,
    __global const REAL *scales,
    __global const REAL *camera,
    __global const int *radii,
    __global const REAL *records,
    __global const REAL *grad_means2d,
    __global const REAL *grad_records,
    __global REAL *grad_means,
    __global REAL *grad_quats,
    __global REAL *grad_scales,
    __global REAL *grad_opacities
) {
    const int first = get_global_id(0) * PROJECTION_CHUNK;
    const int last = first + PROJECTION_CHUNK < count ? first + PROJECTION_CHUNK : count;
    for (int i = first; i < last; i++) {
        if (radii[i] == 0) {
            for (int k = 0; k < 3; k++) grad_means[(size_t)3 * i + k] = grad_scales[(size_t)3 * i + k] = 0;
            for (int k = 0; k < 4; k++) grad_quats[(size_t)4 * i + k] = 0;
            grad_opacities[i] = 0;
            continue;
        }
        const Geometry g = geometry_of(means + (size_t)3 * i, quats + (size_t)4 * i, camera);
        __global const REAL *record = records + (size_t)RECORD * i;
        __global const REAL *grad_record = grad_records + (size_t)RECORD * i;
        const REAL slope = record[2], across = record[3], down = record[4];
        const REAL grad_slope = grad_record[2], grad_across = grad_record[3], grad_down = grad_record[4];
        grad_opacities[i] = grad_record[5];

        // slope = xy / yy, across = 1 / (xx - xy^2 / yy), down = 1 / yy
        const REAL grad_xx = -across * across * grad_across;
        const REAL grad_xy = -2 * slope * grad_xx + down * grad_slope;
        const REAL grad_yy = slope * slope * grad_xx - slope * down * grad_slope - down * down * grad_down;

        REAL grad_axes[2][3];
        for (int k = 0; k < 3; k++) {
            const REAL scale = scales[(size_t)3 * i + k];
            const REAL row_x = g.axes[0][k] * scale, row_y = g.axes[1][k] * scale;
            const REAL grad_row_x = 2 * grad_xx * row_x + grad_xy * row_y;
            const REAL grad_row_y = 2 * grad_yy * row_y + grad_xy * row_x;
            grad_scales[(size_t)3 * i + k] = grad_row_x * g.axes[0][k] + grad_row_y * g.axes[1][k];
            grad_axes[0][k] = grad_row_x * scale;
            grad_axes[1][k] = grad_row_y * scale;
        }

        const REAL fx = camera[12], fy = camera[13], inverse_z = 1 / g.z;
        REAL grad_turned[3][3], grad_slant_x = 0, grad_slant_y = 0, grad_z = 0;
        for (int k = 0; k < 3; k++) {
            const REAL grad_x = fx * inverse_z * grad_axes[0][k], grad_y = fy * inverse_z * grad_axes[1][k];
            grad_turned[0][k] = grad_x;
            grad_turned[1][k] = grad_y;
            grad_turned[2][k] = -g.slant_x * grad_x - g.slant_y * grad_y;
            grad_slant_x -= grad_x * g.turned[2][k];
            grad_slant_y -= grad_y * g.turned[2][k];
            grad_z -= (grad_axes[0][k] * g.axes[0][k] + grad_axes[1][k] * g.axes[1][k]) * inverse_z;
        }

        // Where the clamp holds the slant, x and y do not move it.
        REAL grad_ratio_x = fx * grad_means2d[2 * i] + (g.inside_x ? grad_slant_x : 0);
        REAL grad_ratio_y = fy * grad_means2d[2 * i + 1] + (g.inside_y ? grad_slant_y : 0);
        const REAL grad_x = grad_ratio_x * inverse_z, grad_y = grad_ratio_y * inverse_z;
        grad_z -= (grad_ratio_x * g.x + grad_ratio_y * g.y) * inverse_z * inverse_z;
        for (int k = 0; k < 3; k++)
            grad_means[(size_t)3 * i + k] = camera[k] * grad_x + camera[3 + k] * grad_y + camera[6 + k] * grad_z;

        REAL d[3][3];  // of the Gaussian's rotation
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                d[j][k] = camera[j] * grad_turned[0][k] + camera[3 + j] * grad_turned[1][k]
                    + camera[6 + j] * grad_turned[2][k];
        const REAL w = g.unit[0], x = g.unit[1], y = g.unit[2], z = g.unit[3];
        REAL grad_unit[4];
        grad_unit[0] = 2 * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
        grad_unit[1] = 2 * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2]))
            - 4 * x * (d[1][1] + d[2][2]);
        grad_unit[2] = 2 * (x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0]))
            - 4 * y * (d[0][0] + d[2][2]);
        grad_unit[3] = 2 * (x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1]))
            - 4 * z * (d[0][0] + d[1][1]);
        REAL along = 0;
        for (int k = 0; k < 4; k++) along += grad_unit[k] * g.unit[k];
        for (int k = 0; k < 4; k++) grad_quats[(size_t)4 * i + k] = (grad_unit[k] - along * g.unit[k]) / g.length;
    }
}

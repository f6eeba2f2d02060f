// 3 x 3 convolutions and the gradients of their weights, built on winograd.cl and products.cl.
//
// Work-items stride over chunks of TILE_CHUNK tiles, few enough that a chunk stays in the cache. Each work-item has its
// own part of `scratch`. There it keeps, for each of the 36 points, a matrix of the chunk's inputs,
// [inputs / 16][TILE_CHUNK][16], and one of its outputs or their gradients, [TILE_CHUNK][outputs]. Consecutive matrices
// are `input_step` or `output_step` values apart. All channel counts are multiples of 16.

// Convolves all tiles with `weights` [36][inputs][outputs], the filters at the points. If `shown` is given, it is the
// output of a ReLU and `pictures` its gradient, which is read as 0 wherever that output is 0.
__kernel void convolve(
    const int tiles,
    const int height,
    const int width,
    const int inputs,
    const int outputs,
    const int input_step,
    const int output_step,
    __global REAL *scratch,
    __global const REAL *pictures,
    __global const REAL *shown,
    __global const REAL *weights,
    __global const REAL *bias,
    const int rectifies,
    __global REAL *convolved
) {
    __global REAL *points = scratch + get_group_id(0) * (size_t)POINTS * (input_step + output_step);
    __global REAL *products = points + POINTS * input_step;
    for (int first = get_group_id(0) * TILE_CHUNK; first < tiles; first += get_num_groups(0) * TILE_CHUNK) {
        const int count = tiles - first < TILE_CHUNK ? tiles - first : TILE_CHUNK;
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, inputs);
            for (int channel = 0; channel < inputs; channel += 16) {
                const size_t place = tile.start + channel;
                __global const REAL *mask = shown ? shown + place : shown;
                tile_at_points(pictures + place, mask, tile, points + channel * TILE_CHUNK + row * 16, input_step);
            }
        }
        // Rows from `count` on hold stale values; their products are computed but never read.
        for (int point = 0; point < POINTS; point++)
            for (int channel = 0; channel < outputs; channel += 16)
                for (int row = 0; row < TILE_CHUNK; row += ROWS)
                    multiply(
                        inputs / 16, 16, points + point * input_step + row * 16, TILE_CHUNK * 16, 1, 16,
                        weights + point * inputs * outputs + channel, outputs,
                        products + point * output_step + row * outputs + channel, outputs, 0
                    );
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, outputs);
            for (int channel = 0; channel < outputs; channel += 16)
                tile_of_points(
                    products + row * outputs + channel, output_step, *(LANES_IN)(bias + channel), rectifies,
                    convolved + tile.start + channel, tile
                );
        }
    }
}

// Each work-item's share of the gradients: of the weights at the points, [36][inputs][outputs], then of the bias.
__kernel void weight_gradients(
    const int tiles,
    const int height,
    const int width,
    const int inputs,
    const int outputs,
    const int input_step,
    const int output_step,
    __global REAL *scratch,
    __global const REAL *pictures,
    __global const REAL *gradients,
    __global const REAL *shown,
    __global REAL *sums
) {
    __global REAL *points = scratch + get_group_id(0) * (size_t)POINTS * (input_step + output_step);
    __global REAL *of_gradients = points + POINTS * input_step;
    __global REAL *of_weights = sums + get_group_id(0) * ((size_t)POINTS * inputs + 1) * outputs;
    __global REAL *of_bias = of_weights + (size_t)POINTS * inputs * outputs;
    for (int channel = 0; channel < outputs; channel++) of_bias[channel] = 0;
    const int start = get_group_id(0) * TILE_CHUNK;
    for (int first = start; first < tiles; first += get_num_groups(0) * TILE_CHUNK) {
        const int count = tiles - first < TILE_CHUNK ? tiles - first : TILE_CHUNK;
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, inputs);
            for (int channel = 0; channel < inputs; channel += 16)
                tile_at_points(
                    pictures + tile.start + channel, 0, tile, points + channel * TILE_CHUNK + row * 16, input_step
                );
            const Tile output = tile_at(first + row, height, width, outputs);
            for (int channel = 0; channel < outputs; channel += 16) {
                const size_t place = output.start + channel;
                __global const REAL *mask = shown ? shown + place : shown;
                __global REAL *found = of_gradients + row * outputs + channel;
                tile_gradient_at_points(gradients + place, mask, output, found, output_step);
                *(LANES_OUT)(of_bias + channel) += *(LANES_IN)(found + 7 * output_step);
            }
        }
        for (int point = 0; point < POINTS; point++)
            for (int channel = 0; channel < outputs; channel += 16)
                for (int row = 0; row < inputs; row += ROWS)
                    multiply(
                        1, count, points + point * input_step + row / 16 * TILE_CHUNK * 16 + row % 16, 0, 16, 1,
                        of_gradients + point * output_step + channel, outputs,
                        of_weights + (point * inputs + row) * outputs + channel, outputs, first != start
                    );
    }
}

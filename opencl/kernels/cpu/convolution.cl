// Convolutions 3 x 3 and the gradient of their weights, by winograd.cl and products.cl.
//
// A work-item takes CHUNK tiles at a time, every so many chunks, so that what it holds of them in its part of `scratch`,
// a matrix of CHUNK rows for each point, stays in the cache. All numbers of channels are multiples of 16.

#define CHUNK 16

// Values from one matrix to the next: a line of the cache more than it has, as otherwise those that a tile has at all
// points would fall into the same few places of the cache.
#define STEP(channels) (CHUNK * (channels) + 16)

// All tiles convolved with `weights` at the points, [36][inputs][outputs]. Where `shown` is given, `pictures` are the
// gradient of what it was rectified from.
__kernel void convolve(
    const int tiles,
    const int height,
    const int width,
    const int inputs,
    const int outputs,
    __global REAL *scratch,
    __global const REAL *pictures,
    __global const REAL *shown,
    __global const REAL *weights,
    __global const REAL *bias,
    const int rectifies,
    __global REAL *convolved
) {
    __global REAL *points = scratch + get_group_id(0) * (size_t)POINTS * (STEP(inputs) + STEP(outputs));
    __global REAL *products = points + POINTS * STEP(inputs);
    for (int first = get_group_id(0) * CHUNK; first < tiles; first += get_num_groups(0) * CHUNK) {
        const int count = tiles - first < CHUNK ? tiles - first : CHUNK;
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, inputs);
            for (int channel = 0; channel < inputs; channel += 16) {
                const size_t place = tile.start + channel;
                __global const REAL *mask = shown ? shown + place : shown;
                tile_at_points(pictures + place, mask, tile, points + channel * CHUNK + row * 16, STEP(inputs));
            }
        }
        // Rows beyond `count` hold what was there before, and so do the products that come of them: nobody reads these.
        for (int point = 0; point < POINTS; point++)
            for (int channel = 0; channel < outputs; channel += 16)
                for (int row = 0; row < CHUNK; row += ROWS)
                    multiply(
                        inputs / 16, 16, points + point * STEP(inputs) + row * 16, CHUNK * 16, 1, 16,
                        weights + point * inputs * outputs + channel, outputs,
                        products + point * STEP(outputs) + row * outputs + channel, outputs, 0
                    );
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, outputs);
            for (int channel = 0; channel < outputs; channel += 16)
                tile_of_points(
                    products + row * outputs + channel, STEP(outputs), *(LANES_IN)(bias + channel), rectifies,
                    convolved + tile.start + channel, tile
                );
        }
    }
}

// What each work-item has of the gradient: of the weights at the points, [36][inputs][outputs], and of the bias.
__kernel void weight_gradients(
    const int tiles,
    const int height,
    const int width,
    const int inputs,
    const int outputs,
    __global REAL *scratch,
    __global const REAL *pictures,
    __global const REAL *gradients,
    __global const REAL *shown,
    __global REAL *sums
) {
    __global REAL *points = scratch + get_group_id(0) * (size_t)POINTS * (STEP(inputs) + STEP(outputs));
    __global REAL *of_gradients = points + POINTS * STEP(inputs);
    __global REAL *of_weights = sums + get_group_id(0) * ((size_t)POINTS * inputs + 1) * outputs;
    __global REAL *of_bias = of_weights + (size_t)POINTS * inputs * outputs;
    for (int channel = 0; channel < outputs; channel++) of_bias[channel] = 0;
    const int start = get_group_id(0) * CHUNK;
    for (int first = start; first < tiles; first += get_num_groups(0) * CHUNK) {
        const int count = tiles - first < CHUNK ? tiles - first : CHUNK;
        for (int row = 0; row < count; row++) {
            const Tile tile = tile_at(first + row, height, width, inputs);
            for (int channel = 0; channel < inputs; channel += 16)
                tile_at_points(
                    pictures + tile.start + channel, 0, tile, points + channel * CHUNK + row * 16, STEP(inputs)
                );
            const Tile output = tile_at(first + row, height, width, outputs);
            for (int channel = 0; channel < outputs; channel += 16) {
                const size_t place = output.start + channel;
                __global const REAL *mask = shown ? shown + place : shown;
                __global REAL *found = of_gradients + row * outputs + channel;
                tile_gradient_at_points(gradients + place, mask, output, found, STEP(outputs));
                *(LANES_OUT)(of_bias + channel) += *(LANES_IN)(found + 7 * STEP(outputs));
            }
        }
        for (int point = 0; point < POINTS; point++)
            for (int channel = 0; channel < outputs; channel += 16)
                for (int row = 0; row < inputs; row += ROWS)
                    multiply(
                        1, count, points + point * STEP(inputs) + row / 16 * CHUNK * 16 + row % 16, 0, 16, 1,
                        of_gradients + point * STEP(outputs) + channel, outputs,
                        of_weights + (point * inputs + row) * outputs + channel, outputs, first != start
                    );
    }
}

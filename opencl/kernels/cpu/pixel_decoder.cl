// Per-pixel decoders and their gradients: linear layers on the channels of a pixel, a ReLU after each but the last.
//
// Work-items stride over chunks of PIXEL_CHUNK pixels. All blocks of a chunk (see layers.cl) fit into the work-item's
// own part of `scratch`, and into the cache. `widths` holds the channel counts of the input and of each layer,
// multiples of 16; `weights` and `turned` hold the layers one after the other, at the same offsets.

// Applies all layers to a chunk, writing their blocks one after the other; returns the last block.
WHOLE_REGISTERS static inline __global REAL *show_layers(
    int layers, __global const int *widths, __global const REAL *weights, __global REAL *block
) {
    for (int layer = 0; layer < layers; layer++) {
        __global REAL *next = block + PIXEL_CHUNK * widths[layer];
        show_layer(block, widths[layer], weights, widths[layer + 1], layer + 1 < layers, next);
        weights += (widths[layer] + 1) * widths[layer + 1];
        block = next;
    }
    return block;
}

__kernel void decode_pixels(
    const int pixels,
    const int channels,
    const int outputs,
    const int layers,
    const int scratch_size,
    __global REAL *scratch,
    __global const int *widths,
    __global const REAL *picture,
    __global const REAL *weights,
    __global REAL *decoded
) {
    __global REAL *blocks = scratch + get_group_id(0) * (size_t)scratch_size;
    for (int first = get_group_id(0) * PIXEL_CHUNK; first < pixels; first += get_num_groups(0) * PIXEL_CHUNK) {
        read_block(picture, channels, first, pixels, widths[0], blocks);
        write_block(show_layers(layers, widths, weights, blocks), outputs, first, pixels, decoded);
    }
}

// Gradients of the picture and, in `sums`, each work-item's share of the gradient of `weights`, in the same layout.
// Either output may be null if it is not needed.
__kernel void decode_pixels_backward(
    const int pixels,
    const int channels,
    const int outputs,
    const int layers,
    const int scratch_size,
    __global REAL *scratch,
    __global const int *widths,
    __global const REAL *picture,
    __global const REAL *weights,
    __global const REAL *turned,
    __global const REAL *grad_decoded,
    __global REAL *grad_picture,
    __global REAL *sums
) {
    int all_widths = widths[0], weight_count = 0, widest = widths[0];
    for (int layer = 0; layer < layers; layer++) {
        all_widths += widths[layer + 1];
        weight_count += (widths[layer] + 1) * widths[layer + 1];
        widest = widths[layer + 1] > widest ? widths[layer + 1] : widest;
    }
    __global REAL *blocks = scratch + get_group_id(0) * (size_t)scratch_size;
    __global REAL *own = sums ? sums + get_group_id(0) * (size_t)weight_count : sums;
    for (int weight = 0; sums && weight < weight_count; weight++) own[weight] = 0;
    for (int first = get_group_id(0) * PIXEL_CHUNK; first < pixels; first += get_num_groups(0) * PIXEL_CHUNK) {
        read_block(picture, channels, first, pixels, widths[0], blocks);
        __global REAL *block = show_layers(layers, widths, weights, blocks);
        __global REAL *gradient = blocks + PIXEL_CHUNK * all_widths, *passed = gradient + PIXEL_CHUNK * widest;
        read_block(grad_decoded, outputs, first, pixels, widths[layers], gradient);
        int weight = weight_count;
        for (int layer = layers - 1; layer >= 0; layer--) {
            block -= PIXEL_CHUNK * widths[layer];
            weight -= (widths[layer] + 1) * widths[layer + 1];
            if (sums) add_gradients(block, widths[layer], gradient, widths[layer + 1], own + weight);
            if (layer == 0 && !grad_picture) break;
            pass_gradient(
                gradient, widths[layer + 1], turned + weight, block, widths[layer], layer > 0, passed
            );
            __global REAL *free = gradient;
            gradient = passed;
            passed = free;
        }
        if (grad_picture) write_block(gradient, channels, first, pixels, grad_picture);
    }
}

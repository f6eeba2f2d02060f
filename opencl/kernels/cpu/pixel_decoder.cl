// Decoders of single pixels: layers of all channels of a pixel, a ReLU after each but the last, and their gradients.
//
// A work-item takes PIXEL_CHUNK pixels at a time, every so many chunks. Of these, what a layer shows is a block: for
// each 16 channels, one after the other, PIXEL_CHUNK rows of them. All blocks of a chunk lie in the work-item's part of
// `scratch`, and in the cache. `widths` are the channels of the input and of each layer, in sixteens; `weights` have of
// each layer [inputs][outputs] and the bias, `turned` at the same places [outputs][inputs].

// The `channels` of each pixel of a picture into a block, zero where there is none, and back.
WHOLE_REGISTERS static inline void read_block(
    __global const REAL *picture, int channels, int first, int pixels, int width, __global REAL *block
) {
    for (int channel = 0; channel < width; channel += 16)
        for (int row = 0; row < PIXEL_CHUNK; row++) {
            __global const REAL *from = picture + (size_t)(first + row) * channels + channel;
            __global REAL *to = block + channel * PIXEL_CHUNK + row * 16;
            const int count = first + row < pixels ? channels - channel : 0;
            if (count >= 16) *(LANES_OUT)to = *(LANES_IN)from;
            else
                for (int place = 0; place < 16; place++) to[place] = place < count ? from[place] : 0;
        }
}

static inline void write_block(
    __global const REAL *block, int channels, int first, int pixels, __global REAL *picture
) {
    for (int channel = 0; channel < channels; channel += 16)
        for (int row = 0; row < PIXEL_CHUNK && first + row < pixels; row++) {
            __global const REAL *from = block + channel * PIXEL_CHUNK + row * 16;
            __global REAL *to = picture + (size_t)(first + row) * channels + channel;
            for (int place = 0; place < 16 && channel + place < channels; place++) to[place] = from[place];
        }
}

// What a layer shows of the block before it.
WHOLE_REGISTERS static inline void show_layer(
    __global const REAL *block,
    int inputs,
    __global const REAL *weights,
    int outputs,
    int rectifies,
    __global REAL *next
) {
    for (int channel = 0; channel < outputs; channel += 16) {
        const LANES bias = *(LANES_IN)(weights + inputs * outputs + channel);
        __global REAL *shown = next + channel * PIXEL_CHUNK;
        for (int row = 0; row < PIXEL_CHUNK; row++) *(LANES_OUT)(shown + row * 16) = bias;
        for (int row = 0; row < PIXEL_CHUNK; row += ROWS)
            multiply(
                inputs / 16, 16, block + row * 16, PIXEL_CHUNK * 16, 1, 16, weights + channel, outputs,
                shown + row * 16, 16, 1
            );
        for (int row = 0; row < PIXEL_CHUNK && rectifies; row++) {
            const LANES value = *(LANES_IN)(shown + row * 16);
            *(LANES_OUT)(shown + row * 16) = value < 0 ? (LANES)(0) : value;
        }
    }
}

// All layers of a chunk, block after block; returns the last.
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

// What a layer adds to the gradient of its weights and of its bias, by the block before it and the gradient of its own.
WHOLE_REGISTERS static inline void add_gradients(
    __global const REAL *block, int inputs, __global const REAL *gradient, int outputs, __global REAL *sums
) {
    for (int channel = 0; channel < outputs; channel += 16) {
        __global const REAL *of_shown = gradient + channel * PIXEL_CHUNK;
        for (int row = 0; row < inputs; row += ROWS)
            multiply(
                1, PIXEL_CHUNK, block + row / 16 * PIXEL_CHUNK * 16 + row % 16, 0, 16, 1, of_shown, 16,
                sums + row * outputs + channel, outputs, 1
            );
        LANES of_bias = *(LANES_IN)(sums + inputs * outputs + channel);
        for (int row = 0; row < PIXEL_CHUNK; row++) of_bias += *(LANES_IN)(of_shown + row * 16);
        *(LANES_OUT)(sums + inputs * outputs + channel) = of_bias;
    }
}

// The gradient of a layer's inputs; none of those that the ReLU before it held at zero.
WHOLE_REGISTERS static inline void pass_gradient(
    __global const REAL *gradient,
    int outputs,
    __global const REAL *turned,
    __global const REAL *block,
    int inputs,
    int rectified,
    __global REAL *passed
) {
    for (int channel = 0; channel < inputs; channel += 16) {
        __global REAL *found = passed + channel * PIXEL_CHUNK;
        for (int row = 0; row < PIXEL_CHUNK; row += ROWS)
            multiply(
                outputs / 16, 16, gradient + row * 16, PIXEL_CHUNK * 16, 1, 16, turned + channel, inputs,
                found + row * 16, 16, 0
            );
        for (int row = 0; row < PIXEL_CHUNK && rectified; row++) {
            const LANES shown = *(LANES_IN)(block + channel * PIXEL_CHUNK + row * 16);
            const LANES value = *(LANES_IN)(found + row * 16);
            *(LANES_OUT)(found + row * 16) = shown <= 0 ? (LANES)(0) : value;
        }
    }
}

// Gradients of the picture, and of `weights` as far as each work-item's pixels have a part in it, in the same order.
// Either may be null: nobody asks for it then.
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

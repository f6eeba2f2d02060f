// Linear layers on chunks of PIXEL_CHUNK rows. A row is a pixel, or anything else that consists of channels.
//
// A layer's input and output for a chunk are blocks, [channels / 16][PIXEL_CHUNK][16], with the channels zero-padded to
// a multiple of 16. A layer's `weights` are [inputs][outputs], followed by its bias; `turned` is the transpose
// [outputs][inputs].

// Copies pixels of a picture into a block, zero where there is no such pixel or channel; write_block copies them back.
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

// Applies a layer to `block` and, if `rectifies`, a ReLU.
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

// Adds a chunk's share of the gradients of a layer's weights and bias to `sums`, from the layer's input `block` and the
// gradient of its output.
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

// The gradient of a layer's input `block`; 0 where a preceding ReLU (`rectified`) held the input at zero.
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

// Structural similarity of two pictures and its gradient: what both schedules share.
//
// Pictures lie one below the other, `rows` rows each, `total` in all; a row holds `length` values, three a pixel, from
// PADDING on, and zeros before and after them up to `stride`. The window is separable: down the rows first, then
// across, three values at a time. `similarities` keeps what `similarity_gradient` needs of each value: the derivatives
// by the windowed mean of the picture, of the product and of the square, for which the padding must be zero, too.

#define PADDING 16
#define REACH 5
#define TAPS (2 * REACH + 1)
#define LUMINANCE_CONSTANT R(1e-4)
#define CONTRAST_CONSTANT R(9e-4)

// A Gaussian of standard deviation 1.5 pixels, its sum one.
__constant REAL window[TAPS] = {
    R(0.00102838008447911), R(0.007598758135239185), R(0.03600077212843083), R(0.10936068950970002),
    R(0.2130055377112537), R(0.26601172486179436), R(0.2130055377112537), R(0.10936068950970002),
    R(0.03600077212843083), R(0.007598758135239185), R(0.00102838008447911)
};

// What is computed at a time: SSIM_AT_ONCE neighbours of a row.
#if SSIM_AT_ONCE == 16
typedef LANES SIMILAR;
#else
typedef REAL SIMILAR;
#endif

typedef struct {
    SIMILAR similarity, by_mean, by_product, by_square;
} Similarity;

// Of the window's means of both pictures, of their product and of both squares together.
static inline Similarity similarity_of(SIMILAR mean, SIMILAR mean_of_truth, SIMILAR product, SIMILAR squares) {
    const SIMILAR product_of_means = mean * mean_of_truth;
    const SIMILAR squares_of_means = mean * mean + mean_of_truth * mean_of_truth;
    const SIMILAR luminance = 2 * product_of_means + LUMINANCE_CONSTANT;
    const SIMILAR contrast = 2 * (product - product_of_means) + CONTRAST_CONSTANT;
    const SIMILAR luminance_scale = squares_of_means + LUMINANCE_CONSTANT;
    const SIMILAR contrast_scale = squares - squares_of_means + CONTRAST_CONSTANT;
    const SIMILAR inverse = 1 / (luminance_scale * contrast_scale);
    Similarity s;
    s.similarity = luminance * contrast * inverse;
    s.by_mean =
        2 * inverse * ((contrast - luminance) * mean_of_truth + s.similarity * (luminance_scale - contrast_scale) * mean);
    s.by_product = 2 * luminance * inverse;
    s.by_square = -s.similarity / contrast_scale;
    return s;
}

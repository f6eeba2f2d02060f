// Structural similarity (SSIM) of two pictures and its gradient: the code that both schedules share.
//
// Pictures are stacked vertically: `rows` rows each, `total` rows in all. A row takes `stride` values: PADDING zeros,
// `length` values (three per pixel), then zeros. The window is separable: it is applied down the columns first, then
// across the row, where its taps are three values (one pixel) apart. For `similarity_gradient`, the kernel
// `similarities` stores the derivative of each value's similarity with respect to three windowed means: of the picture,
// of the product of both pictures, and of the picture's square. The padding of these arrays must be zero, too.

#define PADDING 16
#define REACH 5
#define TAPS (2 * REACH + 1)
#define LUMINANCE_CONSTANT R(1e-4)
#define CONTRAST_CONSTANT R(9e-4)

// A Gaussian with a standard deviation of 1.5 pixels, normalised to sum to 1.
__constant REAL window[TAPS] = {
    R(0.00102838008447911), R(0.007598758135239185), R(0.03600077212843083), R(0.10936068950970002),
    R(0.2130055377112537), R(0.26601172486179436), R(0.2130055377112537), R(0.10936068950970002),
    R(0.03600077212843083), R(0.007598758135239185), R(0.00102838008447911)
};

// SSIM_AT_ONCE neighbouring values of a row, computed together.
#if SSIM_AT_ONCE == 16
typedef LANES SIMILAR;
#else
typedef REAL SIMILAR;
#endif

typedef struct {
    SIMILAR similarity, by_mean, by_product, by_square;
} Similarity;

// Similarity and its derivatives, from four windowed means: of each picture, of their product, and of the sum of their
// squares.
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

// Numbers and vectors that all kernels share. REAL is float, or double where REAL_IS_DOUBLE is defined.
//
// A LANES value holds 16 neighbouring pixels of a row. Only operators are used on it: PoCL 3.0 links its built-in
// functions for another CPU than it compiles kernels for, and 16 wide built-ins then abort the process.

#ifdef REAL_IS_DOUBLE
typedef double REAL;
typedef double2 REAL2;
typedef double4 REAL4;
typedef double8 REAL8;
typedef double16 LANES;
typedef long16 LANES_MASK;
typedef ulong DEPTH_KEY;
#define AS_DEPTH_KEY as_ulong
#define AS_MASK as_long16
#define AS_LANES as_double16
#else
typedef float REAL;
typedef float2 REAL2;
typedef float4 REAL4;
typedef float8 REAL8;
typedef float16 LANES;
typedef int16 LANES_MASK;
typedef uint DEPTH_KEY;
#define AS_DEPTH_KEY as_uint
#define AS_MASK as_int16
#define AS_LANES as_float16
#endif

#define R(value) ((REAL)(value))
#define TILE 16

// What one Gaussian is on the screen, RECORD values each:
//   0 1  centre in pixels
//   2    slope: how far the middle of a row moves right for each row down, cov_xy / cov_yy
//   3    precision across: of x where y is given, cov_yy / det
//   4    precision down: of y, 1 / cov_yy
//   5    opacity
//   6    reach: the squared Mahalanobis distance at which alpha falls to ALPHA_MINIMUM
//   7    depth
// In these terms the exponent is a sum of two squares, never positive and without cancellation however thin the
// Gaussian: power = -1/2 (precision_across (dx - slope dy)^2 + precision_down dy^2).
#define RECORD 8

// Slack on `reach` where pixels are only selected: what is drawn is decided by each pixel's alpha alone.
#define REACH_SLACK R(1e-3)

inline REAL sum_of_lanes(LANES lanes) {
    const REAL8 eight = lanes.lo + lanes.hi;
    const REAL4 four = eight.lo + eight.hi;
    const REAL2 two = four.lo + four.hi;
    return two.x + two.y;
}

// Whether the sign bit of any lane is set, as comparisons leave it.
inline int any_lane(LANES_MASK mask) {
#ifdef REAL_IS_DOUBLE
    const long8 eight = mask.lo | mask.hi;
    const long4 four = eight.lo | eight.hi;
    const long2 two = four.lo | four.hi;
#else
    const int8 eight = mask.lo | mask.hi;
    const int4 four = eight.lo | eight.hi;
    const int2 two = four.lo | four.hi;
#endif
    return (two.x | two.y) < 0;
}

// e^x for x <= 0 within two units in the last place: x = n ln 2 + r, a polynomial for e^r, n into the exponent's bits.
inline LANES exp_of_lanes(LANES x) {
#ifdef REAL_IS_DOUBLE
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer, which its low bits hold
    x = x < -700.0 ? (LANES)(-700.0) : x;
    const LANES shifted = x * 1.4426950408889634074 + shift;
    const LANES n = shifted - shift;
    const LANES r = (x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    LANES p = (LANES)(1.0 / 6227020800.0);
    p = p * r + 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    return AS_LANES(AS_MASK(p) + (AS_MASK(shifted) << (LANES_MASK)(52)));
#else
    const float shift = 12582912.0f;  // 1.5 * 2^23
    x = x < -86.0f ? (LANES)(-86.0f) : x;
    const LANES shifted = x * 1.44269504f + shift;
    const LANES n = shifted - shift;
    const LANES r = (x - n * 6.93145752e-1f) - n * 1.42860677e-6f;
    LANES p = (LANES)(1.0f / 720.0f);
    p = p * r + 1.0f / 120.0f;
    p = p * r + 1.0f / 24.0f;
    p = p * r + 1.0f / 6.0f;
    p = p * r + 0.5f;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    return AS_LANES(AS_MASK(p) + (AS_MASK(shifted) << (LANES_MASK)(23)));
#endif
}

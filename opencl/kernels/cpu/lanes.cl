// Vectors and memory hints for processors that run one work-item a core.
//
// A LANES value holds 16 pixels. Only operators are used on it: PoCL 3.0 links its built-in functions for another CPU
// than it compiles kernels for, and 16 wide built-ins then abort the process.

#ifdef REAL_IS_DOUBLE
typedef double16 LANES;
typedef long16 LANES_MASK;
#define AS_MASK as_long16
#define AS_LANES as_double16
#else
typedef float16 LANES;
typedef int16 LANES_MASK;
#define AS_MASK as_int16
#define AS_LANES as_float16
#endif

// Anywhere in an array of REAL.
typedef LANES __attribute__((aligned(sizeof(REAL)))) UNALIGNED_LANES;

// Fetches what a pointer leads to into the cache. Gaussians lie in memory in no order that tiles could use, and waiting for
// the memory would take longer than drawing them. PoCL's `prefetch` does nothing, so clang's own is asked for.
#ifdef POCL_DEVICE_ADDRESS_BITS
#define FETCH(pointer) __builtin_prefetch((const void *)(size_t)(pointer))
#else
#define FETCH(pointer)
#endif
#define FETCH_AHEAD 8

// Steps of sums_of_lanes: each adds halves, quarters ... of two values and leaves the sums of both in one.
inline LANES add_halves(LANES a, LANES b) { return (LANES)(a.lo, b.lo) + (LANES)(a.hi, b.hi); }

inline LANES add_quarters(LANES a, LANES b) {
    return (LANES)(a.s0123, a.s89ab, b.s0123, b.s89ab) + (LANES)(a.s4567, a.scdef, b.s4567, b.scdef);
}

inline LANES add_pairs(LANES a, LANES b) {
    return (LANES)(a.s01, b.s01, a.s45, b.s45, a.s89, b.s89, a.scd, b.scd)
        + (LANES)(a.s23, b.s23, a.s67, b.s67, a.sab, b.sab, a.sef, b.sef);
}

inline LANES add_neighbours(LANES a, LANES b) {
    return (LANES)(a.s02, b.s02, a.s46, b.s46, a.s8a, b.s8a, a.sce, b.sce)
        + (LANES)(a.s13, b.s13, a.s57, b.s57, a.s9b, b.s9b, a.sdf, b.sdf);
}

// The sums over the lanes of 16 values, in the order of the values: 15 steps for all of them together.
inline LANES sums_of_lanes(const LANES *v) {
    const LANES a = add_quarters(add_halves(v[0], v[4]), add_halves(v[8], v[12]));
    const LANES b = add_quarters(add_halves(v[1], v[5]), add_halves(v[9], v[13]));
    const LANES c = add_quarters(add_halves(v[2], v[6]), add_halves(v[10], v[14]));
    const LANES d = add_quarters(add_halves(v[3], v[7]), add_halves(v[11], v[15]));
    return add_neighbours(add_pairs(a, b), add_pairs(c, d));
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

// 2^x for x <= 0 within two units in the last place: x = n + r, a polynomial for 2^r, n into the exponent's bits.
inline LANES exp2_of_lanes(LANES x) {
#ifdef REAL_IS_DOUBLE
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer, which its low bits hold
    x = x < -1000.0 ? (LANES)(-1000.0) : x;
    const LANES shifted = x + shift;
    const LANES r = (x - (shifted - shift)) * 0.69314718055994530942;
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
    x = x < -120.0f ? (LANES)(-120.0f) : x;
    const LANES shifted = x + shift;
    const LANES r = x - (shifted - shift);
    LANES p = (LANES)(1.5403530394e-4f);  // ln(2)^k / k!
    p = p * r + 1.3333558146e-3f;
    p = p * r + 9.6181291076e-3f;
    p = p * r + 5.5504108665e-2f;
    p = p * r + 2.4022650696e-1f;
    p = p * r + 6.9314718056e-1f;
    p = p * r + 1.0f;
    return AS_LANES(AS_MASK(p) + (AS_MASK(shifted) << (LANES_MASK)(23)));
#endif
}

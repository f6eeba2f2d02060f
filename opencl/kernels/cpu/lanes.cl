// Vectors and memory hints for processors that run one work-item per core.
//
// A LANES value holds one number for each of 16 pixels, or 16 channels of one pixel. Use only operators on it: PoCL 3.0
// links built-in functions that were compiled for a different CPU than its kernels, and 16-wide ones then abort the
// process.

#ifdef REAL_IS_DOUBLE
typedef double8 REAL8;
typedef double16 LANES;
typedef long16 LANES_MASK;
typedef long LANES_INDEX;
#define AS_MASK as_long16
#define AS_LANES as_double16
#else
typedef float8 REAL8;
typedef float16 LANES;
typedef int16 LANES_MASK;
typedef int LANES_INDEX;
#define AS_MASK as_int16
#define AS_LANES as_float16
#endif

// A LANES value anywhere in an array of REAL.
typedef LANES __attribute__((aligned(sizeof(REAL)))) UNALIGNED_LANES;

// Expands step(k), step(k + 1), ... in place of a loop. An array stays in registers only if every index is a constant,
// and compilers decide that before they unroll loops.
#define EACH_1(step, k) step(k)
#define EACH_2(step, k) EACH_1(step, k) EACH_1(step, (k) + 1)
#define EACH_4(step, k) EACH_2(step, k) EACH_2(step, (k) + 2)
#define EACH_8(step, k) EACH_4(step, k) EACH_4(step, (k) + 4)
#define EACH_16(step, k) EACH_8(step, k) EACH_8(step, (k) + 8)

// FETCH prefetches the cache line at a pointer. A tile's Gaussians are scattered in memory, and waiting for them would
// take longer than drawing them. PoCL's `prefetch` does nothing, hence clang's builtin. STREAM stores to an aligned
// address past the caches, which saves reading the line first: for output too large to stay in the caches. FIRST_BIT is
// the index of the lowest set bit.
#ifdef POCL_DEVICE_ADDRESS_BITS
#define FETCH(pointer) __builtin_prefetch((const void *)(size_t)(pointer))
#define STREAM(pointer, lanes) __builtin_nontemporal_store(lanes, (__global LANES *)(pointer))
#define FIRST_BIT(bits) __builtin_ctzl(bits)
#else
#define FETCH(pointer)
#define STREAM(pointer, lanes) *(__global LANES *)(pointer) = lanes
#define FIRST_BIT(bits) (63 - (int)clz((bits) & -(bits)))
#endif
#define FETCH_AHEAD 10

// For functions of pointers to LANES: LLVM uses only half registers, unless an argument is as wide as a whole one.
#if defined(__has_attribute) && !defined(REAL_IS_DOUBLE)
#if __has_attribute(min_vector_width)
#define WHOLE_REGISTERS __attribute__((min_vector_width(512)))
#endif
#endif
#ifndef WHOLE_REGISTERS
#define WHOLE_REGISTERS
#endif

// Steps of `transpose`: interleave two values' even runs (0, 2 ...) of 8, 4, 2 or 1 lanes, or their odd ones.
static inline LANES even_8(LANES a, LANES b) {
    return (LANES)(a.s01234567, b.s01234567);
}
static inline LANES odd_8(LANES a, LANES b) {
    return (LANES)(a.s89abcdef, b.s89abcdef);
}
static inline LANES even_4(LANES a, LANES b) {
    return (LANES)(a.s0123, b.s0123, a.s89ab, b.s89ab);
}
static inline LANES odd_4(LANES a, LANES b) {
    return (LANES)(a.s4567, b.s4567, a.scdef, b.scdef);
}
static inline LANES even_2(LANES a, LANES b) {
    return (LANES)(a.s01, b.s01, a.s45, b.s45, a.s89, b.s89, a.scd, b.scd);
}
static inline LANES odd_2(LANES a, LANES b) {
    return (LANES)(a.s23, b.s23, a.s67, b.s67, a.sab, b.sab, a.sef, b.sef);
}
static inline LANES even_1(LANES a, LANES b) {
    return (LANES)(a.s0, b.s0, a.s2, b.s2, a.s4, b.s4, a.s6, b.s6, a.s8, b.s8, a.sa, b.sa, a.sc, b.sc, a.se, b.se);
}
static inline LANES odd_1(LANES a, LANES b) {
    return (LANES)(a.s1, b.s1, a.s3, b.s3, a.s5, b.s5, a.s7, b.s7, a.s9, b.s9, a.sb, b.sb, a.sd, b.sd, a.sf, b.sf);
}

#define EXCHANGE(run, i)                                                                        \
    {                                                                                           \
        const LANES even = even_##run(v[i], v[(i) + run]), odd = odd_##run(v[i], v[(i) + run]); \
        v[i] = even;                                                                            \
        v[(i) + run] = odd;                                                                     \
    }
#define EXCHANGE_8(i) EXCHANGE(8, i)
#define EXCHANGE_4(i) EXCHANGE(4, i)
#define EXCHANGE_2(i) EXCHANGE(2, i)
#define EXCHANGE_1(i) EXCHANGE(1, i)

// Transposes 16 values of 16 lanes: lane l of value v becomes lane v of value l.
WHOLE_REGISTERS static inline void transpose(LANES *v) {
    EACH_8(EXCHANGE_8, 0)
    EACH_4(EXCHANGE_4, 0) EACH_4(EXCHANGE_4, 8)
    EACH_2(EXCHANGE_2, 0) EACH_2(EXCHANGE_2, 4) EACH_2(EXCHANGE_2, 8) EACH_2(EXCHANGE_2, 12)
    EXCHANGE_1(0) EXCHANGE_1(2) EXCHANGE_1(4) EXCHANGE_1(6) EXCHANGE_1(8) EXCHANGE_1(10) EXCHANGE_1(12) EXCHANGE_1(14)
}

// Whether any lane of a comparison's result is true (has its sign bit set).
static inline int any_lane(LANES_MASK mask) {
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

// 2^x for x <= 0, within 2 ulp: splits x = n + r with integer n, evaluates a polynomial for 2^r, and adds n to the
// exponent bits.
static inline LANES exp2_of_lanes(LANES x) {
#ifdef REAL_IS_DOUBLE
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds x to an integer, kept in the low bits
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

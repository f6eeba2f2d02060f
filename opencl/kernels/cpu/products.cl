// Products of small matrices that fit into the cache.

typedef __global const UNALIGNED_LANES *LANES_IN;
typedef __global UNALIGNED_LANES *LANES_OUT;

// Rows of a product that are accumulated in registers at a time, one LANES value each: 16, or 4 if registers are half
// as wide and half as many.
#ifdef WIDE_REGISTERS
#define ROWS 16
#define EACH_ROW EACH_16
#else
#define ROWS 4
#define EACH_ROW EACH_4
#endif

// Computes ROWS rows of 16 values of a product: result[r] = sum over k of one[r][k] * other[k]. If `adds`, adds them to
// what `result` holds. There are `blocks` * `count` terms k: in `one`, blocks are `block_step` values apart, the terms
// of a block `step` and rows `row`; in `other`, terms are `other_step` apart; in `result`, rows are `result_row` apart.
WHOLE_REGISTERS static inline void multiply(
    int blocks,
    int count,
    __global const REAL *one,
    int block_step,
    int step,
    int row,
    __global const REAL *other,
    int other_step,
    __global REAL *result,
    int result_row,
    int adds
) {
    LANES sums[ROWS];
#define START(r) sums[r] = adds ? *(LANES_IN)(result + (r) * result_row) : (LANES)(0);
    EACH_ROW(START, 0)
    for (int block = 0; block < blocks; block++)
        for (int k = 0; k < count; k++) {
            __global const REAL *factors = one + block * block_step + k * step;
            const LANES values = *(LANES_IN)(other + (block * count + k) * other_step);
#define ADD(r) sums[r] += factors[(r) * row] * values;
            EACH_ROW(ADD, 0)
        }
#define KEEP(r) *(LANES_OUT)(result + (r) * result_row) = sums[r];
    EACH_ROW(KEEP, 0)
}

// Gaussians staged in local memory for a tile's work-group, in which each work-item is a pixel, row by row.

#ifdef REAL_IS_DOUBLE
typedef double4 REAL4;
#define EXP2 exp2
#else
typedef float4 REAL4;
#define EXP2 native_exp2
#endif

// A Gaussian's record and features as vectors of four, each read from local memory at once.
#define RECORD_QUARTETS (RECORD / 4)
#define FEATURE_QUARTETS ((FEATURE_DIM + 3) / 4)

// Stages the records of `here` entries in local memory: centres relative to the tile's corner, precisions scaled for
// exponents of base 2. The rest of the `places` is filled with Gaussians of opacity 0, which are never drawn.
static inline void stage_records(
    __global const REAL *records, __global const int *entries, int here, int places, Tile tile, __local REAL4 *staged
) {
    const int k = get_local_id(0) % RECORD;
    const REAL origin = k == 0 ? tile.left : k == 1 ? tile.top : 0;
    const REAL scale = k == 3 || k == 4 ? R(-0.72134752044448170368) : R(1);  // -1/2 log2(e)
    for (int i = get_local_id(0); i < places * RECORD; i += GROUP_SIZE)
        ((__local REAL *)staged)[i] =
            i < here * RECORD ? (records[(size_t)RECORD * entries[i / RECORD] + k] - origin) * scale : 0;
}

// Stages the features of the same entries, padded with zeros.
static inline void stage_features(
    __global const REAL *features, __global const int *entries, int here, int places, __local REAL4 *staged
) {
    for (int i = get_local_id(0); i < places * FEATURE_QUARTETS * 4; i += GROUP_SIZE) {
        const int n = i / (FEATURE_QUARTETS * 4), k = i % (FEATURE_QUARTETS * 4);
        ((__local REAL *)staged)[i] =
            n < here && k < FEATURE_DIM ? features[(size_t)FEATURE_DIM * entries[n] + k] : 0;
    }
}

// The two functions below decide which Gaussians a pixel shows, so they must give the same bits in `blend` and in
// `blend_backward`. They use fma wherever a compiler might contract a product and a sum in one kernel only.

// A Gaussian's alpha, before the clamp, at the pixel centre (x, y), relative to the tile's corner.
static inline REAL alpha_of(__local const REAL4 *staged, REAL x, REAL y) {
    const REAL4 place = staged[0], size = staged[1];  // centre, slope, precision across; precision down, opacity
    const REAL down = y - place.y, across = fma(-place.z, down, x - place.x);
    return EXP2(fma(across * across, place.w, size.x * down * down)) * size.y;
}

// The transmittance behind a Gaussian of this alpha, given the transmittance in front of it.
static inline REAL light_behind(REAL alpha, REAL transmittance) {
    return fma(-alpha, transmittance, transmittance);
}

// Number types and the record layout that the kernels share. REAL is float, or double if REAL_IS_DOUBLE is defined.

#ifdef REAL_IS_DOUBLE
typedef double REAL;
typedef ulong DEPTH_KEY;
#define AS_DEPTH_KEY as_ulong
#define LARGEST_REAL DBL_MAX
#else
typedef float REAL;
typedef uint DEPTH_KEY;
#define AS_DEPTH_KEY as_uint
#define LARGEST_REAL FLT_MAX
#endif

#define R(value) ((REAL)(value))
#define TILE 16

// A projected Gaussian is a record of RECORD values:
//   0 1  centre in pixels
//   2    slope: how far the Gaussian's midpoint within a row moves right per row down, cov_xy / cov_yy
//   3    precision across: of x given y, cov_yy / det
//   4    precision down: of y, 1 / cov_yy
//   5    opacity
//   6    reach: the squared Mahalanobis distance at which alpha falls to ALPHA_MINIMUM
//   7    depth
// This makes the exponent a sum of two squares, which is never positive and does not cancel, however thin the Gaussian:
// power = -1/2 (precision_across (dx - slope dy)^2 + precision_down dy^2).
#define RECORD 8

// Slack added to `reach` when preselecting tiles and blocks of pixels. It never changes the picture: each pixel's alpha
// alone decides what is drawn.
#define REACH_SLACK R(1e-3)

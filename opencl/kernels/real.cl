// Numbers and records that all kernels share. REAL is float, or double where REAL_IS_DOUBLE is defined.

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

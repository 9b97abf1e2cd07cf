/*
 * $title
 *
 * See $name.h. The equations are those of robust_filterpy.correction: for an innovation y = z - H x,
 *
 *     C = P H',  S = H C + R                   its covariance
 *     e = T y                                  standardized innovation
 *     x+ = x + C T' psi(e)                     bounded influence
 *     P+ = P - C T' D T C'                     information D between 0 and I
 *
 * Matrices are flat arrays, row by row. Nothing is allocated, nothing recurses, every loop is bounded, and a call that
 * does not return ${NAME}_OK has changed nothing.
 */
#include "$name.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "$name: a missing measurement is NaN, which -ffast-math takes away; compile without it"
#endif

typedef ${name}_real real;
typedef ${name}_model Model;
typedef ${name}_state State;
typedef ${name}_status Status;
typedef ${name}_sample Sample;

#define N $n /* length of the state */
#define M $m /* length of the measurement */

#define REAL(number) ((real)(number))
//? double
#define BIGGEST DBL_MAX
#define EPSILON DBL_EPSILON
#define SAFE 1e150 /* up to here a product with T does not overflow */
#define SQRT sqrt
#define FABS fabs
//? student_t
#define HYPOT hypot
//.
//.
//? single
#define BIGGEST FLT_MAX
#define EPSILON FLT_EPSILON
#define SAFE 1e18F /* up to here a product with T does not overflow */
#define SQRT sqrtf
#define FABS fabsf
//? student_t
#define HYPOT hypotf
//.
//.

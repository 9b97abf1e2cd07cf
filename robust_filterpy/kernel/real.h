/* The number type, and what every other header of the kernel relies on.

   Conventions. Matrices are stored by rows, without gaps. Sizes (n states, m sensors) are the first arguments and may
   be constants: a function that is SIZED is inlined, and then has the loops of its size. What is computed from comes
   before
   what is written; workspaces come from the caller, last, and for each function that wants one there is an
   <function>_work that says how many numbers (a macro, where that has to be a constant in what export_c writes).
   Nothing is allocated and nothing is remembered between calls. A function that can fail returns 1 where the step was
   ordinary and 0 where it was not; the caller's state is then as it was. */
#ifndef ROBUST_FILTERPY_REAL_H
#define ROBUST_FILTERPY_REAL_H

#include <float.h>
#include <math.h>
#include <stddef.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "NaN stands for a missing measurement: compile without -ffast-math and -ffinite-math-only"
#endif

#ifdef ROBUST_FILTERPY_FLOAT
typedef float real;
#define REAL_EPSILON FLT_EPSILON
#define REAL_MAX FLT_MAX
#define REAL_LARGE 1e30F    /* beyond this nothing is larger */
#define REAL_ORDINARY 1e15F /* beyond this a square overflows */
#define REAL_PRODUCT 1e12F  /* what a product of variances is kept below */
#define REAL_PIVOT 1e-5F    /* a variance that shrank to this part of itself is rounding */
#define REAL(number) number##F
#define real_sqrt sqrtf
#define real_abs fabsf
#define real_log logf
#define real_exp expf
#define real_hypot hypotf
#define real_copysign copysignf
#else
typedef double real;
#define REAL_EPSILON DBL_EPSILON
#define REAL_MAX DBL_MAX
#define REAL_LARGE 1e300
#define REAL_ORDINARY 1e150
#define REAL_PRODUCT 1e100
#define REAL_PIVOT 1e-13
#define REAL(number) number
#define real_sqrt sqrt
#define real_abs fabs
#define real_log log
#define real_exp exp
#define real_hypot hypot
#define real_copysign copysign
#endif

/* SIZED: always inlined, since its loops gain by a size that is a constant; INLINE: where the compiler thinks it pays.
   To inline everything into each of nine loops takes minutes and a gigabyte to compile, and gains nothing. */
#if defined(_MSC_VER) && !defined(__clang__)
#define INLINE static __inline
#define SIZED static __forceinline
#define RESTRICT __restrict
#elif defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((unused))
#ifdef __OPTIMIZE_SIZE__
#define SIZED INLINE
#else
#define SIZED static inline __attribute__((always_inline, unused))
#endif
#define RESTRICT __restrict__
#else
#define INLINE static inline
#define SIZED static inline
#define RESTRICT restrict
#endif

/* What is too long to be in every loop that calls it. */
#if defined(__GNUC__) || defined(__clang__)
#define CALLED static __attribute__((noinline, unused))
#else
#define CALLED static
#endif

INLINE real real_min(const real a, const real b) { return a < b ? a : b; }
INLINE real real_max(const real a, const real b) { return a > b ? a : b; }

/* A number no larger than most in size; NaN stays. */
INLINE real real_within(const real a, const real most) { return a > most ? most : a < -most ? -most : a; }

/* Whether a number is neither NaN nor infinite. */
INLINE int real_is_finite(const real a) { return real_abs(a) <= REAL_MAX; }

INLINE void real_copy(const int count, const real *RESTRICT from, real *RESTRICT to) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

INLINE real real_dot(const int count, const real *RESTRICT a, const real *RESTRICT b) {
    real total = 0;
    for (int i = 0; i < count; i++) total += a[i] * b[i];
    return total;
}

/* h P h'. */
INLINE real real_square(const int n, const real *RESTRICT h, const real *RESTRICT P) {
    real total = 0;
    for (int k = 0; k < n; k++)
        if (h[k] != 0) total += h[k] * real_dot(n, P + k * n, h);
    return total;
}

/* out (rows, columns) = A (rows, inner) B. */
SIZED void real_multiply(const int rows, const int inner, const int columns, const real *RESTRICT A,
                         const real *RESTRICT B, real *RESTRICT out) {
    for (int i = 0; i < rows; i++) {
        for (int j = 0; j < columns; j++) out[i * columns + j] = 0;
        for (int k = 0; k < inner; k++)
            for (int j = 0; j < columns; j++) out[i * columns + j] += A[i * inner + k] * B[k * columns + j];
    }
}

/* out (n, n) = A B', which is symmetric; A and B are (n, k). */
SIZED void real_multiply_symmetric(const int n, const int k, const real *RESTRICT A, const real *RESTRICT B,
                                   real *RESTRICT out) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) out[i * n + j] = out[j * n + i] = real_dot(k, A + i * k, B + j * k);
}

/* P -= d g g'; as d (g g'), since rounding would make (d g) g' unsymmetric. */
SIZED void real_shrink(const int n, const real d, const real *RESTRICT g, real *RESTRICT P) {
    for (int k = 0; k < n; k++) {
        const real gk = g[k];
        for (int j = 0; j < n; j++) P[k * n + j] -= d * (gk * g[j]);
    }
}

/* A vector of so many numbers in a workspace, and what is to point to it. */
typedef struct {
    real **place;
    int count;
} real_part;

/* Lay vectors out one behind another; return the workspace behind them. */
INLINE real *real_lay_out(const int count, const real_part *const parts, real *work) {
    for (int i = 0; i < count; work += parts[i].count, i++) *parts[i].place = work;
    return work;
}

INLINE void real_swap(real **const a, real **const b) {
    real *const first = *a;
    *a = *b;
    *b = first;
}

#endif

/* The nearest covariance where P has lost its sign in rounding: identification.recursive.conditioning.repaired in C. */
#ifndef ROBUST_FILTERPY_MEND_H
#define ROBUST_FILTERPY_MEND_H

#include "real.h"

#define MEND_SWEEPS 30 /* of Jacobi's rotations; enough but for what is not finite */
#define mend_work(n) (2 * (size_t)(n) * (size_t)(n))

/* Rotate rows or columns i and j of a matrix: their entries are `step` apart. */
INLINE void mend_rotate(const int n, real *A, const int i, const int j, const int step, const real c, const real s) {
    for (int k = 0; k < n; k++) {
        const real a = A[i + k * step], b = A[j + k * step];
        A[i + k * step] = c * a - s * b;
        A[j + k * step] = s * a + c * b;
    }
}

/* Bring a symmetric A to diagonal form by Jacobi's rotations, with its eigenvectors in the columns of V. */
CALLED void mend_diagonalize(const int n, real *A, real *V) {
    int rotated = 1;
    for (int i = 0; i < n * n; i++) V[i] = i % (n + 1) == 0 ? REAL(1.0) : REAL(0.0);
    for (int sweep = 0; sweep < MEND_SWEEPS && rotated; sweep++) {
        rotated = 0;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < i; j++) {
                const real off = A[i * n + j];
                const real bound = real_sqrt(real_abs(A[i * n + i])) * real_sqrt(real_abs(A[j * n + j]));
                if (real_abs(off) <= REAL(0.05) * REAL_EPSILON * bound) continue;
                /* tan of the angle that annihilates A_ij, of the two the smaller. */
                const real half = REAL(0.5) * (A[j * n + j] - A[i * n + i]) / off, far = real_abs(half);
                const real root = far < REAL_ORDINARY ? real_sqrt(half * half + 1) : far;
                const real t = real_copysign(1 / (far + root), half), c = 1 / real_sqrt(t * t + 1);
                mend_rotate(n, A, i, j, n, c, t * c);
                mend_rotate(n, A, i * n, j * n, 1, c, t * c);
                mend_rotate(n, V, i, j, n, c, t * c);
                A[i * n + j] = A[j * n + i] = 0;
                rotated = 1;
            }
    }
}

/* Write P = V D V', D on the diagonal of A but no less than `least`. */
CALLED void mend_compose(const int n, const real *A, const real *V, const real least, real *P) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real total = 0;
            for (int k = 0; k < n; k++) total += V[i * n + k] * real_max(A[k * n + k], least) * V[j * n + k];
            P[i * n + j] = P[j * n + i] = total;
        }
}

/* Put eigenvalues of P below rounding of the largest there, if any is less than minus that. work: mend_work. */
CALLED void mend(const int n, real *P, real *work) {
    real *const A = work, *const V = work + n * n, least = 0, bottom = 0;
    real_copy(n * n, P, A);
    mend_diagonalize(n, A, V);
    for (int i = 0; i < n; i++) {
        least = real_min(least, A[i * n + i]);
        bottom = real_max(bottom, A[i * n + i]);
    }
    bottom *= REAL_EPSILON;
    if (least < -bottom) mend_compose(n, A, V, bottom, P);
}

#endif

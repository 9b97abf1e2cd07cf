/* x = F x + B u and P = alpha^2 F P F' + Q (paper 27, 38, 43, 48). */
#ifndef ROBUST_FILTERPY_PREDICTION_H
#define ROBUST_FILTERPY_PREDICTION_H

#include "real.h"

/* Up to so many states sums of columns that stay in registers are fastest. */
#define PREDICTION_COLUMNS 8

#define predict_work(n) ((size_t)(n) * (size_t)(2 * (n)))

/* out = A B, four columns at a time, whose sums stay in registers. */
SIZED void predict_columns(const int n, const real *RESTRICT A, const real *RESTRICT B, real *RESTRICT out) {
    for (int i = 0; i < n; i++) {
        const real *RESTRICT row = A + i * n;
        int j = 0;
        for (; j + 4 <= n; j += 4) {
            real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
            for (int k = 0; k < n; k++) {
                const real a = row[k];
                const real *RESTRICT b = B + k * n + j;
                s0 += a * b[0];
                s1 += a * b[1];
                s2 += a * b[2];
                s3 += a * b[3];
            }
            out[i * n + j] = s0;
            out[i * n + j + 1] = s1;
            out[i * n + j + 2] = s2;
            out[i * n + j + 3] = s3;
        }
        for (; j < n; j++) {
            real s = 0;
            for (int k = 0; k < n; k++) s += row[k] * B[k * n + j];
            out[i * n + j] = s;
        }
    }
}

/* The same for more states than that, four rows of B at a time; lower: of each row the columns up to the diagonal. */
SIZED void predict_blocks(const int n, const real *RESTRICT A, const real *RESTRICT B, real *RESTRICT out,
                            const int lower) {
    for (int i = 0; i < n; i++) {
        /* A block beyond the diagonal: what is too much is written over. */
        const int up = (i + 4) / 4 * 4, top = lower && up < n ? up : n;
        real *RESTRICT row = out + i * n;
        int k = 0;
        for (int j = 0; j < top; j++) row[j] = 0;
        for (; k + 4 <= n; k += 4) {
            const real a0 = A[i * n + k], a1 = A[i * n + k + 1], a2 = A[i * n + k + 2], a3 = A[i * n + k + 3];
            const real *RESTRICT b0 = B + k * n, *RESTRICT b1 = b0 + n, *RESTRICT b2 = b1 + n, *RESTRICT b3 = b2 + n;
            for (int j = 0; j < top; j++) row[j] = row[j] + ((a0 * b0[j] + a1 * b1[j]) + (a2 * b2[j] + a3 * b3[j]));
        }
        for (; k < n; k++) {
            const real a = A[i * n + k];
            for (int j = 0; j < top; j++) row[j] += a * B[k * n + j];
        }
    }
}

/* Write x_next and P_next, which are none of the arguments; control is B u, or NULL. Return whether they are finite. */
SIZED int predict(const int n, const real *RESTRICT x, const real *RESTRICT P, const real *RESTRICT F,
                   const real *RESTRICT Q, const real *control, const real alpha_sq, real *RESTRICT x_next,
                   real *RESTRICT P_next, real *RESTRICT work) {
    real *RESTRICT W = work, *RESTRICT transposed = work + n * n;
    real check = 0;
    for (int i = 0; i < n; i++) {
        const real total = real_dot(n, F + i * n, x);
        x_next[i] = control ? total + control[i] : total;
    }
    if (n <= PREDICTION_COLUMNS) {
        predict_columns(n, F, P, W);
        real_multiply_symmetric(n, n, W, F, P_next);
    } else {
        for (int i = 0; i < n; i++)
            for (int k = 0; k < n; k++) transposed[k * n + i] = F[i * n + k];
        predict_blocks(n, F, P, W, 0);
        predict_blocks(n, W, transposed, P_next, 1);
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++)
            P_next[i * n + j] = P_next[j * n + i] = alpha_sq * P_next[i * n + j] + Q[i * n + j];
        /* What is not finite anywhere in F, P or Q shows on the diagonal. */
        check += real_abs(x_next[i]) + real_abs(P_next[i * n + i]);
    }
    return real_is_finite(check);
}

#endif

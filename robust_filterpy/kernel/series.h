/* Many series, each of many steps of prediction and correction. */
#ifndef ROBUST_FILTERPY_SERIES_H
#define ROBUST_FILTERPY_SERIES_H

#include "prediction.h"
#include "update.h"

/* Matrices of one kind: where those of a series and of a step begin, 0 apart where one serves all. */
typedef struct {
    const real *data;
    ptrdiff_t by_series, by_step;
} series_matrices;

typedef struct {
    ptrdiff_t steps, first_step;
    int n, m;
    series_matrices z, F, Q, H, R, control; /* control: B u, data NULL for none */
    correction_rule rule;
    real alpha_sq;
    int update_first;     /* a step begins with its correction */
    ptrdiff_t every;      /* of so many steps one is kept */
    ptrdiff_t rows;       /* kept steps of a series */
    int covariance_width; /* n n: covariances are kept whole, n: their diagonals, 0: not at all */
    real *x, *P;          /* (series, n), (series, n, n): go in and come out */
    spread_memory *memory; /* (series, m): goes in and comes out; NULL but under SCALING_LEARNT */
    real *means, *covariances, *means_p, *covariances_p, *weights; /* (series, rows, ..) or NULL */
    real *log_likelihood;                                          /* (series) */
    ptrdiff_t *done;                                               /* (series) first step that was not taken */
} series_job;

SIZED size_t series_work(const int n, const int m) {
    return (size_t)(3 * n * (n + 1)) + predict_work(n) + update_work(n, m) + (size_t)(SPREAD_NUMBERS * m);
}

/* Keep a mean, and a covariance whole, its diagonal, or nothing. */
SIZED void series_keep(const int n, const int width, const ptrdiff_t row, const real *x, const real *P, real *means,
                        real *covariances) {
    if (means) real_copy(n, x, means + row * n);
    if (!covariances) return;
    if (width == n * n) real_copy(n * n, P, covariances + row * width);
    else
        for (int i = 0; i < width; i++) covariances[row * width + i] = P[i * n + i];
}

/* Take the steps of series low to high - 1. */
SIZED void series_span(const int n, const int m, const series_job *const job, const ptrdiff_t low,
                        const ptrdiff_t high, real *RESTRICT work) {
    const correction_rule rule = job->rule;
    real *buffer = work + 3 * n * (n + 1), *spare = buffer + predict_work(n);
    spread_memory *const before = (spread_memory *)(spare + update_work(n, m));
    for (ptrdiff_t s = low; s < high; s++) {
        const real *z = job->z.data + s * job->z.by_series + job->first_step * job->z.by_step;
        const real *F = job->F.data + s * job->F.by_series + job->first_step * job->F.by_step;
        const real *Q = job->Q.data + s * job->Q.by_series + job->first_step * job->Q.by_step;
        const real *H = job->H.data + s * job->H.by_series + job->first_step * job->H.by_step;
        const real *R = job->R.data + s * job->R.by_series + job->first_step * job->R.by_step;
        const real *u = job->control.data;
        /* The state before a step, which stays until the step has succeeded; what it is made into; what that is. */
        real *x = work, *P = x + n, *x_next = P + n * n, *P_next = x_next + n, *x_last = P_next + n * n;
        real *P_last = x_last + n;
        spread_memory *const memory = job->memory ? job->memory + s * m : NULL;
        correction c;
        real total = 0;
        ptrdiff_t k = job->first_step, row = s * job->rows + k / job->every, until = job->every - k % job->every;
        if (u) u += s * job->control.by_series + k * job->control.by_step;
        real_copy(n, job->x + s * n, x);
        real_copy(n * n, job->P + s * n * n, P);
        correction_begin(n, m, 0, &c, spare);
        for (; k < job->steps; k++) {
            const int kept = --until == 0;
            const real loss = c.loss, product = c.product;
            int fine = 1;
            for (int i = 0; memory && i < m; i++) before[i] = memory[i];
            if (job->update_first) {
                real_copy(n, x, x_next);
                real_copy(n * n, P, P_next);
            } else {
                fine = predict(n, x, P, F, Q, u, job->alpha_sq, x_next, P_next, buffer);
                if (fine && kept)
                    series_keep(n, job->covariance_width, row, x_next, P_next, job->means_p, job->covariances_p);
            }
            fine = fine && update(n, m, &rule, z, z, H, R, NULL, memory, x_next, P_next, &c, NULL, spare);
            if (fine && job->update_first)
                fine = predict(n, x_next, P_next, F, Q, u, job->alpha_sq, x_last, P_last, buffer);
            if (!fine) {
                c.loss = loss, c.product = product;
                for (int i = 0; memory && i < m; i++) memory[i] = before[i];
                break;
            }
            total += (real)c.observed;
            if (kept) {
                series_keep(n, job->covariance_width, row, x_next, P_next, job->means, job->covariances);
                if (job->update_first)
                    series_keep(n, job->covariance_width, row, x_last, P_last, job->means_p, job->covariances_p);
                if (job->weights) real_copy(m, c.weights, job->weights + row * m);
                until = job->every, row++;
            }
            if (job->update_first) {
                real_swap(&x, &x_last), real_swap(&P, &P_last);
            } else {
                real_swap(&x, &x_next), real_swap(&P, &P_next);
            }
            z += job->z.by_step, F += job->F.by_step, Q += job->Q.by_step, H += job->H.by_step, R += job->R.by_step;
            if (u) u += job->control.by_step;
        }
        job->done[s] = k;
        job->log_likelihood[s] += -c.loss - REAL(0.5) * real_log(c.product) - total * rule.normalizer;
        real_copy(n, x, job->x + s * n);
        real_copy(n * n, P, job->P + s * n * n);
    }
}

#endif

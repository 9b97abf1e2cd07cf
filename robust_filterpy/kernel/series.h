/* Many series, each of many steps of prediction and correction, by psi or under a mixture. */
#ifndef ROBUST_FILTERPY_SERIES_H
#define ROBUST_FILTERPY_SERIES_H

#include "learnt.h"

/* Matrices of one kind: where those of a series and of a step begin, 0 apart where one serves all; no data: none. */
typedef struct {
    const real *data;
    ptrdiff_t by_series, by_step;
} series_matrices;

/* The numbers of a series and a step. */
SIZED const real *series_at(const series_matrices *const of, const ptrdiff_t s, const ptrdiff_t k) {
    return of->data ? of->data + s * of->by_series + k * of->by_step : NULL;
}

enum series_half { SERIES_PREDICTS = 1, SERIES_CORRECTS = 2 };

typedef struct {
    ptrdiff_t first, last;
    ptrdiff_t every, rows; /* of so many steps one is kept, so many of a series */
    int n, m;
    series_matrices z, readings, F, Q, H, R, control, M; /* readings: as in learnt_correct; control: B u */
    int mixes;
    correction_rule bounded;
    learnt_rule mixture;
    real alpha_sq;
    int update_first; /* a step begins with its correction */
    int which;        /* enum series_half, or both */
    int width;        /* n n: covariances are kept whole, n: their diagonals, 0: not at all */
    real *x, *P;      /* (series, n), (series, n, n): go in and come out; likewise, so many numbers of a series, */
    real *moving[4];  /* memory of the sensors and, under a mixture, x, P and p of the models */
    int sizes[4];
    real *means, *covariances, *means_p, *covariances_p, *weights, *outlying, *scale; /* (series, rows, ..) or NULL */
    real *log_likelihood; /* (series) */
    ptrdiff_t *done;      /* (series) first step that was not taken */
} series_job;

INLINE size_t series_work(const int n, const int m, const series_job *const job) {
    size_t moving = 0, step = predict_work(n) + update_work(n, m);
    for (int a = 0; a < 4; a++) moving += (size_t)job->sizes[a];
    if (job->mixes) {
        const int models = learnt_models(&job->mixture);
        step = learnt_correct_work(n, m, models, job->mixture.K) + learnt_predict_work(n, models);
    }
    return (size_t)(2 * n * (n + 1) + 2 * m) + moving + step;
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
SIZED void series_span(const int n, const int m, const int mixes, const series_job *const job, const ptrdiff_t low,
                        const ptrdiff_t high, real *RESTRICT work) {
    const correction_rule bounded = job->bounded;
    const learnt_rule mixture = job->mixture;
    const int kinds = mixes ? 4 : 1; /* of what moves besides x and P */
    /* What was before a step, or before the second half of one. */
    real *const x_last = work, *const P_last = x_last + n, *const x_half = P_last + n * n, *const P_half = x_half + n;
    real *const weights = P_half + n * n, *const outlying = weights + m, *const last = outlying + m, *spare = last;
    for (int a = 0; a < 4; a++) spare += job->sizes[a];
    for (ptrdiff_t s = low; s < high; s++) {
        real *const x = job->x + s * n, *const P = job->P + s * n * n, *moving[4], gained = 0, observed = 0;
        ptrdiff_t k = job->first, row = s * job->rows + k / job->every, until = job->every - k % job->every;
        correction c;
        for (int a = 0; a < 4; a++) moving[a] = job->moving[a] ? job->moving[a] + s * job->sizes[a] : NULL;
        learnt_state models = {moving[1], moving[2], moving[3], moving[0]};
        correction_begin(n, m, 0, &c, spare);
        for (; k < job->last; k++) {
            const real *const z = series_at(&job->z, s, k), *const H = series_at(&job->H, s, k);
            const real *const R = series_at(&job->R, s, k), *const M = series_at(&job->M, s, k);
            const real loss = c.loss, product = c.product;
            real likelihood = 0, *before = last;
            const int kept = --until == 0;
            int fine = 1;
            real_copy(n, x, x_last), real_copy(n * n, P, P_last);
            for (int a = 0; a < kinds; before += job->sizes[a], a++) real_copy(job->sizes[a], moving[a], before);
            for (int half = 0; half < 2 && fine; half++) {
                const int corrects = (half == 0) == job->update_first;
                const real *const F = series_at(&job->F, s, k), *const Q = series_at(&job->Q, s, k);
                const real *const control = series_at(&job->control, s, k);
                if (!(job->which & (corrects ? SERIES_CORRECTS : SERIES_PREDICTS))) continue;
                if (mixes && corrects) {
                    fine = learnt_correct(n, m, &mixture, &models, z, series_at(&job->readings, s, k), H, R, M, weights,
                                          outlying, &likelihood, spare) >= 0;
                } else if (mixes) {
                    learnt_predict(n, &mixture, &models, F, Q, control, job->alpha_sq, spare);
                } else if (corrects) {
                    fine = update(n, m, &bounded, z, z, H, R, M, (spread_memory *)moving[0], x, P, &c, NULL, spare);
                } else {
                    if (half == 1) real_copy(n, x, x_half), real_copy(n * n, P, P_half);
                    fine = predict(n, half ? x_half : x_last, half ? P_half : P_last, F, Q, control, job->alpha_sq,
                                   x, P, spare + update_work(n, m));
                }
                if (mixes) fine = fine && learnt_merge(n, &mixture, &models, x, P, spare);
                if (fine && kept)
                    series_keep(n, job->width, row, x, P, corrects ? job->means : job->means_p,
                                corrects ? job->covariances : job->covariances_p);
            }
            if (!fine) {
                real_copy(n, x_last, x), real_copy(n * n, P_last, P);
                before = last;
                for (int a = 0; a < kinds; before += job->sizes[a], a++) real_copy(job->sizes[a], before, moving[a]);
                c.loss = loss, c.product = product;
                break;
            }
            gained += likelihood;
            if (!mixes) observed += (real)c.observed;
            if (!kept) continue;
            if (job->which & SERIES_CORRECTS) {
                if (job->weights) real_copy(m, mixes ? weights : c.weights, job->weights + row * m);
                if (job->outlying) real_copy(m, outlying, job->outlying + row * m);
            }
            for (int i = 0; mixes && job->scale && i < n; i++) {
                real slow = 0, total = 0;
                for (int q = 0; q < mixture.q; q++) {
                    slow += models.p[q * n + i], total += models.p[q * n + i] * mixture.process[q];
                }
                if (learnt_gives(&mixture)) total *= learnt_given(n, &mixture, &models, LEARNT_FACTOR)[i];
                job->scale[row * n + i] = total / slow;
            }
            until = job->every, row++;
        }
        job->done[s] = k;
        if (!mixes) gained = -c.loss - REAL(0.5) * real_log(c.product) - observed * bounded.normalizer;
        job->log_likelihood[s] += gained;
    }
}

#endif

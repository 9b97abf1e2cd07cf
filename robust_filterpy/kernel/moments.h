/* A correction by an innovation that is not z - H x: that of a nonlinear sensor. */
#ifndef ROBUST_FILTERPY_MOMENTS_H
#define ROBUST_FILTERPY_MOMENTS_H

#include "update.h"

#define update_moments_work(n, m) (update_work(n, m) + (size_t)((m) * (m) + (m) * (n) + (m)))

/* Correct x and P in place, x a state at 0, by an innovation y (m), NaN where missing; z (m) are its readings, R is
   what of S is noise. H (m, n) is the Jacobian; or NULL, and then c holds C and S, and a jump that makes P grow is for
   the definition. Return whether all was ordinary. memory as in update. work: update_moments_work, of which c took
   the beginning; after update_work it holds S (m, m), C (m, n) and y (m) as a filter shows them. */
INLINE int update_moments(const int n, const int m, const correction_rule *const rule, const real *RESTRICT z,
                          const real *RESTRICT y, const real *RESTRICT H, const real *RESTRICT R,
                          spread_memory *const memory, real *RESTRICT x, real *RESTRICT P, correction *const c,
                          real *work) {
    real *spread = work + correction_work(n, m), *rest = spread + m;
    real *RESTRICT S = work + update_work(n, m), *RESTRICT shown = S + m * m + m * n, check = 0;
    spread_memory *const learnt = (spread_memory *)rest;
    spread_change change = {NULL, NULL, NULL, NULL, NULL, 0, 0};
    c->observed = 0;
    for (int i = 0; i < m; i++) {
        const int seen = y[i] == y[i];
        shown[i] = c->y[i] = seen ? y[i] : 0;
        c->left[i] = seen ? REAL(1.0) : REAL(0.0);
        c->observed += seen;
        check += c->y[i] - c->y[i];
    }
    if (c->observed == 0 || check != 0) return 0;
    if (H) (void)innovate(n, m, y, x, P, H, R, NULL, c);
    real_copy(m * m, c->S, S);
    real_copy(m * n, c->C, S + m * m);
    if (rule->scaling != SCALING_LEARNT) {
        if (!correct_grouped(n, m, rule, NULL, x, P, c)) return 0;
        return rule->scaling != SCALING_UNIT || update_is_positive(n, P, rest);
    }
    for (int i = 0; i < m; i++) {
        learnt[i] = memory[i];
        if (c->left[i] != 0 && !(S[i * m + i] > 0)) return 0;
    }
    spread_before(n, m, z, P, R, c, learnt, &change, rest + SPREAD_NUMBERS * m);
    if (change.grows) {
        if (!H) return 0;
        spread_open(n, m, H, &change, P, rest + SPREAD_NUMBERS * m + spread_work(n, m));
        (void)innovate(n, m, y, x, P, H, R, NULL, c);
        spread_leave_out(m, &change, c);
        real_copy(m * m, c->S, S);
        real_copy(m * n, c->C, S + m * m);
    }
    for (int i = 0; i < m; i++) {
        c->S[i * m + i] += change.charge[i];
        spread[i] = change.width[i] / real_sqrt(c->S[i * m + i]);
    }
    if (!correct_grouped(n, m, rule, spread, x, P, c)) return 0;
    for (int i = 0; i < m; i++) {
        real known = S[i * m + i] - R[i * m + i];
        if (c->weights[i] != c->weights[i]) continue;
        learnt[i].rest = shown[i];
        for (int k = 0; k < m; k++) learnt[i].rest -= (S[i * m + k] - R[i * m + k]) * c->v[k];
        for (int k = 0; !H && k < m; k++) {
            /* What the k-th of those taken took of what sensor i sees. */
            real taken = 0;
            for (int j = 0; j < m; j++) taken += c->W[k * m + j] * (S[i * m + j] - R[i * m + j]);
            known -= c->d[k] * taken * taken * (rule->joint ? 1 : c->t[k] * c->t[k]);
        }
        if (H) known = spread_known(n, H + i * n, P);
        learnt[i].left = spread_ratio(known, R[i * m + i], change.told[i] * change.told[i]);
    }
    spread_weigh(m, &change, c);
    for (int i = 0; i < m; i++) memory[i] = learnt[i];
    return 1;
}

#endif

/* A correction by an innovation of which the moments are known and no H: that of a nonlinear sensor. */
#ifndef ROBUST_FILTERPY_MOMENTS_H
#define ROBUST_FILTERPY_MOMENTS_H

#include "update.h"

/* Correct x and P in place by an innovation: c holds y, C, S and left, z are the readings, R is what of S is noise. A jump that makes P grow
   is for the definition; return whether all was ordinary. shown: written, S (m, m), C (m, n) and y (m) as told. memory and
   work as in update. */
INLINE int update_moments(const int n, const int m, const correction_rule *const rule, const real *RESTRICT z,
                          const real *RESTRICT R, spread_memory *const memory, real *RESTRICT x, real *RESTRICT P, correction *const c,
                          real *shown, real *work) {
    real *spread = work + correction_work(n, m), *rest = spread + m;
    spread_memory *const learnt = (spread_memory *)rest;
    spread_change change = {NULL, NULL, NULL, 0, 0};
    real *RESTRICT S = shown, *RESTRICT y = shown + m * m + m * n;
    real_copy(m * m, c->S, S);
    real_copy(m * n, c->C, shown + m * m);
    real_copy(m, c->y, y);
    if (rule->scaling != SCALING_LEARNT) {
        if (!correct_grouped(n, m, rule, NULL, x, P, c)) return 0;
        return rule->scaling != SCALING_UNIT || update_is_positive(n, P, rest);
    }
    for (int i = 0; i < m; i++) {
        learnt[i] = memory[i];
        if (c->left[i] != 0 && !(S[i * m + i] > 0)) return 0;
    }
    spread_before(n, m, z, P, R, c, learnt, &change, rest + SPREAD_NUMBERS * m);
    if (change.grows) return 0;
    for (int i = 0; i < m; i++) {
        c->S[i * m + i] += change.charge[i];
        spread[i] = change.width[i] / real_sqrt(c->S[i * m + i]);
    }
    if (!correct_grouped(n, m, rule, spread, x, P, c)) return 0;
    for (int i = 0; i < m; i++) {
        if (c->weights[i] != c->weights[i]) continue;
        learnt[i].rest = y[i];
        for (int k = 0; k < m; k++) learnt[i].rest -= (S[i * m + k] - R[i * m + k]) * c->v[k];
    }
    for (int i = 0; i < m; i++) memory[i] = learnt[i];
    return 1;
}

#endif

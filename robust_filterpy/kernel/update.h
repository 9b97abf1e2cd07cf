/* A measurement taken up whole: innovation, what its sensors usually do, correction. */
#ifndef ROBUST_FILTERPY_UPDATE_H
#define ROBUST_FILTERPY_UPDATE_H

#include "joint.h"
#include "spread.h"

#ifndef ROBUST_FILTERPY_JOINT_H
/* What export_c writes for sensors that each fail on their own does without that header. */
#define correct_grouped correct
#endif

#define update_work(n, m) \
    (correction_work(n, m) + spread_work(n, m) + (size_t)((m) + SPREAD_NUMBERS * (m) + (n) * ((n) + 1)))

/* Whether P is positive definite beyond rounding, but for states that are known exactly; L (n, n) is scratch. */
CALLED int update_is_positive(const int n, const real *RESTRICT P, real *RESTRICT L) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real total = P[i * n + j];
            for (int k = 0; k < j; k++) total -= L[i * n + k] * L[j * n + k];
            L[i * n + j] = 0;
            if (P[i * n + i] == 0 || P[j * n + j] == 0) {
                if (P[i * n + j] != 0) return 0;
            } else if (i != j) {
                L[i * n + j] = total / L[j * n + j];
            } else if (total > REAL_PIVOT * P[i * n + i]) {
                L[i * n + i] = real_sqrt(total);
            } else {
                return 0;
            }
        }
    return 1;
}

/* Correct x and P in place by z (m), NaN where missing. memory (m) is what the sensors' spreads are learned from, under
   SCALING_LEARNT; M (n, m) or NULL. Return whether all was ordinary: if not, what x and P now hold is of no use, and
   memory is as it was. shown: NULL, or room for S (m, m) and C (m, n) as the filter shows them, those of a P that may
   have grown, without what a sensor is charged. work: update_work, of which c took the beginning. */
SIZED int update(const int n, const int m, const correction_rule *const rule, const real *RESTRICT z,
                  const real *RESTRICT H, const real *RESTRICT R, const real *M, spread_memory *const memory,
                  real *RESTRICT x, real *RESTRICT P, correction *const c, real *shown, real *work) {
    real *spread = work + correction_work(n, m), *rest = spread + m;
    spread_memory *const learnt = (spread_memory *)rest;
    spread_change change = {NULL, NULL, NULL, NULL, NULL, 0, 0};
    if (!innovate(n, m, z, x, P, H, R, M, c)) return 0;
    if (rule->scaling == SCALING_LEARNT) {
        for (int i = 0; i < m; i++) {
            learnt[i] = memory[i];
            if (c->left[i] != 0 && !(c->S[i * m + i] > 0)) return 0;
        }
        spread_before(n, m, z, P, R, c, learnt, &change, rest + SPREAD_NUMBERS * m);
        if (change.grows) {
            spread_open(n, m, H, &change, P, rest + SPREAD_NUMBERS * m + spread_work(n, m));
            if (!innovate(n, m, z, x, P, H, R, M, c)) return 0;
            spread_leave_out(m, &change, c);
        }
    }
    if (shown) {
        real_copy(m * m, c->S, shown);
        real_copy(m * n, c->C, shown + m * m);
    }
    if (rule->scaling != SCALING_LEARNT) {
        if (!correct_grouped(n, m, rule, NULL, x, P, c)) return 0;
        /* "unit" takes off more than there is where H P H' > 1. */
        return rule->scaling != SCALING_UNIT || update_is_positive(n, P, rest);
    }
    for (int i = 0; i < m; i++) {
        c->S[i * m + i] += change.charge[i];
        spread[i] = change.width[i] / real_sqrt(c->S[i * m + i]);
    }
    if (!correct_grouped(n, m, rule, spread, x, P, c)) return 0;
    spread_after(n, m, z, H, R, x, P, c, &change, learnt);
    /* What is not noise of y includes its noise's part in the state, which is not in H x. */
    if (M)
        for (int i = 0; i < m; i++)
            for (int j = 0; c->weights[i] == c->weights[i] && j < m; j++)
                for (int k = 0; k < n; k++) learnt[i].rest -= M[k * m + i] * H[j * n + k] * c->v[j];
    spread_weigh(m, &change, c);
    for (int i = 0; i < m; i++) memory[i] = learnt[i];
    return 1;
}

#endif

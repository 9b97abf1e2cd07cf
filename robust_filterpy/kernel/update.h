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

/* Whether every pivot of a symmetric P is more than this part of its diagonal: REAL_PIVOT for one that is positive
   definite beyond rounding; below 0: whether none is negative. L (n, n) is scratch. */
CALLED int update_is_positive(const int n, const real *RESTRICT P, const real part, real *RESTRICT L) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            real total = P[i * n + j];
            for (int k = 0; k < j; k++) total -= L[i * n + k] * L[j * n + k];
            if (i == j) {
                if (!(total >= 0 && real_is_finite(total)) || (part >= 0 && !(total > part * P[i * n + i]))) return 0;
                L[i * n + i] = real_sqrt(total);
            } else {
                if (L[j * n + j] == 0 && total != 0) return 0;
                L[i * n + j] = total == 0 ? 0 : total / L[j * n + j];
            }
        }
    return 1;
}

/* Take an innovation y as it is, where c holds C and S; whether it is finite. */
CALLED int update_take(const int m, const real *RESTRICT y, correction *const c) {
    real check = 0;
    c->observed = 0;
    for (int i = 0; i < m; i++) {
        const int seen = y[i] == y[i];
        c->y[i] = seen ? y[i] : 0;
        c->left[i] = seen ? REAL(1.0) : REAL(0.0);
        c->observed += seen;
        check += c->y[i] - c->y[i];
    }
    return check == 0;
}

/* spread_after where only moments are known; S (m, m) is that of before, y the innovation. */
CALLED void update_after(const int m, const correction_rule *const rule, const real *RESTRICT y, const real *RESTRICT S,
                         const real *RESTRICT R, const correction *const c, const spread_change *const change,
                         spread_memory *const memory) {
    for (int i = 0; i < m; i++) {
        real seen = S[i * m + i] - R[i * m + i], rest = y[i];
        if (c->weights[i] != c->weights[i]) continue;
        for (int k = 0; k < m; k++) {
            /* What the k-th of those taken took of what sensor i sees. */
            real taken = 0;
            rest -= (S[i * m + k] - R[i * m + k]) * c->v[k];
            for (int j = 0; j < m; j++) taken += c->W[k * m + j] * (S[i * m + j] - R[i * m + j]);
            seen -= c->d[k] * taken * taken * (rule->joint ? 1 : c->t[k] * c->t[k]);
        }
        memory[i].rest = rest;
        memory[i].left = spread_ratio(seen, R[i * m + i], change->nominal[i] * change->nominal[i]);
    }
}

/* Correct x and P in place by readings z (m), NaN where missing, of which y is compared with H x: z itself, or the
   innovation of a nonlinear sensor, H then being its Jacobian and x a state at 0; or H is NULL, and then c holds C and
   S of the innovation, and a jump that makes P grow is for the definition. memory (m) is what the sensors' spreads are
   learned from, under SCALING_LEARNT; M (n, m) or NULL. Return whether all was ordinary: if not, what x and P now hold
   is of no use, and memory is as it was. shown: NULL, or room for S (m, m) and C (m, n) as the filter shows them, those
   of a P that may have grown, without what is added to R; not NULL without H. work: update_work, of which c took the
   beginning. */
SIZED int update(const int n, const int m, const correction_rule *const rule, const real *RESTRICT z, const real *y,
                  const real *RESTRICT H, const real *RESTRICT R, const real *M, spread_memory *const memory,
                  real *RESTRICT x, real *RESTRICT P, correction *const c, real *shown, real *work) {
    real *spread = work + correction_work(n, m), *rest = spread + m;
    spread_memory *const learnt = (spread_memory *)rest;
    spread_change change = {NULL, NULL, NULL, NULL, NULL, 0};
    const int learns = rule->scaling == SCALING_LEARNT;
    if (H ? !innovate(n, m, y, x, P, H, R, M, c) : !update_take(m, y, c)) return 0;
    if (learns) {
        for (int i = 0; i < m; i++) {
            learnt[i] = memory[i];
            if (c->left[i] != 0 && !(c->S[i * m + i] > 0)) return 0;
        }
        spread_before(n, m, rule->patience, z, P, R, c, learnt, &change, rest + SPREAD_NUMBERS * m);
        if (change.grows) {
            if (!H) return 0;
            spread_open(n, m, H, &change, P, rest + SPREAD_NUMBERS * m + spread_work(n, m));
            if (!innovate(n, m, y, x, P, H, R, M, c)) return 0;
            spread_leave_out(m, &change, c);
        }
    }
    if (shown) {
        real_copy(m * m, c->S, shown);
        real_copy(m * n, c->C, shown + m * m);
    }
    if (!learns) {
        if (!correct_grouped(n, m, rule, NULL, x, P, c)) return 0;
        /* "unit" takes off more than there is where H P H' > 1. */
        return rule->scaling != SCALING_UNIT || update_is_positive(n, P, REAL_PIVOT, rest);
    }
    for (int i = 0; i < m; i++) {
        c->S[i * m + i] += change.added[i];
        spread[i] = change.width[i] / real_sqrt(c->S[i * m + i]);
    }
    if (!correct_grouped(n, m, rule, spread, x, P, c)) return 0;
    if (H) spread_after(n, m, y, H, R, x, P, c, &change, learnt);
    else update_after(m, rule, y, shown, R, c, &change, learnt);
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

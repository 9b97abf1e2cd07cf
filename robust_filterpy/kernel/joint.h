/* The correction where all sensors fail together: robust_filterpy.correction.definition, grouping "joint", in C.

   Nothing has to be chosen, since there is one group: its innovation is whitened by S, turned so that all of its length
   is in the first place, and only that place is bounded. The others are 0 and pass as far as the first does. */
#ifndef ROBUST_FILTERPY_JOINT_H
#define ROBUST_FILTERPY_JOINT_H

#include "correction.h"

#define JOINT_UNSEEN REAL(1e-12) /* below this correlation with every state a sensor is one the state has no part in */

/* Whether sensor i tells something of a state. */
INLINE int joint_sees(const int n, const int i, const real *RESTRICT P, const correction *const c) {
    const real unseen = JOINT_UNSEEN * real_sqrt(c->first[i]);
    for (int k = 0; k < n; k++)
        if (real_abs(c->C[i * n + k]) > unseen * real_sqrt(real_max(P[k * n + k], 0))) return 1;
    return 0;
}

/* Judge a sensor that tells nothing of the state: on its own, since it would only lengthen the others' innovation. Return
   whether it tells nothing of the others either. */
INLINE int joint_leave(const int m, const int i, const correction_rule *const rule, const real s, correction *const c) {
    const real unseen = JOINT_UNSEEN * real_sqrt(c->first[i]);
    real slope;
    for (int j = 0; j < m; j++)
        if (j != i && c->left[j] != 0 &&
            real_abs(c->S[i * m + j]) > unseen * real_sqrt(c->S[j * m + j])) return 0;
    const real e = c->y[i] / real_sqrt(c->first[i]), moved = correction_bound(&rule->psi, e, s, &slope);
    if (!real_is_finite(e)) return 0;
    c->left[i] = 0;
    c->e[i] = e;
    c->slopes[i] = slope;
    c->weights[i] = moved == e ? 1 : moved / e;
    c->d[i] = correction_information(rule, slope, c->weights[i]);
    if (c->v) c->v[i] = moved / real_sqrt(c->first[i]);
    correction_gather(c, psi_rho(&rule->psi, e), c->first[i]);
    return 1;
}

/* a = cosine a + sine b, b = cosine b - sine a, of vectors. */
INLINE void joint_turn(const int count, const real cosine, const real sine, real *RESTRICT a, real *RESTRICT b) {
    for (int k = 0; k < count; k++) {
        const real first = cosine * a[k] + sine * b[k];
        b[k] = cosine * b[k] - sine * a[k];
        a[k] = first;
    }
}

/* Whiten what was observed: e, and the rows of C, of S and (where somebody asks) of W that belong to it. Gather log det S.
   Return whether nothing canceled. */
INLINE int joint_whiten(const int n, const int m, correction *const c) {
    real *RESTRICT C = c->C, *RESTRICT S = c->S, *RESTRICT W = c->W;
    for (int i = 0; i < m; i++) {
        if (c->left[i] == 0) continue;
        const real variance = S[i * m + i];
        if (!(variance > REAL_PIVOT * c->first[i])) return 0;
        const real t = 1 / real_sqrt(variance);
        correction_gather(c, 0, variance);
        c->e[i] = t * c->y[i];
        if (!real_is_finite(c->e[i])) return 0;
        for (int k = 0; k < n; k++) C[i * n + k] *= t;
        for (int k = 0; k < m; k++) S[i * m + k] *= t;
        for (int k = 0; W && k < m; k++) W[i * m + k] *= t;
        for (int j = i + 1; j < m; j++) {
            if (c->left[j] == 0) continue;
            const real q = S[i * m + j];
            c->y[j] -= q * c->e[i];
            for (int k = 0; k < n; k++) C[j * n + k] -= q * C[i * n + k];
            for (int k = i + 1; k < m; k++) S[j * m + k] -= q * S[i * m + k];
            for (int k = 0; W && k < m; k++) W[j * m + k] -= q * W[i * m + k];
        }
    }
    return 1;
}

/* As correct, by all that was observed as one; scaling by S alone. c->d has the information of the length first, then
   that across it; c->order has -1 - i for those that are taken together with the one before. */
INLINE int correct_joint(const int n, const int m, const correction_rule *const rule, const real *spread,
                         real *RESTRICT x, real *RESTRICT P, correction *const c) {
    real *RESTRICT e = c->t, s = 1, slope, weight, moved;
    int first = -1, count = 0, alone = 0;
    if (c->observed > JOINT_MOST || !correction_prepare(m, c)) return 0;
    for (int i = 0; i < m; i++) {
        if (c->left[i] == 0) continue;
        if (!joint_sees(n, i, P, c)) {
            if (!joint_leave(m, i, rule, spread ? spread[i] : 1, c)) return 0;
            if (c->order) c->order[alone] = (real)i;
            alone++;
            continue;
        }
        if (spread && (first < 0 || spread[i] > s)) s = spread[i];
        if (first < 0) first = i;
    }
    if (first < 0) return 1;
    if (!joint_whiten(n, m, c)) return 0;
    for (int i = 0; i < m; i++) e[i] = c->left[i] != 0 ? c->e[i] : 0;
    for (int i = m - 1, below = -1; i >= 0; below = c->left[i] != 0 ? i : below, i--) {
        if (c->left[i] == 0 || below < 0 || e[below] == 0) continue;
        const real length = real_hypot(e[i], e[below]);
        if (!real_is_finite(length)) return 0;
        const real cosine = e[i] / length, sine = e[below] / length;
        joint_turn(n, cosine, sine, c->C + i * n, c->C + below * n);
        if (c->W) joint_turn(m, cosine, sine, c->W + i * m, c->W + below * m);
        e[i] = length;
        e[below] = 0;
    }
    moved = correction_bound(&rule->psi, e[first], s, &slope);
    weight = moved == e[first] ? 1 : moved / e[first];
    for (int i = first; i < m; i++) {
        if (c->left[i] == 0) continue;
        const real d = correction_information(rule, i == first && e[first] != 0 ? slope : weight, weight);
        c->weights[i] = weight;
        c->slopes[i] = slope;
        c->d[i] = d;
        if (c->order) c->order[alone + count] = (real)(count > 0 ? -1 - i : i);
        count++;
        if (d != 0) real_shrink(n, d, c->C + i * n, P);
    }
    for (int k = 0; k < n; k++) x[k] += c->C[first * n + k] * moved;
    for (int j = 0; c->v && j < m; j++) c->v[j] += c->W[first * m + j] * moved;
    correction_gather(c, psi_rho(&rule->psi, e[first]) + rule->joint[count - 1] - (real)count * rule->normalizer, 1);
    return correction_is_settled(n, x, P);
}

/* Correct x and P in place by the innovations of c, sensor by sensor or as one, as the rule says. */
INLINE int correct_grouped(const int n, const int m, const correction_rule *const rule, const real *spread,
                           real *RESTRICT x, real *RESTRICT P, correction *const c) {
    return rule->joint ? correct_joint(n, m, rule, spread, x, P, c) : correct(n, m, rule, spread, x, P, c);
}

#endif

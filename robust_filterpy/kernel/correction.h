/* The correction, sensor by sensor, the most plausible first: robust_filterpy.correction.definition in C.

   x and the innovations that are not yet used are one Gaussian vector; the scalar Masreliez-Martin step (paper 37,
   39, 42, 44, 47, 49) conditions all of it on one sensor after the other. P - d g g' is the most accurate form as
   long as the variance S_ii has not canceled, and one that has is declined. */
#ifndef ROBUST_FILTERPY_CORRECTION_H
#define ROBUST_FILTERPY_CORRECTION_H

#include "psi.h"

enum scaling { SCALING_LEARNT, SCALING_INNOVATION, SCALING_UNIT, SCALING_BOUNDED };
#define JOINT_MOST 16

enum information { INFORMATION_REALIZED, INFORMATION_EXPECTED, INFORMATION_WEIGHT };

typedef struct {
    psi_function psi;
    int scaling, information;
    real expected;   /* E[psi'] between 0 and 1, for INFORMATION_EXPECTED */
    real normalizer; /* log of the integral of exp(-rho) */
    /* The same for 1, 2 .. JOINT_MOST sensors that fail together; NULL if each fails on its own. */
    const real *joint;
    int patience; /* after how many in a row that agree an innovation is a jump under SCALING_LEARNT; 0: as learned */
} correction_rule;

/* What a correction works on and leaves behind; y, C and S are what is left of them when it is done. */
typedef struct {
    real *y;       /* (m) innovation, 0 where missing */
    real *C;       /* (m, n) covariance of the state with each innovation: rows of (P H' + M)' */
    real *S;       /* (m, m) covariance of the innovation */
    real *e;       /* (m) standardized innovation when its turn came, 0 where missing */
    real *weights; /* (m) psi(e) / e, NaN where missing */
    real *slopes;  /* (m) psi'(e), NaN where missing */
    real *v;       /* (m) x_next = x + C v with the C of the beginning; NULL where nobody asks, and then W too */
    real *W;       /* (m, m) row i: the C_i of its turn in terms of the C of the beginning */
    real *d;       /* (m) information of each, 0 where missing */
    real *order;   /* (m) places of the sensors in the order taken; NULL where nobody asks */
    real *t, *first, *left; /* (m) scratch: scaling, S_ii of the beginning, 1 where not yet used */
    real loss;     /* sum of rho(e) ... */
    real product;  /* ... and the product of the S_ii: -log p(z) = loss + log(product) / 2 + observed normalizers */
    int observed;  /* how many sensors were */
} correction;

#define correction_work(n, m) ((size_t)(m) * (size_t)((n) + 2 * (m) + 10))

/* Lay a correction out in a workspace; shown: whether v, W and order are wanted. */
SIZED void correction_begin(const int n, const int m, const int shown, correction *const c, real *work) {
    c->C = work;
    c->S = c->C + n * m;
    c->W = shown ? c->S + m * m : NULL;
    c->y = c->S + 2 * m * m;
    c->e = c->y + m;
    c->weights = c->e + m;
    c->slopes = c->weights + m;
    c->d = c->slopes + m;
    c->t = c->d + m;
    c->first = c->t + m;
    c->left = c->first + m;
    c->v = shown ? c->left + m : NULL;
    c->order = shown ? c->left + 2 * m : NULL;
    c->loss = 0;
    c->product = 1;
}

/* -log p(z) but for normalizers, gathered so that a logarithm is seldom needed. */
SIZED void correction_gather(correction *const c, const real loss, const real variance) {
    c->loss += real_min(loss, REAL_LARGE);
    if (variance > REAL_PRODUCT || variance < 1 / REAL_PRODUCT) {
        c->loss += REAL(0.5) * real_log(variance);
    } else {
        c->product *= variance;
        if (c->product > REAL_PRODUCT || c->product < 1 / REAL_PRODUCT) {
            c->loss += REAL(0.5) * real_log(c->product);
            c->product = 1;
        }
    }
}

/* Write y = z - H x, C = H P + M' and S = H P H' + H M + M' H' + R; z is NaN where missing, M (n, m) or NULL.
   Return whether y is finite. */
SIZED int innovate(const int n, const int m, const real *RESTRICT z, const real *RESTRICT x, const real *RESTRICT P,
                    const real *RESTRICT H, const real *RESTRICT R, const real *M, correction *const c) {
    real *RESTRICT C = c->C, *RESTRICT S = c->S, *RESTRICT y = c->y, *RESTRICT left = c->left;
    real check = 0;
    c->observed = 0;
    for (int i = 0; i < m; i++) {
        const int seen = z[i] == z[i];
        y[i] = seen ? z[i] - real_dot(n, H + i * n, x) : 0;
        left[i] = seen ? REAL(1.0) : REAL(0.0);
        c->observed += seen;
        check += y[i] - y[i];
    }
    real_multiply(m, n, n, H, P, C);
    for (int i = 0; M && i < m; i++)
        for (int k = 0; k < n; k++) C[i * n + k] += M[k * m + i];
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            real total = R[i * m + j];
            for (int k = 0; k < n; k++) total += C[i * n + k] * H[j * n + k];
            if (M)
                for (int k = 0; k < n; k++) total += H[i * n + k] * M[k * m + j];
            S[i * m + j] = S[j * m + i] = total;
        }
    return check == 0;
}

/* T_i of one sensor. */
SIZED real correction_scale(const int scaling, const real variance) {
    if (scaling == SCALING_UNIT || (scaling == SCALING_BOUNDED && variance < 1)) return 1;
    return 1 / real_sqrt(variance);
}

/* Return the most plausible of the sensors left: least |e|/s, then least |e|, then least e, then the first; compared
   in single precision, since rounding must not choose the order of those that are equal. */
SIZED int correction_next(const int m, const int scaling, const real *spread, correction *const c) {
    int best = -1;
    float least = 0, least_e = 0;
    real before = 0;
    for (int i = 0; i < m; i++) {
        if (c->left[i] == 0) continue;
        c->t[i] = correction_scale(scaling, c->S[i * m + i]);
        const real own = c->t[i] * c->y[i], e = real_abs(own);
        const float relative = (float)real_min(spread ? e / spread[i] : e, REAL(1e38));
        const float size = (float)real_min(e, REAL(1e38));
        if (best < 0 || relative < least || (relative == least && size < least_e) ||
            (relative == least && size == least_e && own < 0 && before > 0)) {
            best = i;
            least = relative;
            least_e = size;
            before = own;
        }
    }
    return best;
}

/* s psi(e / s), and psi'(e / s) into slope; most often s is 1, and a division takes as long as all else. */
SIZED real correction_bound(const psi_function *const psi, const real e, const real s, real *const slope) {
    real bounded;
    if (s == 1) return psi_of(psi, e, slope);
    bounded = psi_of(psi, e / s, slope);
    /* What is not bounded stays as it is to the last bit. */
    return bounded == e / s ? e : s * bounded;
}

/* Information of a sensor, between 0 and 1. */
SIZED real correction_information(const correction_rule *const rule, const real slope, const real weight) {
    const real d = rule->information == INFORMATION_REALIZED   ? slope
                   : rule->information == INFORMATION_EXPECTED ? rule->expected
                                                               : weight;
    return real_min(real_max(d, 0), 1);
}

/* Begin where no sensor is taken yet; return whether the variances of those that were observed are ordinary. */
SIZED int correction_prepare(const int m, correction *const c) {
    int fine = 1;
    for (int i = 0; i < m; i++) {
        const real variance = c->first[i] = c->S[i * m + i];
        c->e[i] = c->d[i] = 0;
        c->weights[i] = c->slopes[i] = (real)NAN;
        fine &= c->left[i] == 0 || (variance > 0 && real_is_finite(variance));
        if (!c->v) continue;
        c->v[i] = c->order[i] = 0;
        for (int j = 0; j < m; j++) c->W[i * m + j] = i == j ? REAL(1.0) : REAL(0.0);
    }
    return fine;
}

/* Whether a correction has left numbers, and no variance below 0. */
SIZED int correction_is_settled(const int n, const real *RESTRICT x, const real *RESTRICT P) {
    real check = 0;
    for (int k = 0; k < n; k++) {
        if (!(P[k * n + k] >= 0)) return 0;
        check += real_abs(x[k]) + P[k * n + k];
    }
    return real_is_finite(check);
}

/* Correct x and P in place by the innovations of c; spread is (m), or NULL for 1. Return whether all was ordinary: if
   not, what x and P now hold is of no use. */
SIZED int correct(const int n, const int m, const correction_rule *const rule, const real *spread, real *RESTRICT x,
                   real *RESTRICT P, correction *const c) {
    real *RESTRICT C = c->C, *RESTRICT S = c->S, *RESTRICT y = c->y;
    if (!correction_prepare(m, c)) return 0;
    for (int step = 0; step < c->observed; step++) {
        const int i = correction_next(m, rule->scaling, spread, c), more = step + 1 < c->observed;
        if (i < 0) return 0;
        const real variance = S[i * m + i], t = c->t[i], s = spread ? spread[i] : 1;
        const real e = real_within(t * y[i], REAL_MAX);
        real slope, *RESTRICT g = C + i * n, *RESTRICT q = S + i * m;
        const real moved = correction_bound(&rule->psi, e, s, &slope);
        if (e != e) return 0;
        c->left[i] = 0;
        c->e[i] = e;
        c->slopes[i] = slope;
        c->weights[i] = moved == e ? 1 : moved / e;
        if (c->order) c->order[step] = (real)i;
        const real d = c->d[i] = correction_information(rule, slope, c->weights[i]);
        {
            const real whitened = rule->scaling <= SCALING_INNOVATION ? e : y[i] / real_sqrt(variance);
            /* As given, so that filters with different models can be compared by it. */
            correction_gather(c, psi_rho(&rule->psi, whitened), variance);
        }
        for (int k = 0; k < n; k++) {
            g[k] *= t;
            x[k] += g[k] * moved;
        }
        if (c->v)
            for (int j = 0; j < m; j++) c->v[j] += c->W[i * m + j] * (t * moved);
        for (int j = 0; j < m; j++) q[j] *= t;
        if (more)
            for (int j = 0; j < m; j++) y[j] -= c->left[j] * (q[j] * moved);
        if (d == 0) continue;
        real_shrink(n, d, g, P);
        if (!more) continue;
        for (int j = 0; j < m; j++) {
            if (c->left[j] == 0) continue;
            const real dq = d * q[j];
            for (int k = 0; k < n; k++) C[j * n + k] -= dq * g[k];
            for (int k = 0; k < m; k++) S[j * m + k] -= d * (q[j] * q[k]);
            if (c->W)
                for (int k = 0; k < m; k++) c->W[j * m + k] -= dq * t * c->W[i * m + k];
            /* What is left of a variance that canceled is rounding. */
            if (!(S[j * m + j] > REAL_PIVOT * c->first[j])) return 0;
        }
    }
    return correction_is_settled(n, x, P);
}

/* Return log p(z). */
SIZED real correction_log_likelihood(const correction_rule *const rule, const correction *const c) {
    return -c->loss - REAL(0.5) * real_log(c->product) - (real)c->observed * rule->normalizer;
}

#endif

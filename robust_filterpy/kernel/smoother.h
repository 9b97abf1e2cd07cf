/* One pass of a linear smoother with weights: robust_filterpy.smoothing.linear_pass in C, where the equations are.

   Forward a Kalman filter, one component of the measurement after the other; backward score s and information L of the
   later measurements. Next to a diffuse P the smoothed P - P L P would lose its digits: there the information about the
   state, run backward, corrects x and P as measurements would. No predicted covariance is inverted. */
#ifndef ROBUST_FILTERPY_SMOOTHER_H
#define ROBUST_FILTERPY_SMOOTHER_H

#include "prediction.h"
#include "series.h"

/* An ordinary measurement may use the short form of P; one that tells this much more than was known before, as next to
   a diffuse prior, needs Joseph's, or P loses its last digits (twice this ratio of them). Where there was one, the
   smoothed states take the longer way too: it costs as much as another pass. */
#define SMOOTHER_SHARP REAL(100.0)

typedef struct {
    ptrdiff_t steps;
    int n, m, r;
    series_matrices F, G, c, H, z, x0, P0; /* the model: x0 and P0 have one step */
    series_matrices d, o, q;               /* precisions and offsets (m), and the scale of Q = q G G' */
    real *fitted;                          /* (series, steps, m) H x_s */
    real *spread;                          /* (series, steps, m, m) H P_s H' */
    real *score, *information;             /* (series, steps, r), (.., r, r) G's, G'L G, or NULL */
    real *x, *P, *x_first, *P_first;       /* smoothed states, those before the first step; or NULL */
    real *sharpest;                        /* the most that a measurement says against what was known: d H P H' */
} smoother_job;

/* What a pass works on: one series' filtered h x and P h, and scratch. */
typedef struct {
    real *Hx, *PH;                         /* (steps, m), (steps, m, n) */
    real *x, *P, *x_next, *P_next;         /* state, or score and information */
    real *y, *Y, *y_taken, *Y_taken;       /* information about the state, run backward */
    real *Q, *none, *Ft, *B, *V;           /* none: n n zeros; B (m, n), V (m, m) */
    real *rows, *buffer;                   /* rows: n (r + 3) */
} smoother_room;

SIZED size_t smoother_work(const ptrdiff_t steps, const int n, const int m, const int r) {
    return (size_t)steps * (size_t)(m * (n + 1)) + (size_t)(n * (7 * n + m + r + 7) + m * m) + predict_work(n);
}

SIZED smoother_room smoother_begin(const ptrdiff_t steps, const int n, const int m, const int r, real *work) {
    smoother_room room;
    room.Hx = work, room.PH = room.Hx + steps * m, work = room.PH + steps * m * n;
    room.x = work, room.x_next = room.x + n, room.y = room.x_next + n, room.y_taken = room.y + n;
    room.P = room.y_taken + n, room.P_next = room.P + n * n, room.Y = room.P_next + n * n;
    room.Y_taken = room.Y + n * n, room.Q = room.Y_taken + n * n, room.none = room.Q + n * n;
    room.Ft = room.none + n * n, room.B = room.Ft + n * n, room.V = room.B + m * n, room.rows = room.V + m * m;
    room.buffer = room.rows + n * (r + 3);
    for (int i = 0; i < n * n; i++) room.none[i] = 0;
    return room;
}

/* Take in the factor exp(-d e^2/2 - o e) of e = z - h x: correct x and P in place. Return how sharp it was, d h P h';
   for a sharp one, and whenever joseph says so, P takes Joseph's form. rows: 2 n. */
SIZED real smoother_take(const int n, const real *RESTRICT h, const real z, const real d, const real o,
                         const int joseph, real *RESTRICT x, real *RESTRICT P, real *RESTRICT rows) {
    real *RESTRICT p = rows, *RESTRICT k = rows + n;
    real_multiply(1, n, n, h, P, p);
    const real predicted = real_dot(n, h, x), variance = real_dot(n, p, h);
    const real left = 1 / (1 + d * variance), gain = (d * (z - predicted) + o) * left, taken = d * left;
    for (int i = 0; i < n; i++) x[i] += p[i] * gain;
    real_shrink(n, taken, p, P);
    if (!(d * variance > SMOOTHER_SHARP) && !joseph) return d * variance;
    for (int i = 0; i < n; i++) k[i] = taken * (p[i] * left - real_dot(n, P + i * n, h));
    /* Both halves alike: k is p times rounding. */
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) P[i * n + j] += REAL(0.5) * (k[i] * p[j] + k[j] * p[i]);
    return d * variance;
}

/* Filter series s; return how sharp the sharpest measurement was. */
SIZED real smoother_forward(const int n, const int m, const smoother_job *const job, const ptrdiff_t s,
                            smoother_room *const room) {
    const int r = job->r;
    real sharp = 0, scale = 1;
    real_copy(n, series_at(&job->x0, s, 0), room->x);
    real_copy(n * n, series_at(&job->P0, s, 0), room->P);
    for (ptrdiff_t k = 0; k < job->steps; k++) {
        const real *RESTRICT H = series_at(&job->H, s, k), *RESTRICT G = series_at(&job->G, s, k);
        const real *RESTRICT d = series_at(&job->d, s, k), *RESTRICT o = series_at(&job->o, s, k);
        const real *RESTRICT z = series_at(&job->z, s, k), q = *series_at(&job->q, s, k);
        if (k == 0 || job->G.by_step || q != scale) {
            real_multiply_symmetric(n, r, G, G, room->Q);
            for (int i = 0; i < n * n; i++) room->Q[i] *= q;
            scale = q;
        }
        predict(n, room->x, room->P, series_at(&job->F, s, k), room->Q, series_at(&job->c, s, k), 1, room->x_next,
                room->P_next, room->buffer);
        real_swap(&room->x, &room->x_next), real_swap(&room->P, &room->P_next);
        for (int v = 0; v < m; v++)
            if (d[v] != 0 || o[v] != 0)
                sharp = real_max(
                    sharp, smoother_take(n, H + v * n, z[v], d[v], o[v], 0, room->x, room->P, room->rows));
        real_multiply(m, n, n, H, room->P, room->PH + k * m * n);
        real_multiply(m, n, 1, H, room->x, room->Hx + k * m);
        if (job->x) {
            real_copy(n, room->x, job->x + (s * job->steps + k) * n);
            real_copy(n * n, room->P, job->P + (s * job->steps + k) * n * n);
        }
    }
    return sharp;
}

/* Write H x_s and V = H P_s H' from x_s and P_s themselves. */
CALLED void smoother_seen(const int n, const int m, const real *H, const real *x, const real *P, real *fitted,
                          smoother_room *const room) {
    real_multiply(m, n, 1, H, x, fitted);
    real_multiply(m, n, n, H, P, room->B);
    real_multiply_symmetric(m, n, room->B, H, room->V);
}

/* Write V = H P_s H' and B = H P L of a step into room, P_s being the smoothed covariance. */
SIZED void smoother_spread(const int n, const int m, const real *RESTRICT H, const real *RESTRICT PH,
                            const real *RESTRICT L, smoother_room *const room) {
    real *RESTRICT B = room->B, *RESTRICT V = room->V;
    real_multiply(m, n, n, PH, L, B);
    for (int v = 0; v < m; v++)
        for (int u = 0; u <= v; u++) {
            real total = 0;
            for (int i = 0; i < n; i++) total += H[u * n + i] * PH[v * n + i] - B[v * n + i] * PH[u * n + i];
            V[u * m + v] = V[v * m + u] = total;
        }
}

/* s += H'(d e + o), L += H'(d - d V d) H - H'd B - B'd H; fitted is H x_s. */
SIZED void smoother_gather(const int n, const int m, const real *RESTRICT H, const real *RESTRICT z,
                            const real *RESTRICT d, const real *RESTRICT o, const real *RESTRICT fitted,
                            real *RESTRICT s, real *RESTRICT L, const smoother_room *const room) {
    const real *RESTRICT B = room->B, *RESTRICT V = room->V;
    real *RESTRICT k = room->rows;
    for (int v = 0; v < m; v++) {
        const real push = d[v] * (z[v] - fitted[v]) + o[v], *RESTRICT h = H + v * n;
        for (int i = 0; i < n; i++) s[i] += h[i] * push;
        if (d[v] == 0) continue;
        /* h k' + k h' with k = d ((h - V d H)/2 - B). */
        for (int i = 0; i < n; i++) k[i] = d[v] * (REAL(0.5) * h[i] - B[v * n + i]);
        for (int u = 0; u < m; u++) {
            const real f = REAL(0.5) * d[v] * V[v * m + u] * d[u];
            for (int i = 0; i < n; i++) k[i] -= f * H[u * n + i];
        }
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) L[i * n + j] += h[i] * k[j] + k[i] * h[j];
    }
}

/* Write G's and G'L G. */
CALLED void smoother_process(const int n, const int r, const real *G, const real *s, const real *L, real *score,
                             real *information, real *LG) {
    real_multiply(1, n, r, s, G, score);
    real_multiply(n, n, r, L, G, LG);
    for (int a = 0; a < r; a++)
        for (int b = 0; b <= a; b++) {
            real total = 0;
            for (int i = 0; i < n; i++) total += G[i * r + b] * LG[i * r + a];
            information[a * r + b] = information[b * r + a] = total;
        }
}

/* Correct x and P by the information exp(-x'Y x/2 + y'x), as n components of Y = L D L'; y and Y are used up. */
CALLED void smoother_combine(const int n, real *x, real *P, real *y, real *Y, real *rows) {
    real *row = rows + 2 * n;
    for (int c = 0; c < n; c++) {
        const real pivot = Y[c * n + c], potential = y[c];
        if (!(pivot > 0)) continue;
        for (int i = 0; i < n; i++) row[i] = i < c ? 0 : Y[c * n + i] / pivot;
        smoother_take(n, row, 0, pivot, potential, 1, x, P, rows);
        for (int i = 0; i < n; i++) y[i] -= row[i] * potential;
        real_shrink(n, pivot, row, Y);
    }
}

/* Turn the information about the state after step k into that about the state before it. */
CALLED void smoother_earlier(const int n, const int m, const smoother_job *job, const ptrdiff_t s, const ptrdiff_t k,
                             smoother_room *const room) {
    const real *H = series_at(&job->H, s, k), *G = series_at(&job->G, s, k), *c = series_at(&job->c, s, k);
    const real *z = series_at(&job->z, s, k), *d = series_at(&job->d, s, k), *o = series_at(&job->o, s, k);
    const real q = *series_at(&job->q, s, k);
    real *y = room->y, *Y = room->Y, *p = room->rows;
    for (int v = 0; v < m; v++) {
        for (int i = 0; i < n; i++) y[i] += (d[v] * z[v] + o[v]) * H[v * n + i];
        real_shrink(n, -d[v], H + v * n, Y);
    }
    for (int i = 0; i < n; i++) y[i] -= real_dot(n, Y + i * n, c);
    for (int l = 0; l < job->r; l++) {
        real variance = 0, part = 0;
        for (int i = 0; i < n; i++) {
            p[i] = 0;
            for (int j = 0; j < n; j++) p[i] += Y[i * n + j] * G[j * job->r + l];
            part += G[i * job->r + l] * y[i];
            variance += p[i] * G[i * job->r + l];
        }
        const real taken = q / (1 + q * variance);
        for (int i = 0; i < n; i++) y[i] -= taken * p[i] * part;
        real_shrink(n, taken, p, Y);
    }
    predict(n, y, Y, room->Ft, room->none, NULL, 1, room->y_taken, room->Y_taken, room->buffer);
    real_swap(&room->y, &room->y_taken), real_swap(&room->Y, &room->Y_taken);
}

/* Smooth one filtered state in place; s and L are score and information of what comes after it. */
SIZED void smoother_state(const int n, const real *s, const real *L, real *x, real *P, smoother_room *const room) {
    real *moved = room->x_next, *less = room->P_next;
    predict(n, s, L, P, room->none, NULL, 1, moved, less, room->buffer);
    for (int i = 0; i < n; i++) x[i] += moved[i];
    for (int i = 0; i < n * n; i++) P[i] -= less[i];
}

/* Smooth the filtered series s. */
SIZED void smoother_backward(const int n, const int m, const smoother_job *const job, const ptrdiff_t s,
                              const int careful, smoother_room *const room) {
    for (int i = 0; i < n; i++) room->x[i] = room->y[i] = 0;
    for (int i = 0; i < n * n; i++) room->P[i] = room->Y[i] = 0;
    for (ptrdiff_t k = job->steps - 1; k >= 0; k--) {
        const ptrdiff_t at = s * job->steps + k;
        const real *RESTRICT H = series_at(&job->H, s, k), *RESTRICT F = series_at(&job->F, s, k);
        const real *RESTRICT PH = room->PH + k * m * n;
        real *const fitted = job->fitted + at * m;
        if (job->F.by_step || k == job->steps - 1)
            for (int i = 0; i < n; i++)
                for (int j = 0; j < n; j++) room->Ft[j * n + i] = F[i * n + j];
        if (job->x && careful) {
            real_copy(n, room->y, room->y_taken), real_copy(n * n, room->Y, room->Y_taken);
            smoother_combine(n, job->x + at * n, job->P + at * n * n, room->y_taken, room->Y_taken, room->rows);
            smoother_earlier(n, m, job, s, k, room);
        } else if (job->x) {
            smoother_state(n, room->x, room->P, job->x + at * n, job->P + at * n * n, room);
        }
        for (int v = 0; v < m; v++) {
            fitted[v] = room->Hx[k * m + v];
            for (int i = 0; i < n; i++) fitted[v] += PH[v * n + i] * room->x[i];
        }
        smoother_spread(n, m, H, PH, room->P, room);
        smoother_gather(n, m, H, series_at(&job->z, s, k), series_at(&job->d, s, k), series_at(&job->o, s, k),
                        fitted, room->x, room->P, room);
        if (job->x && careful) smoother_seen(n, m, H, job->x + at * n, job->P + at * n * n, fitted, room);
        real_copy(m * m, room->V, job->spread + at * m * m);
        if (job->score)
            smoother_process(n, job->r, series_at(&job->G, s, k), room->x, room->P, job->score + at * job->r,
                             job->information + at * job->r * job->r, room->rows);
        predict(n, room->x, room->P, room->Ft, room->none, NULL, 1, room->x_next, room->P_next, room->buffer);
        real_swap(&room->x, &room->x_next), real_swap(&room->P, &room->P_next);
    }
}

/* Smooth series low to high - 1. */
SIZED void smoother_span(const int n, const int m, const smoother_job *const job, const ptrdiff_t low,
                          const ptrdiff_t high, real *work) {
    smoother_room room = smoother_begin(job->steps, n, m, job->r, work);
    for (ptrdiff_t s = low; s < high; s++) {
        const real sharp = smoother_forward(n, m, job, s, &room);
        const int careful = sharp > SMOOTHER_SHARP && job->x;
        *job->sharpest = real_max(*job->sharpest, sharp);
        smoother_backward(n, m, job, s, careful, &room);
        if (!job->x) continue;
        real *const x = job->x_first + s * n, *const P = job->P_first + s * n * n;
        real_copy(n, series_at(&job->x0, s, 0), x), real_copy(n * n, series_at(&job->P0, s, 0), P);
        if (careful) smoother_combine(n, x, P, room.y, room.Y, room.rows);
        else smoother_state(n, room.x, room.P, x, P, &room);
    }
}

#endif

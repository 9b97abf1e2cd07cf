/* How each sensor's spread is learned: what its innovations usually are, in units of what S says.

   The spread is a median by recursion of |e|, e = y / sqrt(S_ii), without the far ones. What a sensor is noisier than
   those that see the same is added to its R; a run of clipped innovations is a jump
   of the state, unless noise is added, and P grows until it is plausible. How
   long a run must be is learned from those that lasted and those that came to nothing. With other sensors a far
   reading that repeats the one before counts only as far as that is usual: one that is stuck says nothing new. Where
   readings repeat, one smallest step between them is never clipped. */
#ifndef ROBUST_FILTERPY_SPREAD_H
#define ROBUST_FILTERPY_SPREAD_H

#include "correction.h"

/* What is known of one sensor, all 0 at first. */
typedef struct {
    real weight;  /* information that the spread rests on, sum of the roots of R_ii / S_ii; 0: none yet */
    real spread;  /* median of |e| over .6745, without the far ones */
    real share;   /* share of far innovations */
    real outliers; /* far ones in a row */
    real run;     /* clipped ones in a row, of one sign, each where the last one left x */
    real rest;    /* z - H x after the last correction */
    real jump;    /* how far the last jump went, 0 if there was none to return from */
    real last;    /* the last reading */
    real repeats; /* share of ordinary readings that repeat the one before to the last bit */
    real step;    /* the smallest change of a reading, -1 before there is one, 0 before any reading */
    real left;    /* (H P H')_ii / R_ii after the last correction */
    real growth;  /* by what its logarithm usually grows until the next reading, */
    real used;    /* the mean of so many */
    real held;    /* far readings in a row that repeat the one before */
    real filled;  /* how many were taken for missing in all */
    real wide;    /* median of |e| over .6745 of readings that are wider than usual, */
    real widened; /* so many, each less the less it is wider */
    real lasted;  /* runs of far readings that turned out to be jumps, */
    real vain;    /* and that came to nothing, */
    real on;      /* of which so many readings were not the first */
    real reach;   /* how far jumps have gone, geometric mean */
    real age;     /* readings since the run began that was believed last; 0: that has lasted, or was undone */
    real open;    /* mean of log(H P H' / R) of ordinary readings, no wider than usual, 0 below 1 */
} spread_memory;
#define SPREAD_NUMBERS 23

#define SPREAD_QUARTILE REAL(0.6744897501960817) /* median of |e| for a normal e of deviation 1 */
#define SPREAD_BEND REAL(1.345)                  /* beyond so many spreads an innovation counts as clipped */
#define SPREAD_FAR REAL(3.0)                     /* beyond so many it is an outlier, and does not move the spread */
#define SPREAD_PACE REAL(2.0)                    /* steps of log(spread): 2/n of n samples, */
#define SPREAD_FADING REAL(0.01)                 /* at least 2/100 */
#define SPREAD_CURVE REAL(0.1903)                /* the minimax threshold of a share e of outliers, from .004 to .5 */
#define SPREAD_SLOPE REAL(0.5837)                /* within half a percent: (CURVE u + SLOPE) u - BASE, */
#define SPREAD_BASE REAL(0.1838)                 /* u the root of -log(e) */
#define SPREAD_FEW REAL(10.0)                    /* the share starts from so many without an outlier; */
                                                 /* so many far ones in a row, and another one is typical */
#define SPREAD_RUN 4                             /* a jump: so many clipped in a row, until some have lasted, */
#define SPREAD_AGREE REAL(2.5)                   /* each within so many spreads of where the last one left x */
#define SPREAD_RARE REAL(0.05)                   /* a share of outliers with which one innovation is a return, */
                                                 /* the chance of a jump, over the readings a state stands on, */
#define SPREAD_RETURN REAL(0.2)                  /* if it is within a fifth of the jump */
#define SPREAD_SPARED REAL(0.1)                  /* states that tell a tenth as much as another do not jump with it */
#define SPREAD_WHOLE REAL(0.01)                  /* so little wider is as usual */
#define SPREAD_SUDDEN REAL(4.0)                  /* what is so many spreads off has not crept there */
#define SPREAD_STEEP REAL(1.5)                   /* a run goes on while it grows by less than half */
#define SPREAD_GROWTH REAL(1e6)                  /* the most that S grows by at one jump */
#define SPREAD_WITNESS REAL(0.47)                /* of the weight of those who see the same */
#define SPREAD_APART REAL(1.5)                   /* so much wider than they are is a sensor's own noise */
#define SPREAD_ROUNDED REAL_PIVOT                /* an innovation of so much of reading and deviation is rounding */
#define SPREAD_FLOOR REAL(1e-9)                  /* less of H P H' / R is rounding, */
#define SPREAD_STEEPEST REAL(50.0)               /* and its logarithm does not grow by more */
#define SPREAD_ROUNDING (1 + REAL(1e-9))          /* of sums of weights */

/* What a correction is to be changed by. */
typedef struct {
    real *width;  /* (m) unit of each sensor's innovation, in the unit of z; below 0 for what says nothing new */
    real *added;  /* (m) variance that is added to R */
    real *growth; /* (n) what each state's deviation grows by */
    real *opened; /* (m) variance that a jump adds to what each sensor sees */
    real *nominal;   /* (m) root of S_ii as given */
    int grows;
} spread_change;

#define spread_work(n, m) ((size_t)((n) + 13 * (m)))

/* What one smallest step of a sensor whose readings repeat asks of its spread, in units of S; none: not above 0. */
INLINE real spread_coarse(const spread_memory *const own, const real nominal) {
    return own->repeats > 0 ? own->step / SPREAD_BEND / nominal : 0;
}

/* A step of a median by recursion towards aim, up or down by a pace, but never beyond it. */
INLINE real spread_towards(const real median, const real aim, const real up, const real down) {
    if (aim > median) return real_min(aim, median * real_exp(real_min(up, 700)));
    return real_max(aim, median * real_exp(-down));
}

/* Let one |e| move the spread and the share of outliers, of which at most so many are in a row; weight: the root of
   R_ii / S_ii. */
INLINE void spread_learn(spread_memory *const own, const real size, const real coarse, const real weight,
                         const real most) {
    const real aim = size / SPREAD_QUARTILE;
    real known, pace, far;
    if (own->outliers >= most) own->weight = own->share = own->outliers = 0;
    known = own->weight;
    own->weight += weight;
    if (known == 0) {
        own->spread = aim;
        return;
    }
    pace = SPREAD_PACE * real_max(weight / known, SPREAD_FADING);
    far = size > SPREAD_FAR * real_max(own->spread, coarse) ? REAL(1.0) : REAL(0.0);
    own->spread = spread_towards(own->spread, aim, pace * (1 - own->share), pace * (1 + own->share));
    own->outliers = far != 0 ? own->outliers + 1 : 0;
    own->share += (far - own->share) * real_max(weight / (own->weight + SPREAD_FEW), SPREAD_FADING);
}

/* Write into seen (m) how much of sensor i's prediction error each sensor sees too, squared correlations; the sum. */
INLINE real spread_seen(const int m, const int i, const correction *const c, const real *R, real *RESTRICT seen) {
    const real b = c->S[i * m + i] - R[i * m + i];
    real total = 0;
    for (int j = 0; j < m; j++) {
        const real both = c->S[i * m + j] - R[i * m + j], scale = b * (c->S[j * m + j] - R[j * m + j]);
        seen[j] = 0;
        if (c->left[j] != 0 && (j == i || (b > 0 && scale > 0))) seen[j] = j == i ? 1 : both * both / scale;
        total += seen[j];
    }
    return total;
}

/* The least (or greatest) of values at or below (above) which so much of the weight is; others: weight > 0. */
CALLED real spread_quantile(const int m, const real *values, const real *seen, const real sign, const real enough) {
    real found = INFINITY;
    for (int j = 0; j < m; j++) {
        real below = 0;
        if (!(seen[j] > 0) || !(sign * values[j] < found)) continue;
        for (int k = 0; k < m; k++)
            if (seen[k] > 0 && sign * values[k] <= sign * values[j]) below += seen[k];
        if (below >= enough) found = sign * values[j];
    }
    return sign * found;
}

/* What sensor i is noisier than those that see the same: that can only be its own noise. */
CALLED real spread_added(const int m, const int i, const correction *const c, const real *R, const real *s,
                          real *RESTRICT seen, real *RESTRICT says) {
    const real variance = c->S[i * m + i], total = spread_seen(m, i, c, R, seen);
    const real quorum = SPREAD_WITNESS * total * SPREAD_ROUNDING;
    real usual, low, high, own;
    /* The others together are too few to say anything. */
    if (!(variance - R[i * m + i] > 0) || total - 1 <= quorum) return 0;
    usual = spread_quantile(m, s, seen, 1, quorum);
    for (int j = 0; j < m; j++)
        says[j] = j == i         ? c->y[i]
                  : seen[j] > 0 ? c->y[j] * (c->S[i * m + j] - R[i * m + j]) / (c->S[j * m + j] - R[j * m + j])
                                : 0;
    /* Their median, the weighted one that is nearest to the prediction. */
    low = spread_quantile(m, says, seen, 1, total * (REAL(0.5) - REAL(1e-9)));
    high = spread_quantile(m, says, seen, -1, total * (REAL(0.5) - REAL(1e-9)));
    own = real_abs(c->y[i] - real_min(real_max(0, low), high)) / real_sqrt(variance);
    own = real_max(s[i] / SPREAD_APART, real_min(own, REAL_PRODUCT) / SPREAD_FAR) / usual;
    return own > 1 ? variance * (own * own - 1) : 0;
}

/* What a sensor tells of the state that it tells most of, of its covariances c (n) with its prediction. */
INLINE real spread_informs(const int n, const real *RESTRICT P, const real *RESTRICT c) {
    real most = 0;
    for (int k = 0; k < n; k++)
        if (P[k * n + k] > 0) most = real_max(most, c[k] * c[k] / P[k * n + k]);
    return most;
}

/* Whether state k has jumped, of which it tells c^2 / P. */
INLINE int spread_moved(const int n, const int k, const real *RESTRICT P, const real *RESTRICT c, const real most) {
    return P[k * n + k] > 0 && c[k] * c[k] / P[k * n + k] > SPREAD_SPARED * most;
}

/* Whether something is far, unit: the spread in that of the reading, and as far as jumps have gone. */
INLINE int spread_as_jumps(const spread_memory *const own, const real far, const real unit) {
    return far > SPREAD_FAR * unit &&
           (own->reach == 0 || (far < SPREAD_FAR * own->reach && SPREAD_FAR * far > own->reach));
}

/* Whether a run is a jump rather than outliers or chance: by its length where its evidence tells, or by the odds of
   those before; back: it undoes one. */
INLINE int spread_believed(const spread_memory *const own, const real y, const real unit, const int back,
                           const int tells, const int patience) {
    const real again = (own->on + 1) / (own->vain + own->on + 2);
    if (patience) return own->run >= patience;
    if ((own->run >= SPREAD_RUN && tells) || (back && (own->age > 0 || own->share < SPREAD_RARE))) return 1;
    if (!(own->reach > 0 && spread_as_jumps(own, real_abs(y), unit))) return 0;
    return own->lasted * SPREAD_ROUNDING >= (own->vain + 1) * real_exp((own->run - 1) * real_log(again));
}

/* Note what became of a run of far readings: a jump, or so many that came to nothing. */
INLINE void spread_outcome(spread_memory *const own, const int lasted, const real length) {
    const real far = real_abs(own->jump);
    own->lasted += (lasted ? 1 : 0) - SPREAD_FADING * own->lasted;
    own->vain += (lasted ? 0 : 1) - SPREAD_FADING * own->vain;
    own->on += (lasted ? 0 : length - 1) - SPREAD_FADING * own->on;
    if (!lasted) return;
    if (own->reach > 0) own->reach *= real_exp(real_log(far / own->reach) / real_min(own->lasted, SPREAD_FEW));
    else own->reach = far;
}

/* Let a run end with a reading that does not go on with it. */
INLINE void spread_end(spread_memory *const own, const real unit) {
    if (own->run > 0 && spread_as_jumps(own, real_abs(own->rest), unit)) spread_outcome(own, 0, own->run);
    own->run = 0;
}

/* Let a jump that was believed grow older: one that nothing has undone has lasted. */
INLINE void spread_grow_old(spread_memory *const own, const real unit, const int ordinary) {
    if (!(own->age > 0)) return;
    own->age += 1;
    if (!(own->age > SPREAD_FEW && ordinary)) return;
    own->age = 0;
    if (real_abs(own->jump) > SPREAD_SUDDEN * unit) spread_outcome(own, 1, 0);
}

/* How much one more innovation weighs in a share. */
INLINE real spread_step(const spread_memory *const own) {
    return real_max(1 / (own->weight + SPREAD_FEW), SPREAD_FADING);
}

/* Note a jump: the far ones in a row were no outliers, and where others are rare it may be undone at once. */
INLINE void spread_forgive(spread_memory *const own, const real jump) {
    own->share = real_max(own->share - own->outliers * spread_step(own), 0);
    own->outliers = own->run = own->held = 0;
    own->jump = jump;
}

/* Learn how usual it is that an ordinary reading repeats the one before, and by what steps readings change. */
INLINE void spread_repeat(spread_memory *const own, const real z, const int ordinary) {
    const real change = real_abs(z - own->last), step = own->step;
    if (step == 0) {
        own->step = -1;
    } else if (change > 0 && ordinary) {
        own->step = step > 0 ? real_min(change, step) : change;
    }
    if (ordinary) own->repeats += ((step != 0 && change == 0 ? 1 : 0) - own->repeats) * spread_step(own);
    own->last = z;
}

/* Whether a reading says nothing new: a clipped one that repeats the one before to the last bit, or goes on doing so.
   Of a sensor of which most readings repeat some count. */
INLINE int spread_holds(spread_memory *const own, const real z, const real size, const real coarse) {
    const real counts = real_max(2 * own->repeats - 1, 0), before = own->held;
    const real unit = real_max(own->spread, coarse);
    const int far = unit > 0 && size > SPREAD_BEND * unit;
    if (own->step == 0 || z != own->last || !(far || before > 0)) {
        /* One that is near those that were held bears them out. */
        if (own->run > 0) own->run += before;
        own->held = 0;
        return 0;
    }
    own->held = before + 1;
    if (size > SPREAD_FAR * unit) own->filled += 1;
    return (long long)(own->held * counts + REAL(0.5)) == (long long)(before * counts + REAL(0.5));
}

/* What S / R of a sensor is over what would be, had the usual time passed since its last reading: at least 1. */
INLINE real spread_excess(const spread_memory *const own, const real ratio) {
    if (!(own->used > 0)) return 1;
    return real_max((1 + ratio) / (1 + own->left * real_exp(real_min(own->growth, SPREAD_STEEPEST))), 1);
}

/* The root of the sum of the squares of a threshold and of what it grows by where a reading usually says more than the
   state before it. */
INLINE real spread_tolerance(const spread_memory *const own, const real ratio, const real threshold) {
    const real now = real_log(real_max(ratio, 1));
    return real_sqrt(threshold * threshold + 4 * (own->used > 0 ? real_min(now, own->open) : now));
}

/* Huber's minimax threshold for a sensor's share of outliers, at least half a reading of those it is known by. */
INLINE real spread_minimax(const spread_memory *const own) {
    const real share = real_min(real_max(own->share, spread_step(own) / 2), REAL(0.5));
    const real u = real_sqrt(-real_log(share));
    return (SPREAD_CURVE * u + SPREAD_SLOPE) * u - SPREAD_BASE;
}

/* By what a width grows with it: no further than readings that were wider than usual have been, if they were many. */
INLINE real spread_wider(const spread_memory *const own, const real excess, const real coarse) {
    const real usual = SPREAD_BEND * real_max(own->spread, coarse);
    if (!(excess > 1 + SPREAD_WHOLE && own->widened > SPREAD_FEW && usual > 0)) return excess;
    return real_max(real_min(excess, SPREAD_FAR * own->wide / usual), 1);
}

/* Learn how far readings are that are so much wider than usual. */
INLINE void spread_widen(spread_memory *const own, const real e, const real excess) {
    const real before = own->widened, aim = e / SPREAD_QUARTILE;
    own->widened += 1 - 1 / excess;
    if (before > 0) {
        const real pace = SPREAD_PACE * real_max((1 - 1 / excess) / before, SPREAD_FADING * (1 - 1 / excess));
        own->wide = spread_towards(own->wide, aim, pace, pace);
    } else {
        own->wide = aim;
    }
}

/* Learn how log(H P H' / R) grows from one ordinary reading to the next, and what it usually is, 0 below 1. */
INLINE void spread_grown(spread_memory *const own, const real ratio, const real excess) {
    if (!(own->left > 0)) return;
    const real grown = real_log(real_max(ratio, SPREAD_FLOOR) / own->left) - own->growth;
    /* A step at most e-fold; one that would be more is not the mean yet. */
    own->used += own->used == 0 || grown < 1 ? 1 : 0;
    const real pace = real_max(1 / own->used, SPREAD_FADING);
    own->growth += real_min(grown, 1) * pace;
    if (!(excess > 1 + SPREAD_WHOLE)) own->open += (real_log(real_max(ratio, 1)) - own->open) * pace;
}

/* H P H' / R of a sensor, R at least what is not rounding of S. */
INLINE real spread_ratio(const real known, const real R, const real variance) {
    return real_max(known / real_max(R, REAL(1e-12) * variance), SPREAD_FLOOR);
}

/* Learn from the innovations of c and the readings z, before the correction; P and R are those behind c. Readings that
   say nothing new are then left out of c, and have no width. */
CALLED void spread_before(const int n, const int m, const int patience, const real *z, const real *P, const real *R,
                          correction *const c, spread_memory *const memory, spread_change *const change, real *work) {
    real *s, *nominal, *units, *size, *out, *ratio, *excess, *bend, *seen, coarse, e;
    change->growth = work;
    change->width = work + n;
    change->added = work + n + m;
    change->opened = work + n + 2 * m;
    change->nominal = nominal = work + n + 3 * m;
    units = nominal + m, s = units + m, size = s + m, out = size + m, ratio = out + m, excess = ratio + m;
    bend = excess + m, seen = bend + m; /* and m more */
    change->grows = 0;
    for (int k = 0; k < n; k++) change->growth[k] = 1;
    for (int i = 0; i < m; i++) {
        const real variance = c->S[i * m + i];
        spread_memory *const own = &memory[i];
        change->added[i] = change->opened[i] = 0;
        nominal[i] = real_sqrt(variance);
        ratio[i] = spread_ratio(variance - R[i * m + i], R[i * m + i], variance);
        coarse = spread_coarse(own, nominal[i]);
        excess[i] = spread_excess(own, ratio[i]);
        bend[i] = spread_tolerance(own, ratio[i], SPREAD_BEND);
        out[i] = spread_wider(own, excess[i], coarse); /* until it is known who is clipped */
        /* Below a number whose square is a number. */
        e = real_min(real_abs(c->y[i]) / nominal[i], REAL_PRODUCT);
        size[i] = e / out[i];
        change->width[i] = 0;
        if (c->left[i] != 0 && spread_holds(own, z[i], size[i], coarse)) {
            c->left[i] = c->y[i] = 0;
            c->observed -= 1;
            change->width[i] = -1;
        }
        if (c->left[i] != 0 && excess[i] > 1 + SPREAD_WHOLE) spread_widen(own, e, excess[i]);
        /* A typical innovation is no rounding: of a state that was set from the reading itself, say. What repeats the
           reading before tells nothing of the noise. */
        if (c->left[i] != 0 && size[i] > 0 && (own->step == 0 || z[i] != own->last) &&
            (own->weight > 0 || real_abs(c->y[i]) > SPREAD_ROUNDED * (real_abs(z[i]) + nominal[i])))
            spread_learn(own, e, coarse, real_sqrt(real_min(real_max(R[i * m + i] / variance, REAL(1e-9)), 1)),
                         SPREAD_FEW + (real)patience);
        /* Who has no typical innovation yet has shown zeros alone: any width will do. */
        s[i] = own->weight > 0 ? real_max(own->spread, coarse) : 1;
    }
    if (c->observed > 1)
        for (int i = 0; i < m; i++)
            if (c->left[i] != 0) change->added[i] = spread_added(m, i, c, R, s, seen, seen + m);
    for (int i = 0; i < m; i++) {
        spread_memory *const own = &memory[i];
        const real y = c->y[i], rest = own->rest, wider = nominal[i] * out[i], unit = s[i] * wider;
        /* No chance is to end a longer run: the difference of two innovations has twice the variance of one. */
        const real near = (patience ? SPREAD_FAR * real_sqrt(2) : SPREAD_AGREE) * unit;
        units[i] = unit;
        out[i] = 0;
        if (c->left[i] == 0) continue;
        coarse = spread_coarse(own, nominal[i]);
        change->width[i] = real_max(spread_tolerance(own, ratio[i], spread_minimax(own)) * s[i], bend[i] * coarse) /
                           SPREAD_BEND * wider;
        out[i] = size[i] > bend[i] * s[i];
        spread_repeat(own, z[i], out[i] == 0 && own->run == 0);
        spread_grow_old(own, unit, out[i] == 0);
        if (out[i] == 0) {
            if (own->run == 0) spread_grown(own, ratio[i], excess[i]);
            spread_end(own, unit);
            continue;
        }
        if (!(own->run > 0 && rest != 0 && (y > 0) == (rest > 0) &&
              (real_abs(y - rest) < near ||
               (real_abs(y) >= real_abs(rest) && real_abs(y) < SPREAD_STEEP * real_abs(rest)))))
            spread_end(own, unit);
        own->run += 1;
        /* Back where the state was before a jump. */
        if (own->jump != 0 && real_abs(y + own->jump) < real_max(near, SPREAD_RETURN * real_abs(own->jump))) out[i] = 2;
    }
    for (int i = 0; i < m; i++) {
        spread_memory *const own = &memory[i];
        const real variance = c->S[i * m + i], b = variance - R[i * m + i];
        real bent, wanted;
        int tells;
        if (c->left[i] == 0 || out[i] == 0) continue;
        /* What its last reading says of the run, against no jump of a state that stands on R / H P H' readings. */
        e = c->y[i] / units[i];
        tells = own->run * e * e / 2 >= -real_log(SPREAD_RARE * ratio[i]);
        if (!spread_believed(own, c->y[i], units[i], out[i] == 2, tells, patience)) continue;
        if (change->added[i] > 0 || !(b > 0)) continue;
        bent = size[i] / (bend[i] * s[i]);
        wanted = real_min(bent * bent - 1, SPREAD_GROWTH) * variance;
        /* What creeps away is moved by all that correlates; what is suddenly far, by what the sensor sees. */
        if (size[i] < SPREAD_SUDDEN * s[i])
            for (int k = 0; k < n; k++) {
                if (spread_moved(n, k, P, c->C + i * n, spread_informs(n, P, c->C + i * n)))
                    change->growth[k] = real_max(change->growth[k], real_sqrt(1 + wanted / b));
            }
        else
            change->opened[i] = wanted;
        change->grows = 1;
        /* Believed: as large as is usual. Nobody else asks for its width or its run any more. */
        change->width[i] = real_abs(c->y[i]);
        if (out[i] == 2 && real_abs(own->jump) > SPREAD_SUDDEN * units[i])
            spread_outcome(own, own->age == 0, own->age - 1);
        own->age = out[i] < 2 ? own->run : 0;
        spread_forgive(own, own->age > 0 ? c->y[i] : 0);
    }
}

/* Let P grow by what has jumped: growth of all that correlates, and the variances of what each sensor sees and tells
   much of, where the rest follows by its covariances; the order of the sensors does not matter. work: 2 n. */
CALLED void spread_open(const int n, const int m, const real *H, const spread_change *const change, real *RESTRICT P,
                        real *RESTRICT work) {
    real *const c = work, *const added = work + n;
    for (int k = 0; k < n; k++) {
        added[k] = 0;
        for (int j = 0; j < n; j++) P[k * n + j] *= change->growth[k] * change->growth[j];
    }
    for (int i = 0; i < m; i++) {
        const real *const h = H + i * n;
        real most, seen = 0;
        if (!(change->opened[i] > 0)) continue;
        for (int k = 0; k < n; k++) c[k] = real_dot(n, P + k * n, h);
        most = spread_informs(n, P, c);
        for (int k = 0; k < n; k++) {
            if (!spread_moved(n, k, P, c, most)) c[k] = 0;
            if (c[k] != 0) seen += h[k] * h[k] * P[k * n + k];
        }
        for (int k = 0; k < n && seen > 0; k++)
            if (c[k] != 0 && h[k] != 0) added[k] = real_max(added[k], change->opened[i] / seen * P[k * n + k]);
    }
    for (int k = 0; k < n; k++) P[k * n + k] += added[k];
}

/* Leave out of c, once more, the readings that say nothing new. */
INLINE void spread_leave_out(const int m, const spread_change *const change, correction *const c) {
    for (int i = 0; i < m; i++) {
        if (c->left[i] == 0 || !(change->width[i] < 0)) continue;
        c->left[i] = c->y[i] = 0;
        c->observed -= 1;
    }
}

/* Let readings that say nothing new weigh nothing. */
INLINE void spread_weigh(const int m, const spread_change *const change, correction *const c) {
    for (int i = 0; i < m; i++)
        if (change->width[i] < 0) c->weights[i] = 0;
}

/* Remember what the correction left of z - H x, and of H P H' / R. */
INLINE void spread_after(const int n, const int m, const real *z, const real *H, const real *R, const real *x,
                         const real *P, const correction *const c, const spread_change *const change,
                         spread_memory *const memory) {
    for (int i = 0; i < m; i++) {
        if (c->weights[i] != c->weights[i]) continue;
        memory[i].rest = z[i] - real_dot(n, H + i * n, x);
        memory[i].left = spread_ratio(real_square(n, H + i * n, P), R[i * m + i],
                                      change->nominal[i] * change->nominal[i]);
    }
}

#endif

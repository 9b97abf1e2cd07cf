/* How each sensor's spread is learnt: what its innovations usually are, in units of what S says.

   The spread is a median by recursion of |e|, e = y / sqrt(S_ii), without the far ones. What a sensor is noisier than
   those that see the same is charged to its R; a run of clipped innovations that those who see the same do not
   contradict is a jump of the state, and P grows until it is plausible, where the sensor tells much of a state. Beside
   other sensors a far reading that repeats the one before counts only as far as that is usual: one that is stuck says
   nothing new. Where readings repeat, one smallest step between them is never clipped. */
#ifndef ROBUST_FILTERPY_SPREAD_H
#define ROBUST_FILTERPY_SPREAD_H

#include "correction.h"

/* What is known of one sensor, all 0 at first. */
typedef struct {
    real weight;  /* information that the spread rests on, sum of the roots of R_ii / S_ii; 0: no custom yet */
    real spread;  /* median of |e| over .6745, without the far ones */
    real share;   /* share of far innovations */
    real strange; /* far ones in a row */
    real run;     /* clipped ones in a row, of one sign, each where the last one left x */
    real rest;    /* z - H x after the last correction */
    real jump;    /* how far the last jump went, 0 if there was none to return from */
    real last;    /* the last reading */
    real repeats; /* share of ordinary readings that repeat the one before to the last bit */
    real step;    /* the smallest change of a reading, -1 before there is one, 0 before any reading */
} spread_memory;
#define SPREAD_NUMBERS 10

#define SPREAD_QUARTILE REAL(0.6744897501960817) /* median of |e| for a normal e of deviation 1 */
#define SPREAD_BEND REAL(1.345)                  /* beyond so many spreads an innovation counts as clipped */
#define SPREAD_FAR REAL(3.0)                     /* beyond so many it is an outlier, and does not move the spread */
#define SPREAD_PACE REAL(2.0)                    /* steps of log(spread): 2/n of n samples, */
#define SPREAD_FADING REAL(0.01)                 /* at least 2/100 */
#define SPREAD_MOST REAL(0.4)                    /* the largest share of outliers, */
#define SPREAD_YIELD REAL(1.5)                   /* and the threshold times 1 - 1.5 share */
#define SPREAD_PRIOR REAL(10.0)                  /* the share starts from so many without an outlier */
#define SPREAD_LOST 10                           /* so many far ones in a row, and the custom is another one */
#define SPREAD_RUN 4                             /* a jump: so many clipped in a row, */
#define SPREAD_AGREE REAL(2.5)                   /* each within so many spreads of where the last one left x */
#define SPREAD_RARE REAL(0.05)                   /* a share of outliers with which one innovation is a return, */
#define SPREAD_RETURN REAL(0.2)                  /* if it is within a fifth of the jump */
#define SPREAD_SPARED REAL(0.1)                  /* states that tell a tenth as much as another do not jump with it */
#define SPREAD_WHOLE REAL(0.01)                  /* a change within so much of a whole number of steps, */
#define SPREAD_STEPS REAL(1e6)                   /* up to so many, is steps */
#define SPREAD_LEAST REAL(0.1)                   /* of its width is left to a far one that repeats */
#define SPREAD_GROWTH REAL(1e6)                  /* the most that S grows by at one jump */
#define SPREAD_WITNESS REAL(0.47)                /* of the weight of those who see the same */
#define SPREAD_APART REAL(1.5)                   /* so much wider than they are is a sensor's own noise, */
#define SPREAD_CONTRADICTED REAL(2.0)            /* as is so far from what they say */
#define SPREAD_ROUNDING (1 + REAL(1e-9))          /* of sums of weights */

/* What a correction is to be changed by. */
typedef struct {
    real *width;  /* (m) unit of each sensor's innovation, in the unit of z */
    real *charge; /* (m) variance that is added to R */
    real *growth; /* (n) what each state's deviation grows by */
    int charges, grows;
} spread_change;

#define spread_work(n, m) ((size_t)((n) + 8 * (m)))

/* What one smallest step of a sensor whose readings repeat asks of its spread, in units of told; none: not above 0. */
INLINE real spread_coarse(const spread_memory *const own, const real told) {
    return own->repeats > 0 ? own->step / SPREAD_BEND / told : 0;
}

/* Let one |e| move the spread and the share of outliers; weight: the root of R_ii / S_ii. */
INLINE void spread_learn(spread_memory *const own, const real size, const real coarse, const real weight) {
    const real aim = size / SPREAD_QUARTILE;
    real known, pace, far;
    if (own->strange >= SPREAD_LOST) own->weight = own->share = own->strange = 0;
    known = own->weight;
    own->weight += weight;
    if (known == 0) {
        own->spread = aim;
        return;
    }
    pace = SPREAD_PACE * real_max(weight / known, SPREAD_FADING);
    far = size > SPREAD_FAR * real_max(own->spread, coarse) ? REAL(1.0) : REAL(0.0);
    /* Up or down by a pace, but never beyond what was seen. */
    if (aim > own->spread)
        own->spread = real_min(aim, own->spread * real_exp(real_min(pace * (1 - own->share), 700)));
    else
        own->spread = real_max(aim, own->spread * real_exp(-pace * (1 + own->share)));
    own->strange = far != 0 ? own->strange + 1 : 0;
    own->share += (far - own->share) * real_max(weight / (own->weight + SPREAD_PRIOR), SPREAD_FADING);
    own->share = real_min(own->share, SPREAD_MOST);
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
CALLED real spread_charge(const int m, const int i, const correction *const c, const real *R, const real *s,
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
    own = real_abs(c->y[i] - real_min(real_max(0, low), high)) / real_sqrt(variance) / SPREAD_CONTRADICTED;
    own = real_max(s[i], own);
    return own > SPREAD_APART * usual ? variance * (own / usual * (own / usual) - 1) : 0;
}

/* Whether those who see what sensor i sees do not contradict that the state has jumped; out: who is clipped. */
CALLED int spread_agreed(const int m, const int i, const correction *const c, const real *R, const real *out,
                         real *RESTRICT seen) {
    real agree = 0, against = 0;
    spread_seen(m, i, c, R, seen);
    for (int j = 0; j < m; j++) {
        const real same = c->y[j] * c->y[i] * (c->S[i * m + j] - R[i * m + j]);
        if (out[j] != 0 && same > 0) agree += seen[j];
        else against += seen[j];
    }
    return agree > against * SPREAD_ROUNDING;
}

/* Let the states grow that have jumped with sensor i, whose covariances with its prediction are c (n). */
INLINE void spread_grow(const int n, const real *RESTRICT P, const real *RESTRICT c, const real wanted,
                        real *RESTRICT growth) {
    real most = 0;
    for (int k = 0; k < n; k++)
        if (P[k * n + k] > 0) most = real_max(most, c[k] * c[k] / P[k * n + k]);
    for (int k = 0; k < n; k++)
        if (P[k * n + k] > 0 && c[k] * c[k] / P[k * n + k] > SPREAD_SPARED * most)
            growth[k] = real_max(growth[k], real_sqrt(1 + wanted));
}

/* How much one more innovation weighs in a share. */
INLINE real spread_step(const spread_memory *const own) {
    return real_max(1 / (own->weight + SPREAD_PRIOR), SPREAD_FADING);
}

/* Note a jump: the far ones in a row were no outliers, and where others are rare it may be undone at once. */
INLINE void spread_forgive(spread_memory *const own, const real jump) {
    own->share = real_max(own->share - own->strange * spread_step(own), 0);
    own->strange = own->run = 0;
    own->jump = own->share < SPREAD_RARE ? jump : 0;
}

/* Learn how usual it is that a reading repeats the one before; return what this one counts, less than 1 for a far one
   that repeats beside other sensors. */
INLINE real spread_repeat(spread_memory *const own, const real z, const int out, const int alone) {
    const real change = real_abs(z - own->last), step = own->step, usual = own->repeats;
    const int repeats = step != 0 && change == 0;
    if (step == 0) {
        own->step = -1;
    } else if (change > 0) {
        const real ratio = step > 0 ? change / step : 0;
        own->step = step > 0 ? real_min(change, step) : change;
        /* A change that is no whole number of steps: these readings are not quantized, or more finely. */
        if (!(ratio > REAL(0.5) && ratio < SPREAD_STEPS &&
              real_abs(ratio - (real)(int)(ratio + REAL(0.5))) < SPREAD_WHOLE))
            own->repeats = 0;
    }
    own->last = z;
    if (!out) own->repeats += ((repeats ? 1 : 0) - own->repeats) * spread_step(own);
    if (!out || !repeats || alone) return 1;
    own->strange = real_max(own->strange - (1 - usual), 0);
    own->run = real_max(own->run - (1 - usual), 0);
    return real_max(usual, SPREAD_LEAST);
}

/* Learn from the innovations of c and the readings z, before the correction; P and R are those behind c. */
CALLED void spread_before(const int n, const int m, const real *z, const real *P, const real *R,
                          const correction *const c, spread_memory *const memory, spread_change *const change,
                          real *work) {
    real *s, *told, *size, *out, *seen, coarse;
    change->growth = work;
    change->width = work + n;
    change->charge = work + n + m;
    s = work + n + 2 * m, told = s + m, size = told + m, out = size + m, seen = out + m; /* and m more */
    change->charges = change->grows = 0;
    for (int k = 0; k < n; k++) change->growth[k] = 1;
    for (int i = 0; i < m; i++) {
        const real variance = c->S[i * m + i];
        change->charge[i] = 0;
        told[i] = real_sqrt(variance);
        /* Below a number whose square is a number. */
        size[i] = real_min(real_abs(c->y[i]) / told[i], REAL_PRODUCT);
        coarse = spread_coarse(&memory[i], told[i]);
        if (c->left[i] != 0 && size[i] > 0)
            spread_learn(&memory[i], size[i], coarse,
                         real_sqrt(real_min(real_max(R[i * m + i] / variance, REAL(1e-9)), 1)));
        /* Who has no custom yet has shown exact zeros alone: any width will do. */
        s[i] = memory[i].weight > 0 ? real_max(memory[i].spread, coarse) : 1;
    }
    if (c->observed > 1)
        for (int i = 0; i < m; i++) {
            if (c->left[i] == 0) continue;
            change->charge[i] = spread_charge(m, i, c, R, s, seen, seen + m);
            change->charges |= change->charge[i] > 0;
        }
    for (int i = 0; i < m; i++) {
        spread_memory *const own = &memory[i];
        const real y = c->y[i], near = SPREAD_AGREE * s[i] * told[i];
        s[i] = real_max(s[i] * (1 - SPREAD_YIELD * own->share), spread_coarse(own, told[i]));
        change->width[i] = s[i] * told[i];
        if (c->left[i] == 0) {
            out[i] = 0;
            continue;
        }
        out[i] = size[i] > SPREAD_BEND * s[i];
        if (out[i] == 0)
            own->run = 0;
        else if (own->run > 0 && (y > 0) == (own->rest > 0) && own->rest != 0 && real_abs(y - own->rest) < near)
            own->run += 1;
        else
            own->run = 1;
        change->width[i] *= spread_repeat(own, z[i], out[i] != 0, c->observed == 1);
        /* Back where the state was before a jump. */
        if (out[i] != 0 && own->jump != 0 &&
            real_abs(y + own->jump) < real_max(near, SPREAD_RETURN * real_abs(own->jump)))
            out[i] = 2;
    }
    for (int i = 0; i < m; i++) {
        const real variance = c->S[i * m + i], b = variance - R[i * m + i];
        real bent, wanted;
        if (c->left[i] == 0 || (memory[i].run < SPREAD_RUN && out[i] < 2)) continue;
        if (change->charge[i] > 0 || !(b > 0)) continue;
        if (!spread_agreed(m, i, c, R, out, seen)) continue;
        bent = size[i] / (SPREAD_BEND * s[i]);
        wanted = real_min(bent * bent - 1, SPREAD_GROWTH) * variance / b;
        spread_grow(n, P, c->C + i * n, wanted, change->growth);
        change->grows = 1;
        /* Believed: as large as is usual. Nobody else asks for its width or its run any more. */
        change->width[i] = real_abs(c->y[i]);
        spread_forgive(&memory[i], out[i] < 2 ? c->y[i] : 0);
    }
}

/* Remember what the correction left of z - H x. */
INLINE void spread_after(const int n, const int m, const real *z, const real *H, const real *x,
                         spread_memory *const memory) {
    for (int i = 0; i < m; i++) {
        real predicted = 0;
        if (z[i] != z[i]) continue;
        for (int k = 0; k < n; k++) predicted += H[i * n + k] * x[k];
        memory[i].rest = z[i] - predicted;
    }
}

#endif

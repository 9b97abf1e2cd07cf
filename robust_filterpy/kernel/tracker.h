/* One sample of the recursive identification: robust_filterpy.identification.recursive.recursion in C.

   Predict theta, predict y from phi, leave out a sensor that is stuck, look again at outputs that were replaced,
   correct theta along the gradient, follow R, restrain an unstable step, remember. What is out of the ordinary (an
   overflow, a "unit" correction that takes off more than there is, a sample that tells very much unless P may be
   mended) is declined, and nothing has changed. */
#ifndef ROBUST_FILTERPY_TRACKER_H
#define ROBUST_FILTERPY_TRACKER_H

#include "correction.h"
#include "mend.h"
#include "prediction.h"
#include "repeats.h"

#define TRACKER_LARGEST REAL_PRODUCT /* size of a signal, whose square must not overflow */
#ifdef ROBUST_FILTERPY_FLOAT
#define TRACKER_SHARP REAL(1e2)    /* phi'phi tr(P)/R from which on rounding is to be mended, */
#define TRACKER_SHARPEST REAL(1e6) /* and from which on a sample is down-weighted */
#else
#define TRACKER_SHARP REAL(1e6)
#define TRACKER_SHARPEST REAL(1e13)
#endif
#define TRACKER_CLEANED REAL(3.0)    /* standard deviations from which on an output is replaced in phi */
#define TRACKER_EARLY REAL(20.0)     /* samples up to which P grows with R */
#define TRACKER_HALVINGS 30          /* 2^-30 of a step is none */

/* Why a sample was declined. */
enum tracker_refusal { TRACKER_NOT_FINITE, TRACKER_SINGULAR, TRACKER_INDEFINITE, TRACKER_TOO_SHARP };
enum guard { GUARD_NONE, GUARD_REJECT, GUARD_HALVE };

/* Where everything stands in phi, and what of the inputs. */
typedef struct {
    int na, nc, nd, nf;       /* past outputs, residuals, disturbances, outputs of B/F alone */
    int a, c, d, f;           /* where their coefficients begin */
    int inputs, lags, length; /* where those of the inputs begin, how many, and how many inputs are remembered */
    int starts;               /* how many inputs there are among them */
    const int *start;         /* (starts) where the newest of each stands among those remembered */
    const int *used;          /* (starts) which of u that is; -1 the constant */
    const int *source;        /* (lags) where in memory an input of phi stands; -1 - i: it is the newest of the i-th */
} tracker_layout;

/* What a recursion depends on besides its signals. */
typedef struct {
    correction_rule correction;
    int filtered, guard, cleans, learns; /* gradient filtered; enum guard; phi holds cleaned outputs; theta moves */
    int judges;                          /* whether a sensor may be found to be stuck */
    int mends;                           /* a sample that tells very much is taken, and P mended */
    const real *F, *Q;                   /* (n, n); F is NULL for I */
    real alpha_sq, windup;               /* P is multiplied by it, up to this trace */
} tracker_rule;

/* What is learned of the readings, and for how many samples the sensor has been stuck. */
typedef struct {
    repeats_memory repeats;
    real stuck;
} tracker_readings;

/* What is learned of R. */
typedef struct {
    real R, samples; /* and samples it stands on */
    real mean;       /* of min(e^2, 4) where R is right */
    real memory;     /* samples to remember; 0: R stays */
    real rounding;   /* steps of the sensor */
} tracker_scale;

/* What moves; past signals newest first. */
typedef struct {
    real *theta, *P;
    real *outputs, *measured; /* (na + nd) -y and -d as phi has them, and as they were measured */
    real *inputs;             /* (length) */
    real *residuals;          /* (nc) */
    real *undisturbed;        /* (nf) -w */
    real *prefiltered;        /* (max(nf, nd), n) past phi through 1/F */
    real *gradients;          /* (nc, n) derivatives of past predictions */
    tracker_scale *scale;
    tracker_readings *readings;
} tracker_state;

typedef struct {
    real prediction, residual, weight;
    int guard;
    int refused; /* enum tracker_refusal, of a sample that was declined */
} tracker_sample;

#define tracker_work(n) ((size_t)(n) * (size_t)(3 * (n) + 8))

/* A signal, at most TRACKER_LARGEST in size; 0 for NaN, which is inf - inf here. */
INLINE real tracker_bounded(const real value) {
    if (value != value) return 0;
    return real_min(real_max(value, -TRACKER_LARGEST), TRACKER_LARGEST);
}

/* Whether an innovation nu is one that a cleaned regressor replaces, phi being what it was predicted from. */
INLINE int tracker_is_far(const int n, const real nu, const real *RESTRICT phi, const real *RESTRICT P, const real r) {
    return real_abs(nu) > TRACKER_CLEANED * real_sqrt(real_max(real_square(n, phi, P), 0) + r);
}

/* Note a reading that was not left out and what was not foreseen of it. */
INLINE void tracker_note(const real y, const real nu, tracker_readings *const readings) {
    /* While a sensor was stuck it says nothing of its habits. */
    if (readings->stuck > 0) readings->repeats.seldom = real_abs(readings->repeats.seldom);
    readings->stuck = 0;
    repeats_note_reading(y, &readings->repeats);
    repeats_note_change(nu, &readings->repeats);
    readings->repeats.left = nu;
}

/* Put a row of n, or a value, in front of past ones; the oldest goes. */
INLINE void tracker_push_row(const int count, const int n, real *past, const real *newest) {
    for (int i = count * n - 1; i >= n; i--) past[i] = past[i - n];
    if (count) real_copy(n, newest, past);
}

INLINE void tracker_push(const int count, real *past, const real newest) { tracker_push_row(count, 1, past, &newest); }

/* Whether z^count + c_1 z^(count-1) + .. has all its roots inside the unit circle, by Schur's and Cohn's recursion. */
INLINE int tracker_is_stable(int count, const real *coefficients, real *c, real *shorter) {
    for (int i = 0; i < count; i++) c[i] = coefficients[i];
    while (count--) {
        const real k = c[count], d = 1 - k * k;
        if (!(k > -1 && k < 1)) return 0; /* NaN as well */
        for (int i = 0; i < count; i++) shorter[i] = (c[i] - k * c[count - 1 - i]) / d;
        for (int i = 0; i < count; i++) c[i] = shorter[i];
    }
    return 1;
}

/* Whether the polynomials of theta that feed back, F and C, are stable; work: 2 n. */
INLINE int tracker_are_stable(const tracker_layout *const l, const int n, const real *theta, real *work) {
    return tracker_is_stable(l->nf, theta + l->f, work, work + n) &&
           tracker_is_stable(l->nc, theta + l->c, work, work + n);
}

/* Bring theta as far towards its new value as stability lets it; return how often its step was halved, -1 for all. */
INLINE int tracker_restrain(const tracker_layout *const l, const int n, const int guard, const real *old, real *theta,
                            real *work) {
    real *const shorter = work + 2 * n;
    real share = 1;
    if (guard == GUARD_NONE || tracker_are_stable(l, n, theta, work)) return 0;
    for (int halvings = 1; guard == GUARD_HALVE && halvings <= TRACKER_HALVINGS; halvings++) {
        share *= REAL(0.5);
        for (int i = 0; i < n; i++) shorter[i] = old[i] + share * (theta[i] - old[i]);
        if (tracker_are_stable(l, n, shorter, work)) {
            real_copy(n, shorter, theta);
            return halvings;
        }
    }
    real_copy(n, old, theta);
    return -1;
}

/* phi, from what is remembered and the newest inputs u. */
INLINE real tracker_input(const tracker_layout *const l, const int i, const real *u) {
    return l->used[i] < 0 ? 1 : u[l->used[i]];
}

INLINE void tracker_regressor(const tracker_layout *const l, const tracker_state *const s, const real *u, real *phi) {
    real_copy(l->na, s->outputs, phi + l->a);
    real_copy(l->nd, s->outputs + l->na, phi + l->d);
    real_copy(l->nf, s->undisturbed, phi + l->f);
    real_copy(l->nc, s->residuals, phi + l->c);
    for (int i = 0; i < l->lags; i++) {
        const int source = l->source[i];
        phi[l->inputs + i] = source < 0 ? tracker_input(l, -1 - source, u) : s->inputs[source];
    }
}

/* Write the derivative of the prediction into g and what of it goes through F alone into chi: chi = phi/F for what goes
   through B/F, phi for past outputs; C g = D chi for these, = phi for the others. */
INLINE void tracker_differentiate(const tracker_layout *const l, const int n, const tracker_state *const s,
                                  const real *theta, const real *phi, real *RESTRICT g, real *RESTRICT chi) {
    real_copy(n, phi, g);
    for (int k = 0; k < l->nf; k++)
        for (int i = l->na; i < l->c; i++) g[i] -= theta[l->f + k] * s->prefiltered[k * n + i];
    for (int i = 0; i < n; i++) chi[i] = i < l->c ? g[i] : 0;
    for (int k = 0; k < l->nd; k++)
        for (int i = 0; i < l->c; i++) g[i] += theta[l->d + k] * s->prefiltered[k * n + i];
    for (int k = 0; k < l->nc; k++)
        for (int i = 0; i < n; i++) g[i] -= theta[l->c + k] * s->gradients[k * n + i];
}

/* R after one more innovation nu of variance S. */
INLINE void tracker_follow(tracker_scale *const scale, const real nu, const real S) {
    const real share = scale->R / S, early = real_min(1, 5 / (scale->samples + 1));
    const real gain = share * real_max(REAL(1.5) / scale->memory, early);
    const real surprise = real_min(nu * nu / S, 4) / scale->mean - 1;
    /* A plant at rest shows no noise in steps of its sensor, one that moves does. */
    const real least = real_max(scale->rounding * scale->rounding / 12, 1 / REAL_ORDINARY / REAL_ORDINARY);
    scale->R = real_max(scale->R * real_exp(gain * surprise), least);
    scale->samples += share;
}

/* What a correction by a sharp sample left of P in the direction h is the difference of large numbers: write there what
   it is, C left, C being P h before; v = h'C. Then mend the rest. work: mend_work. */
CALLED void tracker_mend(const int n, const real *h, const real *C, const real v, const real left, real *P,
                         real *work) {
    real *const delta = work, along = 0;
    for (int i = 0; i < n; i++) {
        delta[i] = C[i] * left - real_dot(n, P + i * n, h);
        along += delta[i] * h[i];
    }
    for (int i = 0; i < n && v > 0; i++)
        for (int j = 0; j <= i; j++)
            P[i * n + j] = P[j * n + i] =
                P[i * n + j] + ((delta[i] * C[j] + C[i] * delta[j]) - C[i] * C[j] * (along / v)) / v;
    mend(n, P, work);
}

/* Correct x and P by the innovation nu of variance S, r of it noise, C its covariance with x; return whether all was
   ordinary. g: NULL, or the row that is measured where it tells so much that P is to be mended; work: mend_work. */
INLINE int tracker_correct(const int n, const tracker_rule *const rule, const real nu, const real S, const real r,
                           real *RESTRICT x, real *RESTRICT P, real *RESTRICT C, const real *g,
                           tracker_sample *const sample, real *work) {
    real y = nu, variance = S, left = 1, e = 0, weight = 1, slope, d = 0, t = 1, first;
    correction c = {.y = &y, .C = C, .S = &variance, .e = &e, .weights = &weight, .slopes = &slope, .d = &d, .t = &t,
                    .first = &first, .left = &left, .product = 1, .observed = 1};
    const int fine = correct(n, 1, &rule->correction, NULL, x, P, &c);
    if (!(real_abs(e) < REAL_ORDINARY)) return 0;
    sample->weight = weight;
    /* Under "unit" P becomes indefinite where its variance along the gradient, times d, is 1 or more. */
    if (rule->correction.scaling == SCALING_UNIT && !(d * (S - r) < REAL(0.999))) {
        sample->refused = TRACKER_INDEFINITE;
        return 0;
    }
    if (!fine || !g) return fine;
    for (int i = 0; i < n; i++) C[i] /= t;
    tracker_mend(n, g, C, S - r, t == 1 ? 1 - d * (S - r) : (r + (1 - d) * (S - r)) / S, P, work);
    return correction_is_settled(n, x, P);
}

/* Take one sample: y, NaN where missing, and the inputs u; given: its R, NaN for the state's. work: tracker_work. */
INLINE int tracker_step(const tracker_layout *const l, const int n, const tracker_rule *const rule,
                        const tracker_state *const s, const real y, const real *u, const real given,
                        tracker_sample *const sample, real *work) {
    real *const x = work, *const P = x + n, *const W = P + n * n, *const phi = W + 2 * n * n, *const g = phi + n;
    real *const chi = g + n, *const C = chi + n, *const rest = C + n; /* rest: 3 n */
    const int past = l->na + l->nd, rows = l->nf > l->nd ? l->nf : l->nd;
    const int feeds_back = l->nf + l->nc > 0;
    const int filtered = rule->filtered && l->nf + l->nc + l->nd > 0;
    const real r = given == given ? given : s->scale->R;
    real trace = 0, predicted, S = r, before = 0, alone = 0, after, believed;
    real grown = 1, tempered = 1;
    tracker_scale scale = *s->scale;
    int here = y == y, again = 0, outlying = 0, sharp = 0, stuck = 0;
    sample->refused = TRACKER_NOT_FINITE;
    tracker_regressor(l, s, u, phi);
    for (int i = 0; i < n; i++) trace += s->P[i * n + i];
    if (rule->learns && (rule->alpha_sq == 1 || trace <= rule->windup)) {
        if (rule->F) {
            if (!predict(n, s->theta, s->P, rule->F, rule->Q, NULL, rule->alpha_sq, x, P, W)) return 0;
        } else {
            real_copy(n, s->theta, x);
            for (int i = 0; i < n * n; i++) P[i] = rule->alpha_sq * s->P[i] + rule->Q[i];
        }
        trace = 0;
        for (int i = 0; i < n; i++) trace += P[i * n + i];
    } else {
        /* Frozen, or wound up under forgetting. */
        real_copy(n, s->theta, x);
        real_copy(n * n, s->P, P);
    }
    predicted = real_dot(n, phi, x);
    if (!(trace < REAL_MAX && real_abs(predicted) < REAL_ORDINARY)) return 0;
    sample->prediction = predicted;
    if (rule->judges && here && repeats_again(y, r, &s->readings->repeats))
        stuck = s->readings->stuck > 0 || tracker_is_far(n, y - predicted, phi, P, r);
    /* What is stuck counts as missing. */
    here = here && !stuck;
    sample->residual = here ? y - predicted : (real)NAN;
    sample->weight = (real)NAN;
    sample->guard = 0;
    if (rule->cleans && here) {
        /* Where the outputs as measured explain this one and those put in their place do not, they were right. */
        real explained = predicted;
        for (int i = 0; i < l->na; i++) explained += (s->measured[i] - s->outputs[i]) * x[l->a + i];
        for (int i = l->na; i < past; i++) explained += (s->measured[i] - s->outputs[i]) * x[l->d + i - l->na];
        if (explained != predicted && real_abs(y - explained) < real_abs(y - predicted) &&
            tracker_is_far(n, y - predicted, phi, P, r)) {
            real_copy(n, phi, rest);
            real_copy(l->na, s->measured, rest + l->a);
            real_copy(l->nd, s->measured + l->na, rest + l->d);
            /* Wild outputs explain no other wild one by being about as far out. Outputs that were replaced by what a
               wrong theta predicted run away, and those as measured are the smaller ones. */
            again = real_max(real_square(n, rest, P), 0) <= real_max(real_square(n, phi, P), 0) ||
                    !tracker_is_far(n, y - explained, rest, P, r);
        }
        if (again) {
            predicted = explained;
            real_copy(n, rest, phi);
        }
    }
    if (filtered && (rule->guard != GUARD_NONE || tracker_are_stable(l, n, x, rest))) {
        tracker_differentiate(l, n, s, x, phi, g, chi);
    } else {
        real_copy(n, phi, g);
        for (int i = 0; i < n; i++) chi[i] = i < l->c ? phi[i] : 0;
    }
    {
        const real size = real_dot(n, g, g), prefiltered = l->nf ? real_dot(n, chi, chi) : 0;
        const real limit = TRACKER_LARGEST * TRACKER_LARGEST;
        if (!(size < limit && prefiltered < limit)) return 0;
        sharp = rule->learns && here && !(size * trace <= TRACKER_SHARP * r);
        if (sharp && !rule->mends) {
            sample->refused = TRACKER_TOO_SHARP;
            return 0;
        }
        if (sharp && size * trace > TRACKER_SHARPEST * r)
            tempered = real_sqrt(TRACKER_SHARPEST / size) * real_sqrt(r / trace);
    }
    if (rule->learns && here) {
        const real nu = y - predicted;
        real own;
        for (int i = 0; i < n; i++) C[i] = real_dot(n, P + i * n, g);
        S = real_dot(n, g, C);
        own = real_max(S, 0);
        S = own + r;
        if (!(S > 0)) sample->refused = TRACKER_SINGULAR;
        if (!(S > 0 && S < REAL_ORDINARY)) return 0;
        outlying = real_abs(nu) > TRACKER_CLEANED * real_sqrt(S);
        /* g and nu times a factor: a sample that tells less. */
        for (int i = 0; i < n && tempered < 1; i++) C[i] *= tempered, rest[i] = tempered * g[i];
        if (!tracker_correct(n, rule, tempered * nu, tempered * tempered * own + r, r, x, P, C,
                             sharp ? (tempered < 1 ? rest : g) : NULL, sample, W))
            return 0;
        /* What vanishes against R says nothing, as while input and output rest, and teaches no noise either. */
        if (given != given && scale.memory > 0 && S + nu * nu != r) {
            tracker_follow(&scale, nu, S);
            if (s->scale->samples < TRACKER_EARLY && scale.R > r) grown = scale.R / r;
        }
    }
    if (rule->learns && feeds_back) sample->guard = tracker_restrain(l, n, rule->guard, s->theta, x, rest);
    /* All is well: from here on the state changes. */
    after = real_dot(n, phi, x);
    believed = here && !(rule->cleans && outlying) ? y : tracker_bounded(predicted);
    for (int i = l->na; i < l->c; i++) alone += phi[i] * x[i];
    for (int i = 0; i < l->c; i++) before += phi[i] * x[i];
    before = tracker_bounded(before);
    if (stuck) s->readings->stuck += 1;
    else if (rule->judges && here) tracker_note(y, y - predicted, s->readings);
    tracker_push(l->nf, s->undisturbed, -tracker_bounded(alone));
    if (again) real_copy(past, s->measured, s->outputs);
    tracker_push(l->na, s->outputs, -believed);
    tracker_push(l->nd, s->outputs + l->na, before - believed);
    tracker_push(l->na, s->measured, here ? -y : -tracker_bounded(predicted));
    tracker_push(l->nd, s->measured + l->na, before - (here ? y : tracker_bounded(predicted)));
    tracker_push(l->nc, s->residuals, here ? tracker_bounded(believed - after) : 0);
    for (int i = l->length - 1; i > 0; i--) s->inputs[i] = s->inputs[i - 1];
    for (int i = 0; i < l->starts; i++) s->inputs[l->start[i]] = tracker_input(l, i, u);
    if (filtered) {
        tracker_push_row(l->nc, n, s->gradients, g);
        tracker_push_row(rows, n, s->prefiltered, chi);
    }
    real_copy(n, x, s->theta);
    for (int i = 0; i < n * n; i++) s->P[i] = grown == 1 ? P[i] : P[i] * grown;
    *s->scale = scale;
    return 1;
}

#endif

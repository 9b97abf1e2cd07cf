/* Noise that is learned, models of a filter side by side: robust_filterpy.correction.learnt, .learning, .side_by_side
   in C.  q models take the process noise for s_j Q. If jumps are possible there is one more for a state that has
   jumped, the candidate, whose probability is 0 while there is none. Each sensor is conditioned on by the score of its
   mixture of classes and the derivative of it, the most plausible first, under every model. A sensor's memory is a row
   of numbers: [r, samples, shares (K), last (K), counts (K, K), habits]. */
#ifndef ROBUST_FILTERPY_LEARNT_H
#define ROBUST_FILTERPY_LEARNT_H

#include "prediction.h"
#include "repeats.h"
#include "update.h"

#define LEARNT_TOGETHER REAL(1e8)     /* standard deviations that one counts for where all are weighed together */
#define LEARNT_REACH REAL(8.0)        /* standard deviations of the widest class that an innovation counts for */
#define LEARNT_LOG_2PI REAL(1.8378770664093454836)
#define LEARNT_LESS REAL(0.1)
#define LEARNT_LOG_DECIDES REAL(6.9077552789821371) /* a thousand to one */
#define LEARNT_COLOUR REAL(0.99)       /* noise that never changes is an offset, of which no reading rids a filter */
#define LEARNT_WILDEST REAL(1e6)
#define LEARNT_FIRST REAL(20.0)        /* parity and changes tell something from here on */
#define LEARNT_MOST REAL(8.0) / 6      /* r at most, over the variance of the differences of changes */
#define LEARNT_REDUNDANT REAL(1e-6)
#define LEARNT_OWN REAL(5.0)           /* a sensor's noise is a fifth of its parity or more where its color counts fully */
#define LEARNT_ASKS REAL(9.0)         /* squared standard deviations from which an innovation asks for a jump */
#define LEARNT_WIDEST REAL(1e12)       /* a state less certain than a sensor's noise by this is left to the definition */
#define LEARNT_FARTHEST REAL(1e24)     /* and to which it can tell where to */
#define LEARNT_FAR REAL(1e8)          /* squared standard deviations: a jump of more makes P no wider */
#define LEARNT_LEFT REAL(0.01)        /* of a jump's square, left of the variance of what a sensor sees: less is rounding */
#define LEARNT_UNLIKELY REAL(1e-30)   /* of a scale that one of two parts contradicts, left where they become one */
#define LEARNT_EVIDENCE REAL(100.0)   /* a sample is not worth more for a jump */
#define LEARNT_TELLS REAL(30.0)       /* one that is worth so much for a jump tells nothing of the scale of Q */
#define LEARNT_SHOWN REAL(0.25)       /* a candidate that is less probable is hidden, */
#define LEARNT_ALONE REAL(0.95)       /* and all else while it is more probable than that */
#define LEARNT_TAKEN REAL(0.999)      /* a candidate that is so probable is taken over */
#define LEARNT_DROPPED REAL(0.01)     /* one whose probability is this part of a jump's is dropped, or is this where parts join */

#define LEARNT_DECIDES REAL(50.0)      /* readings of a part from which on its factor may be taken, */
#define LEARNT_DECIDED (2 * LEARNT_DECIDES) /* and after which it is 1 if it is near 1 */
#define LEARNT_LOG_BEYOND REAL(3.4011973816621555) /* less is left to the scales of Q and to r */
#define LEARNT_RARE REAL(0.2)          /* of a sensor with more outliers than that a run of them may be no jump */
#define LEARNT_LOG_FARTHEST REAL(27.631021115928547)


typedef struct {
    real chance;   /* that a reading begins a jump */
    real size;     /* the last jump in standard deviations of R */
    real began;    /* the innovation that a candidate began with, 0 if none did with this sensor, */
    real outliers; /* and how many outliers there were since */
} jumps_memory;

/* The last numbers of a sensor's row. */
typedef struct {
    spread_memory spread;
    real together;  /* probability that it fails with others */
    real less;      /* how much likelier a tenth of r is, in logarithms */
    jumps_memory jumps;
    struct {
        real last, covariance, variance, count; /* covariance: of one with the next */
    } parity;
    repeats_memory repeats;
} learnt_habits;

/* A sensor's row. */
typedef struct {
    real *RESTRICT r;            /* factor of R */
    real *RESTRICT samples;      /* that it stands on */
    real *RESTRICT shares;       /* (K) of the classes of late */
    real *RESTRICT last;         /* (K) probabilities of the last sample's class */
    real *RESTRICT counts;       /* (K, K) how often one class followed another */
    learnt_habits *RESTRICT habits;
} learnt_memory;

/* The noises that a filter is given. */
typedef struct {
    int q;               /* scales of the process noise */
    int K;               /* classes of the measurement noise */
    const real *process; /* (q) */
    const real *scales;  /* (K), ascending from 1 */
    const real *begin;   /* (width) a sensor's row before the first sample */
    real stay;           /* probability that the scale of the process stays */
    real jump;           /* chance of a jump in a step, 0 for never */
    real memory, r_memory;
    int learns;          /* else the classes' probabilities are given, and r is 1 */
    const real *drawn;   /* (q) probabilities of the scales where the process draws one anew in each step, or NULL */
    int joint;           /* whether all sensors fail together, and have one row */
    int named;           /* so many sensors fail with the first one of their group .. */
    const real *leads;   /* (named) .. whose place this is */
} learnt_rule;

/* Probability of model c before the first step: a Q is wrong by a factor with its inverse as chance. */
INLINE real learnt_begins(const learnt_rule *const rule, const int c) {
    real total = 0, own = 0;
    for (int j = 0; j < rule->q; j++) {
        const real factor = rule->process[j] / rule->process[0], chance = real_min(factor, 1 / factor);
        total += chance;
        if (j == c) own = chance;
    }
    return own / total;
}

/* The models, and the rows of the sensors. */
typedef struct {
    real *x;      /* (models, n), and that of the recursion as given */
    real *P;      /* (models, n, n), likewise */
    real *p;      /* (models + 2, n): for each state the probabilities of the models in its part, the chance that the part
                     has jumped since its last measurement, and the first state of the part; of the recursion as given its
                     evidence, how many readings there were, the factor of P, Q and R, (3, n) */
    real *memory; /* (m, width) */
} learnt_state;

INLINE int learnt_models(const learnt_rule *const rule) { return rule->jump > 0 ? rule->q + 1 : rule->q; }

/* Whether P, Q and R may have one wrong factor, so that the recursion as given goes on next to the models. */
INLINE int learnt_gives(const learnt_rule *const rule) { return rule->q > 1 && !rule->drawn; }

/* Rows of a state's x. */
INLINE int learnt_rows(const learnt_rule *const rule) { return learnt_models(rule) + learnt_gives(rule); }

/* The first sensor of those that fail with sensor i. */
INLINE int learnt_lead(const learnt_rule *const rule, const int i) {
    return rule->joint ? 0 : i < rule->named ? (int)rule->leads[i] : i;
}

/* Numbers of a state's p. */
INLINE int learnt_beliefs(const int n, const learnt_rule *const rule) {
    return (learnt_models(rule) + 2 + 3 * learnt_gives(rule)) * n;
}

INLINE real *learnt_unseen(const int n, const learnt_rule *const rule, const learnt_state *const s) {
    return s->p + learnt_models(rule) * n;
}

INLINE real *learnt_part(const int n, const learnt_rule *const rule, const learnt_state *const s) {
    return s->p + (learnt_models(rule) + 1) * n;
}

/* What the recursion as given has shown of each state's part. */
enum { LEARNT_FOR_FACTOR, LEARNT_READINGS, LEARNT_FACTOR };
INLINE real *learnt_given(const int n, const learnt_rule *const rule, const learnt_state *const s, const int which) {
    return s->p + (learnt_models(rule) + 2 + which) * n;
}

#define learnt_width(K) (2 + 2 * (K) + (K) * (K) + (int)(sizeof(learnt_habits) / sizeof(real)))

/* Where a row has its numbers. */
INLINE learnt_memory learnt_of_row(const int K, real *const row) {
    real *const counts = row + 2 + 2 * K;
    const learnt_memory memory = {row, row + 1, row + 2, row + 2 + K, counts, (learnt_habits *)(counts + K * K)};
    return memory;
}

/* The memory of sensor i. */
INLINE learnt_memory learnt_of(const learnt_rule *const rule, const learnt_state *const s, const int i) {
    return learnt_of_row(rule->K, s->memory + (rule->joint ? 0 : i * learnt_width(rule->K)));
}

/* Its memory of jumps, NULL where nothing is learned of them. */
INLINE jumps_memory *learnt_jumps(const learnt_rule *const rule, const learnt_state *const s, const int i) {
    return rule->learns && !rule->joint && rule->named == 0 ? &learnt_of(rule, s, i).habits->jumps : NULL;
}

/* Whether what each sensor does usually is followed. */
INLINE int learnt_follows(const learnt_rule *const rule) { return rule->learns && !rule->joint; }

/* Whether each part is named by its first state. */
INLINE int learnt_has_parts(const int n, const learnt_rule *const rule, const learnt_state *const s) {
    const real *const part = learnt_part(n, rule, s);
    for (int i = 0; i < n; i++)
        if (!(part[i] >= 0 && part[i] <= (real)i && part[i] == (real)(int)part[i] && part[(int)part[i]] == part[i]))
            return 0;
    return 1;
}

/* Let the probabilities of state i, count of them, n apart, add to 1. */
INLINE void learnt_normalize(const int n, const int i, const int count, real *RESTRICT p) {
    real total = 0;
    for (int c = 0; c < count; c++) total += p[c * n + i];
    for (int c = 0; c < count; c++) p[c * n + i] /= total;
}

/* Let the parts of two states be one: with the scales that are likely in both, what was likely at first counted once, and
   a candidate of either, which in the part that has none follows the first model. */
INLINE void learnt_join(const int n, const learnt_rule *const rule, learnt_state *const s, const int i, const int k) {
    real *const part = learnt_part(n, rule, s), *const unseen = learnt_unseen(n, rule, s), *const p = s->p;
    const real low = real_min(part[i], part[k]), high = real_max(part[i], part[k]);
    if (low == high) return;
    const int one = (int)low, other = (int)high, q = rule->q;
    real jumped = rule->jump > 0 ? real_max(p[q * n + one], p[q * n + other]) : 0;
    if (jumped < LEARNT_DROPPED) jumped = 0;
    for (int o = 0; jumped > 0 && o < n; o++) {
        if (!(part[o] == low || part[o] == high) || p[q * n + o] >= LEARNT_DROPPED) continue;
        s->x[q * n + o] = s->x[o];
        real_copy(n, s->P + o * n, s->P + (q * n + o) * n);
    }
    for (int c = 0; c < q; c++)
        p[c * n + one] = real_max(p[c * n + one] * p[c * n + other] / learnt_begins(rule, c), LEARNT_UNLIKELY);
    learnt_normalize(n, one, q, p);
    for (int c = 0; c < q; c++) p[c * n + one] *= 1 - jumped;
    if (rule->jump > 0) p[q * n + one] = jumped;
    unseen[one] = real_max(unseen[one], unseen[other]);
    for (int o = 0; o < n; o++) {
        if (!(part[o] == low || part[o] == high)) continue;
        for (int c = 0; c < learnt_models(rule); c++) p[c * n + o] = p[c * n + one];
        unseen[o] = unseen[one], part[o] = low;
    }
}

/* Mean and covariance of a mixture of h models, whose weights (h, n) in the part of each state add to 1. */
INLINE void learnt_collapse(const int n, const int h, const real *RESTRICT weights, const real *RESTRICT means,
                            const real *RESTRICT covariances, const real *RESTRICT part, real *RESTRICT x,
                            real *RESTRICT P) {
    for (int i = 0; i < n; i++) x[i] = 0;
    for (int i = 0; i < n * n; i++) P[i] = 0;
    for (int c = 0; c < h; c++)
        for (int i = 0; i < n; i++) x[i] += weights[c * n + i] * means[c * n + i];
    for (int c = 0; c < h; c++) {
        const real *RESTRICT from = covariances + c * n * n, *RESTRICT mean = means + c * n;
        for (int i = 0; i < n; i++) {
            const real w = weights[c * n + i], apart = mean[i] - x[i];
            if (!(w > 0)) continue;
            for (int j = 0; j < n; j++)
                if (part[i] == part[j]) P[i * n + j] += w * (from[i * n + j] + apart * (mean[j] - x[j]));
        }
    }
}

/* Mean and covariance over the models that have not jumped; work (q n). */
INLINE void learnt_slow(const int n, const learnt_rule *const rule, const learnt_state *const s, real *RESTRICT x,
                        real *RESTRICT P, real *RESTRICT work) {
    real_copy(rule->q * n, s->p, work);
    for (int i = 0; i < n; i++) learnt_normalize(n, i, rule->q, work);
    learnt_collapse(n, rule->q, work, s->x, s->P, learnt_part(n, rule, s), x, P);
}

/* Mean and covariance of the state; an unlikely jump is hidden, or all but a likely one. Return whether
   these are numbers and no variance is below 0. */
INLINE int learnt_merge(const int n, const learnt_rule *const rule, const learnt_state *const s, real *RESTRICT x,
                        real *RESTRICT P, real *RESTRICT work) {
    const int q = rule->q, models = learnt_models(rule);
    real_copy(models * n, s->p, work);
    for (int i = 0; i < n; i++) {
        if (models > q && !(work[q * n + i] > LEARNT_SHOWN)) work[q * n + i] = 0;
        for (int c = 0; models > q && work[q * n + i] > LEARNT_ALONE && c < q; c++) work[c * n + i] = 0;
        learnt_normalize(n, i, models, work);
    }
    learnt_collapse(n, models, work, s->x, s->P, learnt_part(n, rule, s), x, P);
    for (int i = 0; learnt_gives(rule) && i < n; i++) {
        /* What the recursion as given foretells better is shown as it has it. */
        const real *const readings = learnt_given(n, rule, s, LEARNT_READINGS), *const given = s->P + models * n * n;
        const real *const better = learnt_given(n, rule, s, LEARNT_FOR_FACTOR);
        if (!(readings[i] < LEARNT_DECIDED && better[i] >= LEARNT_LOG_DECIDES)) continue;
        x[i] = s->x[models * n + i];
        for (int j = 0; j < n; j++) {
            const int too = readings[j] < LEARNT_DECIDED && better[j] >= LEARNT_LOG_DECIDES;
            P[i * n + j] = P[j * n + i] = too ? given[i * n + j] : 0;
        }
    }
    return correction_is_settled(n, x, P);
}

#define learnt_predict_work(n, models) ((size_t)(((models) + 1) * ((n) * (3 + (n))) + (n) * (n)) + predict_work(n))

/* Predict: mixed as the scale of the process may have changed, then moved. control is B u, or NULL. */
INLINE void learnt_predict(const int n, const learnt_rule *const rule, learnt_state *const s, const real *RESTRICT F,
                           const real *RESTRICT Q, const real *control, const real alpha_sq, real *RESTRICT work) {
    const int q = rule->q, models = learnt_models(rule);
    const real other = (1 - rule->stay) / (real)(q > 1 ? q - 1 : 1);
    int moved = q, wrong = 0, looks = 0;
    real *RESTRICT p = work, *RESTRICT origin = p + models * n, *RESTRICT x = origin + models * n;
    real *RESTRICT P = x + (models + 1) * n, *RESTRICT scaled = P + (models + 1) * n * n;
    real *const part = learnt_part(n, rule, s), *const unseen = learnt_unseen(n, rule, s);
    const real *const factor = learnt_given(n, rule, s, LEARNT_FACTOR);
    for (int i = 0; learnt_gives(rule) && i < n; i++) {
        wrong |= factor[i] != 1;
        looks |= learnt_given(n, rule, s, LEARNT_READINGS)[i] < LEARNT_DECIDED;
    }
    if (looks) {
        real_copy(n, s->x + models * n, x + models * n);
        real_copy(n * n, s->P + models * n * n, P + models * n * n);
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++)
            if (part[i] != part[k] && (F[i * n + k] != 0 || Q[i * n + k] != 0)) learnt_join(n, rule, s, i, k);
    for (int j = 0; j < q; j++) {
        for (int o = 0; o < n; o++) {
            p[j * n + o] = 0;
            for (int i = 0; i < q; i++)
                p[j * n + o] += origin[i * n + o] =
                    s->p[i * n + o] * (rule->drawn ? rule->drawn[j] : i == j ? rule->stay : other);
            for (int i = 0; i < q; i++) origin[i * n + o] /= p[j * n + o];
        }
        learnt_collapse(n, q, origin, s->x, s->P, part, x + j * n, P + j * n * n);
    }
    for (int i = 0; models > q && i < n; i++) {
        /* In parts without a candidate its place follows the first model. */
        const int there = s->p[q * n + i] > 0;
        real slow = 0, scale = 0;
        moved = there ? models : moved;
        p[q * n + i] = s->p[q * n + i];
        x[q * n + i] = there ? s->x[q * n + i] : x[i];
        real_copy(n, (there ? s->P + q * n * n : P) + i * n, P + (q * n + i) * n);
        for (int j = 0; j < q; j++) slow += p[j * n + i];
        for (int j = 0; j < q; j++) scale += p[j * n + i] / slow * real_log(rule->process[j]);
        origin[i] = real_sqrt(real_exp(scale));
        unseen[i] += rule->jump * (1 - unseen[i]);
    }
    real_copy(models * n, p, s->p);
    for (int j = 0; j <= models; j++) {
        if (j < models ? j >= moved : !looks) continue;
        for (int i = 0; i < n; i++)
            for (int k = 0; k <= i; k++) {
                /* Parts differ in their scales, and no Q is between them. */
                real times = j == models ? 1 : j < q ? rule->process[j] : origin[i] * origin[k];
                if (wrong && j < models) times *= real_sqrt(factor[i]) * real_sqrt(factor[k]);
                scaled[i * n + k] = times * Q[i * n + k];
            }
        (void)predict(n, x + j * n, P + j * n * n, F, scaled, control, alpha_sq, s->x + j * n, s->P + j * n * n,
                      scaled + n * n);
    }
}

/* Predict the class of a sensor's next sample. */
INLINE void learnt_predicted(const int K, const learnt_memory *const memory, real *RESTRICT p) {
    const real *RESTRICT counts = memory->counts;
    for (int j = 0; j < K; j++) p[j] = 0;
    for (int i = 0; i < K; i++) {
        real total = 0;
        for (int j = 0; j < K; j++) total += counts[i * K + j];
        total = memory->last[i] / total;
        for (int j = 0; j < K; j++) p[j] += total * counts[i * K + j];
    }
}

/* The classes of a sensor's next sample whatever the last one was. */
INLINE void learnt_typical(const int K, const learnt_memory *const memory, real *RESTRICT p) {
    for (int j = 0; j < K; j++) p[j] = 0;
    for (int i = 0; i < K; i++)
        for (int j = 0; j < K; j++) p[j] += memory->counts[i * K + j];
    learnt_normalize(1, 0, K, p);
}

/* Whether a sensor has been read as often as r remembers. */
INLINE int learnt_seasoned(const learnt_rule *const rule, const learnt_memory *const memory) {
    real total = 0;
    for (int k = 0; k < rule->K * rule->K; k++) total += memory->counts[k];
    return total > SPREAD_FEW + rule->r_memory;
}

/* Learn from a sample: p the probabilities of its classes, before those that were predicted, energy E[v^2 | class 0]/R,
   part the share of its variance that is noise. */
INLINE void learnt_learn(const learnt_rule *const rule, const real *RESTRICT p, const real *RESTRICT before,
                         const real used, const real excess, const real part, const learnt_memory *const memory) {
    const int K = rule->K;
    real *RESTRICT const r = memory->r, *RESTRICT const shares = memory->shares, *RESTRICT const last = memory->last;
    real *RESTRICT const counts = memory->counts;
    learnt_habits *RESTRICT const habits = memory->habits;
    const real *RESTRICT prior = rule->begin + 2 + 2 * K;
    const real keep = 1 - 1 / rule->memory, less = (1 - LEARNT_LESS) * part;
    /* A reading that repeats the one before, as its sensor does, tells of the noise only that it is less than a step,
       and it is no independent sample of white noise. */
    if (real_copysign(1, habits->repeats.seldom) > 0) {
        /* Of what is noise by a part it tells the square of that. One sample is never forgotten, else r would reel. */
        *memory->samples = 1 + (1 - 1 / rule->r_memory) * (*memory->samples - 1) + p[0] * part * part;
        *r += p[0] * (used * (1 + part * excess) - *r) / *memory->samples;
        *r = real_min(real_max(*r, REAL(1e-8)), REAL(1e8));
        habits->less -= p[0] * REAL(0.5) * (real_log(1 - less) + (1 + excess) * less / (1 - less));
        habits->less = real_max(habits->less, 0);
    }
    if (habits->less > LEARNT_LOG_DECIDES) {
        *r = real_max(LEARNT_LESS * *r, REAL(1e-8));
        *memory->samples = rule->begin[1];
        habits->less = 0;
    }
    for (int j = 0; j < K; j++) shares[j] += 1 / rule->r_memory * (p[j] - shares[j]);
    for (int i = 0; i < K; i++) {
        real total = 0;
        for (int j = 0; j < K; j++) total += counts[i * K + j];
        total = last[i] / total;
        for (int j = 0; j < K; j++) {
            const real moved = before[j] > 0 ? total * counts[i * K + j] * p[j] / before[j] : 0;
            counts[i * K + j] = prior[i * K + j] + keep * (counts[i * K + j] - prior[i * K + j]) + moved;
        }
    }
    habits->jumps.outliers += 1 - p[0];
    habits->jumps.chance *= 1 - 1 / real_min(real_max(habits->repeats.count, 1), rule->memory);
    for (int j = 0; j < K; j++) last[j] = p[j];
    /* Ordinary is what most samples are. */
    if (K > 1 && shares[0] < REAL(0.5)) {
        const real size = *r;
        real below = shares[0];
        int k = 0;
        while (below < REAL(0.5) && k < K - 1) below += shares[++k];
        real_copy(2 + 2 * K + K * K, rule->begin, r);
        *r = size * rule->scales[k];
    }
}

/* Note a parity; return its lag-one correlation, 0 while it tells nothing. */
INLINE real learnt_note_parity(real e, const real memory, learnt_habits *const habits) {
    real share, covariance, variance;
    habits->parity.count += 1;
    share = real_max(1 / memory, 1 / habits->parity.count);
    /* An outlier is no news about the color. */
    if (habits->parity.count > 6) e = real_within(e, 3 * real_sqrt(habits->parity.variance));
    e = real_within(e, REAL(1e100));
    covariance = habits->parity.covariance += share * (e * habits->parity.last - habits->parity.covariance);
    variance = habits->parity.variance += share * (e * e - habits->parity.variance);
    habits->parity.last = e;
    return habits->parity.count >= LEARNT_FIRST && variance > 0 ? real_min(covariance / variance, LEARNT_COLOUR) : 0;
}

/* A measurement that corrects the models, and what these are while sensor after sensor is taken. */
typedef struct {
    learnt_state *s;
    const real *z, *readings, *H, *R, *M; /* as learnt_correct has them */
    const real *part;
    real *y;     /* (models, m) */
    real *C;     /* (models, m, n) */
    real *S;     /* (models, m, m) */
    real *given; /* (models, K) probabilities of the classes */
    real *logs, *shares; /* (models) */
    real *at, *spread; /* (n), (n, n) mean and covariance over the models that have not jumped */
    real *direction; /* (n) in which a candidate has jumped */
    real *N;     /* (m, m) covariance of ordinary noise */
    real *left, *r, *start; /* (m) 1 where not yet used; factors of R; the largest S_ii at the beginning */
    real *head, *fresh; /* (m) first state of the part that a sensor sees; whether a candidate there is new, 2 where it began */
    real *goes_on; /* (m) whether a reading is about as far off as the last one, which was taken for an outlier */
    real *alike; /* (m) odds and density of a jump like the sensor's last one, where its reading alone began a candidate */
    real *before, *typical, *after, *shared; /* (K) shared: of the class that all sensors are in, if of one */
    real together; /* probability that they are */
    real *wide; /* (m) what the deviation of a sensor's widest class grows by */
    /* Of sensors that are taken at once: their places, what their widest classes grow by, under each model score and
       information (m), (m, m), energy and noise's part of the variance (m); scratch. */
    real *members, *stretched, *scores, *informations, *energies, *noises, *scratch;
} learnt_work;

#define learnt_parity_work(m) ((size_t)((m) * ((m) + 5)))
#define learnt_weigh_work(n, m, models, K) \
    ((size_t)((models) * ((m) * (4 + (n) + 2 * (m)) + (K) + 2 + (n)) + (n) * (2 + (n)) + (11 + 2 * (n) + (K)) * (m) + \
              4 * (K) + (3 + (K)) * (m) * (m)) + \
     learnt_parity_work(m))

/* The first state that sensor i sees, or 0. */
INLINE int learnt_sees(const int n, const real *RESTRICT H, const int i) {
    int k = 0;
    while (k < n && H[i * n + k] == 0) k++;
    return k < n ? k : 0;
}

/* The first state of the part that it sees. */
INLINE int learnt_head(const int n, const learnt_work *const w, const int i) {
    return (int)w->part[learnt_sees(n, w->H, i)];
}

/* Write what a reading of all sensors that are left leaves of the variance that each sees of the state, as a part of
   it. left_over (m, m), row (m): scratch. */
INLINE void learnt_kept(const int n, const int m, const learnt_work *const w, real *RESTRICT kept, real *RESTRICT
                        left_over, real *RESTRICT row) {
    real_multiply(m, n, n, w->H, w->spread, w->C);
    real_multiply_symmetric(m, n, w->C, w->H, left_over);
    for (int i = 0; i < m; i++) kept[i] = left_over[i * m + i];
    for (int j = 0; j < m; j++) {
        const real per = 1 / (left_over[j * m + j] + w->r[j] * w->R[j * m + j]);
        if (!(w->left[j] > 0 && per > 0 && real_is_finite(per))) continue;
        real_copy(m, left_over + j * m, row);
        real_shrink(m, per, row, left_over);
    }
    for (int i = 0; i < m; i++)
        kept[i] = kept[i] > 0 ? real_min(real_max(left_over[i * m + i] / kept[i], 0), 1) : 1;
}

/* Let r of each sensor that is left be nowhere less than its parity allows, and that of white noise which would leave
   the state as uncertain as noise with its color; note this sample's parity. */
INLINE void learnt_sizes(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, real
                         *RESTRICT work) {
    real *RESTRICT rest = work, *RESTRICT unit = rest + m * m, *RESTRICT column = unit + m, *RESTRICT out = column + m;
    real *RESTRICT colour = out + m, *RESTRICT correlation = colour + m, *RESTRICT r = w->r;
    const real *RESTRICT left = w->left;
    int count = 0, coloured = 0;
    for (int i = 0; i < m; i++) {
        /* Whom the others can stand in for is not one that is followed. */
        unit[i] = left[i] > 0 ? real_sqrt(real_max(r[i], 1) * w->R[i * m + i]) : 1;
        if (!(unit[i] > 0)) return;
        count += left[i] > 0;
    }
    if (count < 2) return;
    for (int i = 0; i < m * m; i++) rest[i] = i % (m + 1) == 0 && left[i / m] > 0 ? 1 : 0;
    /* What is left of the space of measurements when the state's part is taken out, direction by direction. */
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < m; i++) column[i] = left[i] > 0 ? w->H[i * n + k] / unit[i] : 0;
        real_multiply(m, m, 1, rest, column, out);
        const real length = real_dot(m, out, out), per = 1 / length;
        if (length > REAL(1e-16) * real_dot(m, column, column) && real_is_finite(per)) real_shrink(m, per, out, rest);
    }
    for (int i = 0; i < m; i++) {
        learnt_habits *const habits = learnt_of(rule, w->s, i).habits;
        real e = 0;
        colour[i] = 0;
        if (!(left[i] > 0 && rest[i * m + i] > LEARNT_REDUNDANT)) continue;
        for (int j = 0; j < m; j++) {
            out[j] = left[j] > 0 ? rest[i * m + j] / unit[j] : 0;
            if (left[j] > 0) e += out[j] * w->z[j];
        }
        e /= real_sqrt(real_square(m, out, w->R));
        if (!real_is_finite(e)) continue;
        correlation[i] = learnt_note_parity(e, rule->memory, habits);
        /* A color is that of the sensor of whose noise a parity is made. */
        colour[i] = real_min(real_max(LEARNT_OWN * correlation[i], 0), 1) * real_min(LEARNT_OWN * rest[i * m + i], 1);
        if (colour[i] > 0) {
            /* Samples that depend on each other are worth fewer, against R as given, which is worth begin[1] of them.
               */
            const real square = correlation[i] * correlation[i];
            const real worth = real_min(habits->parity.count, rule->memory) * (1 - square) / (1 + square);
            const real sure = worth / (worth + rule->begin[1]);
            const real least = real_exp(sure * real_log(real_min(real_max(habits->parity.variance, REAL(1e-8)), 1)));
            r[i] = real_max(r[i], real_exp((1 - colour[i]) * real_log(r[i]) + colour[i] * real_log(least)));
            coloured = 1;
        }
    }
    if (!coloured) return;
    learnt_kept(n, m, w, column, rest, out);
    for (int i = 0; i < m; i++) {
        const real part = correlation[i] * column[i];
        if (colour[i] > 0) r[i] *= real_exp(colour[i] * real_log((1 + part) / (1 - part)));
    }
}

/* What the models that have not jumped leave of a reading, in standard deviations of R, at most a million. */
INLINE real learnt_left(const int n, const int m, const learnt_work *const w, const int i) {
    const real y = w->z[i] - real_dot(n, w->H + i * n, w->at);
    return real_within(y / real_sqrt(w->R[i * m + i]), LEARNT_WILDEST);
}

/* A reading in the standard deviations that R gives, finite however small R is. */
INLINE real learnt_reading(const int m, const learnt_work *const w, const int i) {
    return real_within(w->readings[i] / real_sqrt(w->R[i * m + i]), REAL_MAX);
}

/* Whether an innovation is so far from a mean that it asks for a jump. */
INLINE int learnt_asks(const int n, const learnt_work *const w, const real *RESTRICT x, const real *RESTRICT P, const
                       int i, const real noise) {
    const real *const h = w->H + i * n, rest = w->z[i] - real_dot(n, h, x), seen = real_square(n, h, P);
    return seen > 0 && rest * rest / (seen + noise) > LEARNT_ASKS;
}

/* Whether a sensor is stuck: it repeats its last reading to the last bit, though it seldom does and its noise is white,
   and that was an outlier, or it asks for a jump of the models that have not jumped. */
INLINE int learnt_stuck(const int n, const int m, const learnt_work *const w, const int i, const learnt_memory *const
                        memory) {
    const real R = w->R[i * m + i];
    if (!(R > 0) || !repeats_again(learnt_reading(m, w, i), *memory->r, &memory->habits->repeats)) return 0;
    return learnt_asks(n, w, w->at, w->spread, i, *memory->r * R) || memory->last[0] < REAL(0.5);
}

/* Let r of each sensor be no more than eight times what the differences of unforeseen changes from reading to reading
   show, of which white noise makes 6 r, unless other sensors show more; note this change. */
INLINE void learnt_changes(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w) {
    for (int i = 0; i < m; i++) {
        const learnt_memory memory = learnt_of(rule, w->s, i);
        repeats_memory *const repeats = &memory.habits->repeats;
        if (!(w->left[i] > 0 && w->R[i * m + i] > 0)) continue;
        repeats_note_reading(learnt_reading(m, w, i), repeats);
        repeats_note_change(learnt_left(n, m, w, i), repeats);
        if (!(repeats->count > LEARNT_FIRST + 1)) continue;
        /* What others contradict by more than its noise is no motion of the state, however even its changes. */
        const real apart = memory.habits->parity.variance;
        const real most = real_max(real_max(1, repeats->scale * repeats->scale * LEARNT_MOST), apart * apart);
        w->r[i] = real_min(w->r[i], most);
        *memory.r = real_min(*memory.r, most);
    }
}

/* Innovations under one model, and their covariances with the state and each other without noise; return how large they
   are. */
INLINE real learnt_innovations(const int n, const int m, const int model, const learnt_work *const w) {
    const real *RESTRICT x = w->s->x + model * n, *RESTRICT P = w->s->P + model * n * n;
    real *RESTRICT C = w->C + model * m * n, *RESTRICT S = w->S + model * m * m, *RESTRICT y = w->y + model * m;
    real check = 0;
    for (int i = 0; i < m; i++) {
        y[i] = w->left[i] > 0 ? w->z[i] - real_dot(n, w->H + i * n, x) : 0;
        check += y[i] - y[i];
        y[i] = real_within(y[i], REAL_LARGE);
    }
    real_multiply(m, n, n, w->H, P, C);
    real_multiply_symmetric(m, n, C, w->H, S);
    return check;
}

/* A normal density without its factor (2 pi)^(-1/2). */
INLINE real learnt_normal(const real y, const real variance) {
    return real_exp(REAL(-0.5) * y / variance * y) / real_sqrt(variance);
}

/* Odds times density of a jump like the last one that a sensor has seen. */
INLINE real learnt_like_before(const jumps_memory *const jumps, const real y, const real variance, const real R) {
    return jumps->chance / (1 - jumps->chance) * learnt_normal(y, variance + jumps->size * jumps->size * R);
}

/* Note with which sensor a candidate has begun, and how likely it is a jump like those that this sensor has seen: no
   reading that repeats the one before, nor one that another contradicts. */
INLINE void learnt_note_began(const int m, const learnt_rule *const rule, const learnt_state *const s, const int i,
                              const real y, const real S, const real R, const learnt_work *const w) {
    jumps_memory *const jumps = learnt_jumps(rule, s, i);
    int first = jumps != NULL;
    for (int j = 0; jumps && j < m; j++) {
        if (!(w->left[j] > 0 && w->head[j] == w->head[i])) continue;
        if (w->fresh[j] > 1) first = 0, w->alike[j] = 0;
    }
    if (!first) return;
    for (int j = 0; j < m; j++)
        if (w->left[j] > 0 && w->head[j] == w->head[i]) learnt_jumps(rule, s, j)->began = 0;
    w->fresh[i] = 2;
    if (!(R > 0)) return;
    jumps->began = real_within(y / real_sqrt(R), LEARNT_WILDEST), jumps->outliers = 0;
    if (real_copysign(1, learnt_of(rule, s, i).habits->repeats.seldom) > 0)
        w->alike[i] = learnt_like_before(jumps, y, S + w->N[i * m + i], R);
}

/* Let a candidate begin in each part where an innovation asks for it, where the measurement says: as if what a sensor sees
   of each state were independent, so that the others keep what they have. P is so wide that the innovation does not ask any
   more, or would not if that state alone had moved; less what it tells by Joseph's form, as the gain is not C / S. */
INLINE void learnt_widen(const int n, const int m, const learnt_rule *const rule, learnt_state *const s,
                         const real *RESTRICT H, const real *RESTRICT R, const learnt_work *const w) {
    const int q = rule->q;
    const real *const part = learnt_part(n, rule, s), *const unseen = learnt_unseen(n, rule, s);
    real *const x = s->x + q * n, *const P = s->P + q * n * n, *const d = w->direction;
    const real *const y = w->y + q * m, *const S = w->S + q * m * m;
    real *const waits = w->start;
    for (int i = 0; i < m; i++) waits[i] = w->left[i] > 0 && w->fresh[i] > 0, w->alike[i] = 0;
    for (;;) {
        real most = LEARNT_ASKS, seen = 0;
        int i = -1;
        for (int j = 0; j < m; j++) {
            const real asks = y[j] * y[j] / (S[j * m + j] + w->N[j * m + j]);
            if (waits[j] > 0 && S[j * m + j] > 0 && asks < LEARNT_FARTHEST && asks > most)
                most = asks, i = j;
        }
        if (i < 0) return;
        waits[i] = 0;
        learnt_note_began(m, rule, s, i, y[i], S[i * m + i], R[i * m + i], w);
        const real noise = w->N[i * m + i], *RESTRICT h = H + i * n;
        const real square = real_min(y[i] * y[i], LEARNT_FAR * (S[i * m + i] + noise)), most_of = square / LEARNT_ASKS;
        const real times = (most_of - noise) / S[i * m + i];
        real *RESTRICT C = w->C + (q * m + i) * n, whole;
        for (int k = 0; k < n; k++) seen += h[k] * P[k * n + k] * h[k];
        for (int k = 0; k < n; k++) d[k] = P[k * n + k] * h[k] / seen;
        for (int o = 0; o < n; o++) {
            const real own = h[o] * h[o] * P[o * n + o];
            if (part[o] != w->head[i]) continue;
            if (!(s->p[q * n + o] > 0)) {
                for (int c = 0; c < q; c++) s->p[c * n + o] *= 1 - unseen[o];
                s->p[q * n + o] = unseen[o];
            }
            x[o] += y[i] * d[o];
            /* No state is less certain than if it alone had moved. */
            const real root = real_sqrt(own * times > most_of ? real_max(most_of / own, 1) : times);
            for (int k = 0; k < n; k++) P[o * n + k] *= root, P[k * n + o] *= root;
        }
        for (int k = 0; k < n; k++) C[k] = real_dot(n, P + k * n, h);
        whole = real_dot(n, h, C);
        whole += noise + LEARNT_LEFT * square;
        for (int o = 0; o < n; o++)
            for (int k = 0; part[o] == w->head[i] && k < n; k++)
                if (part[k] == part[o]) P[o * n + k] += whole * (d[o] * d[k]) - (d[o] * C[k] + d[k] * C[o]);
        learnt_innovations(n, m, q, w);
    }
}

/* Let what a measurement couples be one part: the states that a sensor sees or whose error is its noise's too, those of
   correlated sensors and of those that fail together. Say of each sensor which part it sees. */
INLINE void learnt_couple(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w) {
    for (int i = 0; i < m; i++) {
        if (!(w->left[i] > 0)) continue;
        const int first = learnt_sees(n, w->H, i);
        for (int k = 0; k < n; k++)
            if (w->H[i * n + k] != 0 || (w->M && w->M[k * m + i] != 0)) learnt_join(n, rule, w->s, first, k);
        w->head[i] = (real)first;
        for (int j = 0; j < i; j++)
            if (w->left[j] > 0 && (w->R[i * m + j] != 0 || learnt_lead(rule, i) == learnt_lead(rule, j)))
                learnt_join(n, rule, w->s, first, (int)w->head[j]);
    }
    for (int i = 0; i < m; i++)
        if (w->left[i] > 0) w->head[i] = w->part[(int)w->head[i]];
}

/* Learn from a candidate that a sensor began and that is believed now: how often that happens, and how far. What was
   refused until then, or until the state followed, was no outlier. */
INLINE void learnt_jumped(const learnt_rule *const rule, const learnt_state *const s, const int i, const int believed) {
    const int K = rule->K;
    const real *const prior = rule->begin + 2 + 2 * K;
    const learnt_memory memory = learnt_of(rule, s, i);
    jumps_memory *const jumps = learnt_jumps(rule, s, i);
    real *const counts = memory.counts, outliers = 0, all = 0, likely = 0, began, readings;
    if (!jumps) return;
    readings = memory.habits->repeats.count, began = jumps->began;
    if (believed) jumps->began = 0;
    for (int k = 0; k < K * K; k++) all += counts[k], outliers += k % K ? counts[k] : 0;
    if (began == 0 || !(readings > LEARNT_FIRST) || outliers > LEARNT_RARE * all) return;
    const real each = 1 / real_min(readings, rule->memory);
    /* The mean of what the chance may be, of which nothing was known: (jumps + 1) / readings. */
    if (believed) jumps->chance = real_max(jumps->chance, each) + each, jumps->size = began;
    /* The run was in the classes that are likely for what it began with. */
    for (int twice = 0; twice < 2; twice++)
        for (int k = 1; k < K; k++) {
            const real size = rule->scales[k] * *memory.r, widest = rule->scales[K - 1] * *memory.r;
            real column = 0, excess = 0, share;
            for (int j = 0; j < K; j++) {
                column += counts[j * K + k];
                excess += real_max(counts[j * K + k] - prior[j * K + k], 0);
            }
            share = column * real_exp(REAL(-0.5) * began * began * (1 / size - 1 / widest)) / real_sqrt(size);
            if (!twice) likely += share;
            if (!twice || !(excess > 0)) continue;
            share = real_min(jumps->outliers * share / likely / excess, 1);
            for (int j = 0; j < K; j++) {
                const real less = share * real_max(counts[j * K + k] - prior[j * K + k], 0);
                counts[j * K + k] -= less, counts[0] += less;
            }
        }
    jumps->outliers = 0;
}

/* Let every model of a state's part go on from where the candidate is. */
INLINE void learnt_settle(const int n, const learnt_rule *const rule, learnt_state *const s, const real head) {
    const real *const part = learnt_part(n, rule, s);
    const int q = rule->q;
    for (int o = 0; o < n; o++) {
        if (part[o] != head) continue;
        s->p[q * n + o] = 0;
        learnt_normalize(n, o, q, s->p);
        for (int c = 0; c < q; c++) {
            s->x[c * n + o] = s->x[q * n + o];
            for (int k = 0; k < n; k++)
                if (part[k] == head) s->P[(c * n + o) * n + k] = s->P[(q * n + o) * n + k];
        }
    }
}

/* How likely a reading begins a jump, one like the sensor's last one rather than an outlier. */
INLINE real learnt_new_chance(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const
                              int i) {
    const jumps_memory *const jumps = learnt_jumps(rule, w->s, i);
    const learnt_memory memory = learnt_of(rule, w->s, i);
    const real *const h = w->H + i * n, noise = w->N[i * m + i], R = w->R[i * m + i];
    const real y = w->z[i] - real_dot(n, h, w->at), seen = real_square(n, h, w->spread);
    real outlier = 0, like;
    if (!jumps) return 0;
    like = learnt_like_before(jumps, y, seen + noise, R);
    learnt_predicted(rule->K, &memory, w->before);
    for (int k = 0; k < rule->K; k++) {
        const real wide = k < rule->K - 1 ? 1 : w->wide[i], size = 1 + (rule->scales[k] - 1) * wide * wide;
        outlier += w->before[k] / wide * learnt_normal(y, seen + size * noise);
    }
    return real_max(like > 0 ? like / (like + outlier) : 0, rule->jump);
}

/* Drop candidates that have lost: in their place a new one may begin, where all others are. A reading that is far from
   them and from all others decides: who is more likely than not is believed, who has gained nothing is dropped. */
INLINE void learnt_refresh(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, real
                           *RESTRICT work) {
    const int q = rule->q;
    learnt_state *const s = w->s;
    int believed = 0;
    if (!(rule->jump > 0)) return;
    for (int i = 0; i < m; i++)
        if (w->left[i] > 0) w->fresh[i] = s->p[q * n + (int)w->head[i]] < LEARNT_DROPPED * rule->jump;
    for (int i = 0; i < m; i++) {
        const real noise = w->N[i * m + i];
        if (!(w->left[i] > 0) || w->fresh[i] > 0 || !learnt_asks(n, w, w->at, w->spread, i, noise) ||
            !learnt_asks(n, w, s->x + q * n, s->P + q * n * n, i, noise))
            continue;
        const real chance = s->p[q * n + (int)w->head[i]];
        if (!(chance > REAL(0.5)) && !(chance * (1 + REAL(1e-9)) < learnt_new_chance(n, m, rule, w, i))) continue;
        if (chance > REAL(0.5)) learnt_settle(n, rule, s, w->head[i]), believed = 1;
        for (int j = 0; j < m; j++) {
            if (!(w->left[j] > 0 && w->head[j] == w->head[i])) continue;
            if (chance > REAL(0.5)) learnt_jumped(rule, s, j, 1);
            w->fresh[j] = 1;
        }
    }
    if (believed) learnt_slow(n, rule, s, w->at, w->spread, work);
    for (int o = 0; o < n; o++) {
        int drops = 0;
        for (int i = 0; i < m; i++) drops |= w->left[i] > 0 && w->head[i] == w->part[o] && w->fresh[i] > 0;
        if (!drops) continue;
        s->p[q * n + o] = 0;
        learnt_normalize(n, o, q, s->p);
        s->x[q * n + o] = w->at[o];
        real_copy(n, w->spread + o * n, s->P + (q * n + o) * n);
    }
}

/* Add what the noise has to do with the state's error to the moments of innovations; M grows as R does. */
CALLED void learnt_correlate(const int n, const int m, const int models, const learnt_work *const w) {
    for (int c = 0; c < models; c++)
        for (int i = 0; i < m; i++) {
            const real root = real_sqrt(w->r[i]);
            for (int j = 0; j < m; j++) {
                real cross = 0;
                for (int k = 0; k < n; k++) cross += w->H[j * n + k] * (w->M[k * m + i] * root);
                w->S[(c * m + i) * m + j] += cross;
                w->S[(c * m + j) * m + i] += cross;
            }
            for (int k = 0; k < n; k++) w->C[(c * m + i) * n + k] += w->M[k * m + i] * root;
        }
}

/* Begin a correction: innovations and their moments, fresh candidates where they ask for them. Return whether ordinary.
   */
INLINE int learnt_begin(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w) {
    const int models = learnt_models(rule);
    real check = 0;
    for (int c = 0; c < models; c++) check += learnt_innovations(n, m, c, w);
    if (check != 0) return 0;
    if (rule->jump > 0) learnt_widen(n, m, rule, w->s, w->H, w->R, w);
    for (int c = 0; c < models; c++)
        for (int i = 0; i < m; i++) {
            const real *const N = w->N + i * m;
            real *const S = w->S + (c * m + i) * m;
            if (!(w->left[i] > 0)) continue;
            if (N[i] > 0 && S[i] > LEARNT_WIDEST * N[i]) return 0;
            for (int j = 0; j < m; j++)
                if (w->left[j] > 0) S[j] += N[j];
        }
    if (w->M) learnt_correlate(n, m, models, w);
    for (int c = 0; c < models; c++)
        for (int i = 0; i < m; i++) w->start[i] = real_max(c ? w->start[i] : 0, w->S[(c * m + i) * m + i]);
    return 1;
}

/* What the classes of noise make of an innovation y (g) of covariance S (g, g), of which N is ordinary noise: write
   their probabilities, which were `before`, the log density, and of each class the whitened innovation, u (K, g), and
   the factor of its covariance, L (K, g, g), one over what it is on the diagonal; peaks (K) is scratch; stretched (g):
   what the deviation of the widest class grows by. Return whether all is ordinary. */
SIZED int learnt_classes(const int g, const learnt_rule *const rule, const real *RESTRICT y, const real *RESTRICT S,
                          const real *RESTRICT N, const real *RESTRICT stretched, const real *RESTRICT before,
                          real *RESTRICT given, real *const log_density, real *RESTRICT u, real *RESTRICT L, real *RESTRICT peaks) {
    const int K = rule->K;
    real shorter = 1, most = -REAL_MAX, total = 0, unit = 1, wide = 1, per_unit;
    int noisy = 0;
    for (int t = 0; t < g; t++) unit = real_max(unit, real_abs(y[t])), noisy |= N[t * g + t] != 0;
    /* A reading that is wrongly refused costs so many more deviations of the noise. */
    for (int t = 0; t < g; t++) wide = real_max(wide, stretched[t]);
    /* Squares are numbers. */
    if (unit < REAL_PRODUCT) unit = 1;
    per_unit = 1 / unit;
    for (int k = K - 1; k >= 0; k--) {
        real *RESTRICT const root = L + k * g * g, *RESTRICT const white = u + k * g;
        real peak = k < K - 1 ? before[k] : before[k] / wide, log_peak = 0, length = 0;
        for (int t = 0; t < g; t++) {
            white[t] = y[t] * per_unit;
            for (int o = 0; o <= t; o++) {
                const real more = k < K - 1 ? 1 : stretched[t] * stretched[o];
                const real whole = S[t * g + o] + (rule->scales[k] - 1) * more * N[t * g + o];
                real cell = whole;
                for (int j = 0; j < o; j++) cell -= root[t * g + j] * root[o * g + j];
                if (o < t) {
                    root[t * g + o] = cell * root[o * g + o];
                    white[t] -= root[t * g + o] * white[o];
                } else {
                    if (!(cell > REAL_PIVOT * whole) || !real_is_finite(cell)) return 0;
                    root[t * g + t] = 1 / real_sqrt(cell);
                }
            }
            white[t] *= root[t * g + t];
            /* A logarithm takes as long as all else of one sensor. */
            peak *= root[t * g + t];
            if (!(peak > 1 / REAL_PRODUCT && peak < REAL_PRODUCT)) log_peak += real_log(peak), peak = 1;
            length += white[t] * white[t];
        }
        /* Nothing is farther than the widest class reaches; a sensor without noise is right however far off. */
        if (k == K - 1 && noisy && length > LEARNT_REACH * per_unit * (LEARNT_REACH * per_unit))
            shorter = LEARNT_REACH / real_sqrt(length);
        for (int t = 0; t < g; t++) white[t] *= shorter;
        peaks[k] = peak, given[k] = log_peak - REAL(0.5) * length * shorter * shorter;
        most = real_max(most, given[k]);
    }
    if ((shorter == 1 && unit != 1) || !real_is_finite(most)) return 0;
    for (int k = 0; k < K; k++) total += given[k] = peaks[k] * real_exp(given[k] - most);
    for (int k = 0; k < K; k++) given[k] /= total;
    *log_density = most + real_log(total) - REAL(0.5) * (real)g * LEARNT_LOG_2PI;
    return 1;
}

/* Write what all g members expect of their classes, the mean of what each does, and ordinary noise N (g, g). */
SIZED void learnt_expected(const int m, const learnt_rule *const rule, const learnt_work *const w, const int g, real
                           *RESTRICT N) {
    const int K = rule->K, rows = rule->joint ? 1 : g;
    const real each = 1 / (real)rows;
    for (int k = 0; k < K; k++) w->before[k] = w->typical[k] = 0;
    for (int t = 0; t < rows; t++) {
        const learnt_memory memory = learnt_of(rule, w->s, (int)w->members[t]);
        learnt_predicted(K, &memory, w->after);
        for (int k = 0; k < K; k++) w->before[k] += w->after[k] * each;
        learnt_typical(K, &memory, w->after);
        for (int k = 0; k < K; k++) w->typical[k] += w->after[k] * each;
    }
    for (int t = 0; t < g; t++) {
        w->stretched[t] = w->wide[(int)w->members[t]];
        for (int u = 0; u < g; u++) N[t * g + u] = w->N[(int)w->members[t] * m + (int)w->members[u]];
    }
}

/* What the whole innovation says of the class that all sensors are in, if they are in the same: write probabilities of
   classes, and the probability from the samples before that they are; return whether its density, of which the log is
   written too, is ordinary. */
CALLED int learnt_together(const int n, const int m, const learnt_rule *const rule, learnt_work *const w, real *const
                           log_density) {
    const int q = rule->q;
    real *RESTRICT const y = w->scratch, *RESTRICT const S = y + m, *RESTRICT const N = S + m * m;
    real *RESTRICT const u = N + m * m, total = 0;
    int g = 0;
    for (int i = 0; i < m; i++)
        if (w->left[i] > 0) w->members[g++] = (real)i;
    for (int t = 0; t < g; t++) {
        const int i = (int)w->members[t];
        const real *const p = w->s->p + (int)w->head[i], reach = LEARNT_TOGETHER * real_sqrt(w->start[i]);
        real slow = 0;
        total += learnt_of(rule, w->s, i).habits->together;
        for (int c = 0; c < q; c++) slow += p[c * n];
        y[t] = 0;
        for (int c = 0; c < q; c++) y[t] += p[c * n] / slow * real_within(w->y[c * m + i], reach);
        for (int o = 0; o <= t; o++) {
            const int j = (int)w->members[o];
            const real other = LEARNT_TOGETHER * real_sqrt(w->start[j]);
            real both = 0;
            for (int c = 0; w->head[i] == w->head[j] && c < q; c++)
                both += p[c * n] / slow * (w->S[(c * m + i) * m + j] + (real_within(w->y[c * m + i], reach) - y[t])
                                                                     * (real_within(w->y[c * m + j], other) - y[o]));
            S[t * g + o] = S[o * g + t] = both;
        }
    }
    w->together = total / (real)g;
    learnt_expected(m, rule, w, g, N);
    return learnt_classes(g, rule, y, S, N, w->stretched, w->before, w->shared, log_density, u, u + rule->K * m, w->after);
}

/* A sensor's innovation in standard deviations, over all models. */
INLINE real learnt_far(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const int i)
                       {
    const int models = learnt_models(rule);
    const real *const p = w->s->p + (int)w->head[i];
    real mean = 0, variance = 0, unit = 1;
    for (int c = 0; c < models; c++) unit = real_max(unit, real_abs(w->y[c * m + i]));
    for (int c = 0; c < models; c++) mean += p[c * n] * (w->y[c * m + i] / unit);
    for (int c = 0; c < models; c++) {
        const real apart = w->y[c * m + i] / unit - mean;
        variance += p[c * n] * (w->S[c * m * m + i * m + i] / unit / unit + apart * apart);
    }
    return real_abs(mean) / real_sqrt(variance);
}

/* The sensor that is taken next of `count` that are left, the least far; of those that fail together the farthest
   counts. */
INLINE int learnt_next(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const int
                       count) {
    int best = -1;
    real least = 0;
    for (int i = 0; i < m; i++) {
        real far = 0;
        if (!(w->left[i] > 0)) continue;
        for (int j = 0; j < m && count > 1; j++)
            if (w->left[j] > 0 && learnt_lead(rule, j) == learnt_lead(rule, i))
                far = real_max(far, learnt_far(n, m, rule, w, j));
        if (best < 0 || far < least) best = i, least = far;
    }
    return best;
}

/* Score, information and likelihood of g sensors that are taken at once under every model. Return whether all is
   ordinary. log_density: of all that is likely the most, which w->logs are over. */
SIZED int learnt_scores_of(const int m, const learnt_rule *const rule, const learnt_work *const w, const int g, real
                           *const log_density) {
    const int first = (int)w->members[0];
    const int models = learnt_models(rule), K = rule->K, rows = rule->joint ? 1 : g, size = rule->joint ? g : 1;
    real *RESTRICT const y = w->scratch, *RESTRICT const S = y + m, *RESTRICT const N = S + m * m;
    real *RESTRICT const pulls = N + m * m, *RESTRICT const inverses = pulls + K * m;
    learnt_expected(m, rule, w, g, N);
    for (int c = 0; c < models; c++) {
        real *RESTRICT const given = w->given + c * K, *RESTRICT const a = w->scores + c * m;
        real *RESTRICT const b = w->informations + c * m * m;
        if (!(w->S[(c * m + first) * m + first] > REAL_PIVOT * w->start[first])) return 0;
        for (int t = 0; t < g; t++) {
            const int i = (int)w->members[t];
            y[t] = w->y[c * m + i];
            for (int u = 0; u < g; u++) S[t * g + u] = w->S[(c * m + i) * m + (int)w->members[u]];
        }
        if (!learnt_classes(g, rule, y, S, N, w->stretched, c < rule->q ? w->before : w->typical, given, w->logs + c,
                            pulls, inverses, w->after))
            return 0;
        for (int t = 0; t < g; t++) a[t] = 0;
        for (int t = 0; t < g * g; t++) b[t] = 0;
        for (int k = 0; k < K; k++) {
            real *RESTRICT const pull = pulls + k * g, *RESTRICT const inverse = inverses + k * g * g;
            if (w->together > 0) given[k] += w->together * (w->shared[k] - given[k]);
            /* The inverse of the factor in its place, and with it those of the innovation and of its covariance. */
            for (int t = 0; t < g; t++)
                for (int u = 0; u < t; u++) {
                    real sum = 0;
                    for (int o = u; o < t; o++) sum -= inverse[t * g + o] * inverse[o * g + u];
                    inverse[t * g + u] = sum * inverse[t * g + t];
                }
            for (int t = 0; t < g; t++) {
                real pulled = 0;
                for (int o = t; o < g; o++) pulled += inverse[o * g + t] * pull[o];
                pull[t] = pulled;
                a[t] += given[k] * pulled;
                for (int u = 0; u <= t; u++) {
                    real sum = 0;
                    for (int o = t; o < g; o++) sum += inverse[o * g + t] * inverse[o * g + u];
                    inverse[t * g + u] = sum;
                }
            }
            for (int t = 0; t < g; t++)
                for (int u = 0; u <= t; u++) {
                    inverse[u * g + t] = inverse[t * g + u];
                    b[t * g + u] += given[k] * (inverse[t * g + u] - pull[t] * pull[u]);
                }
        }
        for (int t = 0; t < g; t++)
            for (int u = 0; u <= t; u++) b[u * g + t] = b[t * g + u] += a[t] * a[u];
        /* Of what is left of y under the ordinary class, and of its variance, what is noise. */
        for (int row = 0; row < rows; row++) {
            real expected = 0, is = 0, excess, part;
            for (int t = row; t < row + size; t++) {
                real pulled = 0;
                for (int u = 0; u < g; u++) {
                    expected += inverses[t * g + u] * N[t * g + u];
                    pulled += pulls[u] * N[u * g + t];
                }
                is += pulled * pulls[t];
            }
            excess = expected > 0 ? is / expected - 1 : 0;
            part = real_min(expected / (real)size, 1);
            w->noises[c * m + row] = part;
            w->energies[c * m + row] = real_max(1 + part * excess, 0);
        }
        *log_density = c == 0 ? w->logs[c] : real_max(*log_density, w->logs[c]);
    }
    for (int c = 0; c < models; c++) w->logs[c] = real_exp(w->logs[c] - *log_density);
    return 1;
}

/* With a copy of its own for what is usual, one sensor. */
CALLED int learnt_scores(const int m, const learnt_rule *const rule, const learnt_work *const w, const int g, real
                         *const log_density) {
    return g == 1 ? learnt_scores_of(m, rule, w, 1, log_density) : learnt_scores_of(m, rule, w, g, log_density);
}

/* Learn from what sensors that are taken at once have said, and take it off the models; w->shares are these models'. */
CALLED void learnt_taken(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const int
                         g) {
    const learnt_state *const s = w->s;
    const int models = learnt_models(rule), K = rule->K;
    real *RESTRICT ours = w->scratch, *RESTRICT theirs = ours + m * n;
    real *RESTRICT bC = theirs + m * m, *RESTRICT bS = bC + m * n;
    for (int row = 0; rule->learns && row < (rule->joint ? 1 : g); row++) {
        const int i = (int)w->members[row];
        const learnt_memory memory = learnt_of(rule, s, i);
        real ordinary = 0, energy = 0, noisy = 0;
        for (int c = 0; c < models; c++) {
            const real weight = w->shares[c] * w->given[c * K];
            ordinary += weight, energy += weight * w->energies[c * m + row], noisy += weight * w->noises[c * m + row];
        }
        ordinary = real_max(ordinary, REAL(1e-300));
        noisy /= ordinary;
        /* Its own chain foresaw the class, not what all of them expect together. */
        learnt_predicted(K, &memory, w->before);
        energy = noisy > 0 ? (energy / ordinary - 1) / noisy : 0;
        learnt_learn(rule, w->after, w->before, w->r[i], energy, noisy, &memory);
    }
    for (int t = 0; t < g; t++) w->left[(int)w->members[t]] = 0;
    for (int c = 0; c < models; c++) {
        const real *RESTRICT a = w->scores + c * m, *RESTRICT b = w->informations + c * m * m;
        real *RESTRICT x = s->x + c * n, *RESTRICT P = s->P + c * n * n, *RESTRICT y = w->y + c * m;
        real *RESTRICT C = w->C + c * m * n, *RESTRICT S = w->S + c * m * m;
        for (int t = 0; t < g; t++) {
            real_copy(n, C + (int)w->members[t] * n, ours + t * n);
            real_copy(m, S + (int)w->members[t] * m, theirs + t * m);
        }
        real_multiply(g, g, n, b, ours, bC);
        real_multiply(g, g, m, b, theirs, bS);
        for (int t = 0; t < g; t++) {
            const real *RESTRICT own = ours + t * n, *RESTRICT with = theirs + t * m;
            for (int j = 0; j < n; j++) {
                x[j] += a[t] * own[j];
                for (int k = 0; k <= j; k++) P[k * n + j] = P[j * n + k] -= own[j] * bC[t * n + k];
            }
            for (int o = 0; o < m; o++) {
                if (!(w->left[o] > 0)) continue;
                y[o] -= a[t] * with[o];
                for (int k = 0; k < n; k++) C[o * n + k] -= bS[t * m + o] * own[k];
                for (int k = 0; k < m; k++)
                    if (w->left[k] > 0) S[o * m + k] -= with[o] * bS[t * m + k];
            }
        }
    }
}

/* Say which readings there are, of sensors that see something; how many of these are left out, as their sensors are
   stuck. */
INLINE int learnt_seen(const int n, const int m, const learnt_rule *const rule, learnt_work *const w, real *RESTRICT
                       weights, real *RESTRICT outlying, real *RESTRICT logs) {
    int held = 0;
    for (int i = 0; i < m; i++) {
        const learnt_memory memory = learnt_of(rule, w->s, i);
        int seen = 0;
        for (int k = 0; k < n; k++) seen |= w->H[i * n + k] != 0;
        w->left[i] = seen && w->z[i] == w->z[i] ? REAL(1.0) : REAL(0.0);
        w->r[i] = rule->learns ? *memory.r : 1;
        weights[i] = logs[i] = (real)NAN;
        outlying[i] = w->goes_on[i] = 0;
        if (!(w->left[i] > 0 && learnt_follows(rule) && learnt_stuck(n, m, w, i, &memory))) continue;
        w->left[i] = weights[i] = 0;
        outlying[i] = 1;
        held++;
    }
    return held;
}

/* Let what a measurement couples be one part, and what sensors do usually set their r. */
INLINE void learnt_prepare(const int n, const int m, const learnt_rule *const rule, learnt_work *const w, real *RESTRICT
                           work) {
    learnt_couple(n, m, rule, w);
    learnt_slow(n, rule, w->s, w->at, w->spread, work);
    for (int i = 0; learnt_follows(rule) && i < m; i++) {
        const learnt_memory memory = learnt_of(rule, w->s, i);
        if (!(w->left[i] > 0 && w->R[i * m + i] > 0 && memory.last[0] < REAL(0.5))) continue;
        const real y = learnt_left(n, m, w, i);
        w->goes_on[i] = 2 * real_abs(y - memory.habits->repeats.left) < real_abs(y);
    }
    if (learnt_follows(rule)) {
        learnt_changes(n, m, rule, w);
        learnt_sizes(n, m, rule, w, work);
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++)
            w->N[i * m + j] = w->R[i * m + j] * (i == j ? w->r[i] : real_sqrt(w->r[i] * w->r[j]));
    for (int i = 0; i < m; i++) {
        /* An outlier is far from what is expected of a reading, by all models together. */
        const learnt_memory memory = learnt_of(rule, w->s, i);
        const real noise = w->N[i * m + i];
        w->wide[i] = 1;
        if (w->left[i] > 0 && noise > 0 && rule->learns && learnt_seasoned(rule, &memory))
            w->wide[i] = real_sqrt(real_max(real_square(n, w->H + i * n, w->spread) / noise, 1));
    }
    learnt_refresh(n, m, rule, w, work);
}

/* Let what the sensors that are taken at once have said, w->logs over exp(most), move the probabilities of the models
   in their part; add to log_density and write its part without what a candidate is made to fit. Return whether
   ordinary. */
INLINE int learnt_believe(const int n, const learnt_rule *const rule, const learnt_work *const w, const int i, const
                          real most, real *const log_density, real *const log_said) {
    const int q = rule->q, models = learnt_models(rule), K = rule->K;
    real *const p = w->s->p, *const here = p + (int)w->head[i], *const logs = w->logs;
    real total = 0, full = 0, others = 0, evidence = 0;
    for (int c = 0; c < q; c++) {
        w->shares[c] = real_max(here[c * n], REAL(1e-300));
        others += w->shares[c], evidence += w->shares[c] * logs[c];
    }
    if (models > q) {
        /* A candidate is made to fit what it begins with, which is no evidence for it; nor is a sample that is wild to
           all others worth more than a hundred. */
        const real chance = w->shares[q] = here[q * n];
        evidence /= others;
        /* What tells for a jump so much tells nothing of the scale of Q, where a jump is no far-fetched reason. */
        const int experienced = chance >= LEARNT_DROPPED && learnt_jumps(rule, w->s, i) &&
                                learnt_of(rule, w->s, i).habits->repeats.count > LEARNT_FIRST;
        for (int c = 0; c < q && experienced && logs[q] > LEARNT_TELLS * evidence; c++) logs[c] = evidence;
        full = others * evidence + chance * (w->fresh[i] > 0 ? evidence : logs[q]);
        logs[q] = w->fresh[i] > 0 ? evidence : real_min(logs[q], LEARNT_EVIDENCE * evidence);
        if (w->alike[i] > 0 && chance > 0)
            logs[q] += (1 - chance) / chance * w->alike[i] * real_exp(-most - REAL(0.5) * LEARNT_LOG_2PI);
    }
    for (int c = 0; c < models; c++) total += w->shares[c] *= logs[c];
    if (!(total > 0) || !real_is_finite(total)) return 0;
    *log_density += most + real_log(total);
    *log_said = most + real_log(models > q ? full : total);
    for (int k = 0; k < K; k++) w->after[k] = 0;
    for (int c = 0; c < models; c++) {
        w->shares[c] /= total;
        for (int o = 0; o < n; o++)
            if (w->part[o] == w->head[i]) p[c * n + o] = w->shares[c];
        for (int k = 0; k < K; k++) w->after[k] += w->shares[c] * w->given[c * K + k];
    }
    return 1;
}

/* Let candidates that are believed take over, and sensors learn from them and whether they fail together; together and
   apart: log densities of the measurement if they do and if not. */
INLINE void learnt_conclude(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const
                            real together, const real apart, const real *RESTRICT weights, real *RESTRICT work) {
    const int q = rule->q;
    learnt_state *const s = w->s;
    if (w->together > 0) {
        /* How sensors fail may change, and a sample is worth no more than a hundred to one. */
        const real prior = learnt_of_row(rule->K, (real *)rule->begin).habits->together;
        const real before = w->together + (prior - w->together) / rule->memory;
        const real odds = before / (1 - before) * real_exp(real_within(together - apart, real_log(LEARNT_EVIDENCE)));
        for (int i = 0; i < m; i++)
            if (weights[i] > 0) learnt_of(rule, s, i).habits->together = odds / (1 + odds);
    }
    for (int o = 0; rule->jump > 0 && o < n; o++) {
        const int believed = s->p[q * n + o] > LEARNT_TAKEN;
        for (int i = 0; i < m; i++) {
            if (!(weights[i] > 0 && w->head[i] == w->part[o])) continue;
            learnt_unseen(n, rule, s)[o] = 0;
            if (believed || (w->goes_on[i] > 0 && learnt_of(rule, s, i).last[0] > REAL(0.5)))
                learnt_jumped(rule, s, i, believed);
        }
        if (believed) learnt_settle(n, rule, s, w->part[o]);
    }
    if (!learnt_follows(rule)) return;
    learnt_slow(n, rule, s, w->at, w->spread, work);
    for (int i = 0; i < m; i++)
        if (weights[i] > 0 && w->R[i * m + i] > 0) learnt_of(rule, s, i).habits->repeats.left = learnt_left(n, m, w, i);
}

/* What `learnt_correct` does with R as it is. logs (m): log density of each reading, NaN where there is none. */
INLINE int learnt_weigh(const int n, const int m, const learnt_rule *const rule, learnt_work *const w, real *RESTRICT
                        weights, real *RESTRICT outlying, real *const log_density, real *RESTRICT logs, real *RESTRICT
                        work) {
    const int models = learnt_models(rule), K = rule->K;
    int count = 0, held;
    real together = 0, apart = 0;
    const real_part parts[] = {
        {&w->y, models * m}, {&w->C, models * m * n}, {&w->S, models * m * m}, {&w->given, models * K},
        {&w->logs, models}, {&w->shares, models}, {&w->at, n}, {&w->spread, n * n}, {&w->direction, n}, {&w->left, m},
        {&w->r, m}, {&w->N, m * m}, {&w->start, m}, {&w->goes_on, m}, {&w->head, m}, {&w->fresh, m}, {&w->alike, m},
        {&w->before, K}, {&w->typical, K},
        {&w->after, K}, {&w->shared, K}, {&w->wide, m}, {&w->members, m}, {&w->stretched, m},
        {&w->scores, models * m}, {&w->informations, models * m * m},
        {&w->energies, models * m}, {&w->noises, models * m}, {&w->scratch, m * (1 + 2 * n + K) + m * m * (2 + K)}};
    work = real_lay_out((int)(sizeof parts / sizeof *parts), parts, work);
    learnt_slow(n, rule, w->s, w->at, w->spread, work);
    held = learnt_seen(n, m, rule, w, weights, outlying, logs);
    for (int i = 0; i < m; i++) count += w->left[i] > 0;
    if (count == 0) return held;
    learnt_prepare(n, m, rule, w, work);
    if (!learnt_begin(n, m, rule, w)) return -1;
    if (learnt_follows(rule) && rule->named == 0 && count > 1 && !learnt_together(n, m, rule, w, &together)) return -1;
    for (int turn = 0, group; turn < count; turn += group) {
        const int i = learnt_next(n, m, rule, w, count - turn);
        real weight = 0, most = 0;
        group = 0;
        for (int j = 0; j < m; j++)
            if (w->left[j] > 0 && learnt_lead(rule, j) == learnt_lead(rule, i)) w->members[group++] = (real)j;
        if (!learnt_scores(m, rule, w, group, &most)) return -1;
        if (!learnt_believe(n, rule, w, i, most, &apart, logs + i)) return -1;
        for (int k = 0; k < K; k++) weight += w->after[k] / rule->scales[k];
        for (int t = 0; t < group; t++)
            weights[(int)w->members[t]] = weight, outlying[(int)w->members[t]] = 1 - w->after[0];
        learnt_taken(n, m, rule, w, group);
    }
    *log_density += apart;
    learnt_conclude(n, m, rule, w, together, apart, weights, work);
    return count + held;
}

#define learnt_judge_work(n, m) (update_work(n, m) + (size_t)((3 + 2 * SPREAD_NUMBERS) * (m)))

/* Go on with the recursion as given, and let the models of a part begin again from it where it tells a factor of P, Q
   and R. logs: of z by the models, NaN where there is none. Return whether all is ordinary. */
CALLED int learnt_judge(const int n, const int m, const learnt_rule *const rule, const learnt_work *const w, const real
                        *RESTRICT logs, real *RESTRICT work) {
    static const correction_rule huber = {{PSI_HUBER, REAL(1.345), 0, 0, NULL, NULL}, SCALING_LEARNT,
                                          INFORMATION_REALIZED, 1, 0, NULL, 0};
    learnt_state *const s = w->s;
    const int models = learnt_models(rule), width = learnt_width(rule->K);
    const real *const R = w->R;
    real *const for_factor = learnt_given(n, rule, s, LEARNT_FOR_FACTOR), *const x = s->x + models * n;
    real *const readings = learnt_given(n, rule, s, LEARNT_READINGS), *const P = s->P + models * n * n;
    real *const factor = learnt_given(n, rule, s, LEARNT_FACTOR);
    real *RESTRICT y = work, *RESTRICT S = y + m, *RESTRICT here = S + m;
    spread_memory *const before = (spread_memory *)(here + m), *const after = before + m;
    correction c;
    work = (real *)(after + m);
    for (int i = 0; i < m; i++) {
        before[i] = after[i] = learnt_of(rule, s, i).habits->spread;
        here[i] = logs[i] == logs[i] ? w->z[i] : (real)NAN;
    }
    correction_begin(n, m, w->M != NULL, &c, work);
    if (!innovate(n, m, here, x, P, w->H, R, w->M, &c)) return 0;
    for (int i = 0; i < m; i++) {
        y[i] = c.y[i], S[i] = c.S[i * m + i];
        if (here[i] == here[i] && R[i * m + i] > 0 && S[i] > LEARNT_WIDEST * R[i * m + i]) return 0;
    }
    if (!update(n, m, &huber, w->readings, here, w->H, R, w->M, after, x, P, &c, NULL, work)) return 0;
    for (int i = 0; i < m; i++) learnt_of(rule, s, i).habits->spread = after[i];
    for (int head = 0; head < n; head++) {
        real log_c = 0, evidence = 0, count;
        int any = 0, beyond;
        for (int j = 0; j < m && readings[head] < LEARNT_DECIDED; j++) {
            real size;
            if (here[j] != here[j] || learnt_head(n, w, j) != head) continue;
            /* A factor is common to all sensors of a part: that of the one which shows least of it. */
            size = real_max(before[j].spread, spread_coarse(before + j, real_sqrt(S[j])));
            size = before[j].weight > 0 ? 2 * real_log(real_max(size, REAL(1e-150))) : 0;
            size = real_within(size, LEARNT_LOG_FARTHEST);
            if (!any || real_abs(size) < real_abs(log_c)) log_c = size;
            any = 1;
        }
        if (!any) continue;
        beyond = real_abs(log_c) > LEARNT_LOG_BEYOND;
        for (int j = 0; j < m && beyond; j++) {
            real log_unit, by_it;
            /* One that repeats the reading before is no sample of noise. */
            if (here[j] != here[j] || w->readings[j] == before[j].last || learnt_head(n, w, j) != head) continue;
            log_unit = REAL(0.5) * (real_log(S[j]) + log_c);
            by_it = -psi_rho(&huber.psi, y[j] / real_exp(log_unit)) - log_unit - REAL(0.5) * LEARNT_LOG_2PI;
            evidence += real_within(by_it - logs[j], real_log(LEARNT_EVIDENCE));
        }
        evidence = beyond ? real_min(real_max(for_factor[head] + evidence, 0), 2 * LEARNT_LOG_DECIDES) : 0;
        count = readings[head] + 1;
        if (beyond) count = real_min(count, LEARNT_DECIDED - 1);
        any = count > LEARNT_DECIDES && evidence == 2 * LEARNT_LOG_DECIDES;
        for (int o = 0; o < n; o++) {
            if ((int)w->part[o] != head) continue;
            for_factor[o] = evidence, readings[o] = any ? LEARNT_DECIDED : count;
            if (!any) continue;
            factor[o] = real_exp(log_c), learnt_unseen(n, rule, s)[o] = 0;
            for (int l = 0; l < models; l++) {
                s->x[l * n + o] = x[o];
                s->p[l * n + o] = l < rule->q ? learnt_begins(rule, l) : 0;
                for (int k = 0; k < n; k++)
                    if ((int)w->part[k] == head) s->P[(l * n + o) * n + k] = factor[o] * P[o * n + k];
            }
        }
        for (int j = 0; j < m && any; j++)
            if (learnt_head(n, w, j) == head) real_copy(width, rule->begin, s->memory + j * width);
    }
    return 1;
}

#define learnt_correct_work(n, m, models, K) \
    (learnt_weigh_work(n, m, models, K) + learnt_judge_work(n, m) + (size_t)((m) * (1 + (n) + (m))))

/* Correct by what z tells, NaN where it is missing: R need not be diagonal. M (n, m) or NULL. readings: what the
   sensors said, where z is only how far that is from what was expected, else z too. weights and outlying (m) are
   written, NaN and 0 where a component says nothing, 0 and 1 where its sensor is stuck, log_density is added to. Return
   how many were there, -1 if the step is out of the ordinary; the state is spoiled then. */
INLINE int learnt_correct(const int n, const int m, const learnt_rule *const rule, learnt_state *const s,
                          const real *z, const real *readings, const real *H, const real *R, const real *M,
                          real *RESTRICT weights, real *RESTRICT outlying, real *const log_density,
                          real *RESTRICT work) {
    const int gives = learnt_gives(rule) && learnt_jumps(rule, s, 0), width = learnt_width(rule->K);
    const real *const factor = learnt_given(n, rule, s, LEARNT_FACTOR);
    const real *const before = learnt_given(n, rule, s, LEARNT_READINGS);
    real *const logs = work, *const N = logs + m, *const scaled = N + m * m;
    learnt_work w = {.s = s, .z = z, .readings = readings, .H = H, .R = R, .M = M, .part = learnt_part(n, rule, s)};
    int count, wrong = 0, looks = 0;
    work = scaled + m * n;
    for (int k = 0; gives && k < n; k++) wrong |= factor[k] != 1;
    for (int i = 0; wrong && i < m; i++) {
        const real own = factor[learnt_sees(n, H, i)];
        s->memory[i * width] /= own;
        for (int j = 0; j < m; j++)
            N[i * m + j] = R[i * m + j] * (real_sqrt(own) * real_sqrt(factor[learnt_sees(n, H, j)]));
        for (int k = 0; M && k < n; k++) scaled[k * m + i] = M[k * m + i] * real_sqrt(factor[k]) * real_sqrt(own);
    }
    if (wrong) w.R = N, w.M = M ? scaled : NULL;
    count = learnt_weigh(n, m, rule, &w, weights, outlying, log_density, logs, work);
    if (!gives || count < 0) return count;
    w.R = R, w.M = M;
    for (int i = 0; i < m; i++) looks |= logs[i] == logs[i] && before[learnt_head(n, &w, i)] < LEARNT_DECIDED;
    if (looks && !learnt_judge(n, m, rule, &w, logs, work)) return -1;
    for (int i = 0; i < m; i++) s->memory[i * width] *= factor[learnt_sees(n, H, i)];
    return count;
}

#endif

/* One step of one filter as one call: attributes read, the step taken, attributes set. */
#include "mend.h"
#include "online.h"

/* The models of a filter under a mixture, in arrays of their own that a step may change, and what they merge to. */
typedef struct {
    const learnt_rule *rule;
    learnt_state s;
    PyObject *kept;     /* as the filter has it: a tuple, or None where there is one model */
    const double *x;    /* their mean */
    PyObject *after[5]; /* of a tuple of the same kind: means, covariances, p, x, P */
} models;

/* Read the models; whether all is ordinary, -1 with an exception. x or P that have been assigned from outside are for the
   definition, but for an x that has been moved. */
static int take_models(held *h, const learnt_rule *rule, PyObject *kept, const filter_state *now, int moved, models *f) {
    const npy_intp n = now->n, rows = learnt_rows(rule), beliefs = learnt_beliefs(1, rule);
    const double *means = now->x, *covariances = now->P, *p = NULL, *P = now->P;
    f->rule = rule, f->kept = kept, f->x = now->x;
    if (n > 1000 || (kept == Py_None && rows != 1)) return 0;
    if (kept != Py_None) {
        npy_intp lengths[AXES] = UNKNOWN_AXES;
        AXIS('n') = n, AXIS('q') = rows, AXIS('b') = beliefs;
        if (!take_arrays(kept, "qn qnn bn n nn", lengths, (void *[]){&means, &covariances, &p, &f->x, &P})) return 0;
        if (!moved && memcmp(f->x, now->x, (size_t)n * sizeof *f->x)) return 0;
        if (memcmp(P, now->P, (size_t)(n * n) * sizeof *P)) return 0;
    }
    f->after[0] = array_of(h, means, 2, rows, n, 0), f->after[1] = array_of(h, covariances, 3, rows, n, n);
    f->after[2] = array_of(h, p, 2, beliefs, n, 0);
    f->after[3] = array_of(h, NULL, 1, n, 0, 0), f->after[4] = array_of(h, NULL, 2, n, n, 0);
    if (h->failed) return -1;
    f->s = (learnt_state){numbers_of(f->after[0]), numbers_of(f->after[1]), numbers_of(f->after[2]), NULL};
    /* Of one model there is one part. */
    for (npy_intp i = 0; !p && i < beliefs * n; i++) f->s.p[i] = i < n;
    return learnt_has_parts((int)n, rule, &f->s);
}

/* Let x and P be what the models have merged to: code of Python's may get the others. */
static void show_models(const models *f, PyObject *x, PyObject *P) {
    const int n = (int)PyArray_DIM((PyArrayObject *)P, 0);
    real_copy(n, numbers_of(f->after[3]), numbers_of(x)), real_copy(n * n, numbers_of(f->after[4]), numbers_of(P));
}

/* What the filter is to keep after the step: a tuple of the same kind, whose own constructor is Python's code, or None. */
static PyObject *kept_of(held *h, const models *f) {
    const newfunc make = (newfunc)PyType_GetSlot(&PyTuple_Type, Py_tp_new);
    PyObject *const *const of = f->after, *entries, *made;
    if (f->kept == Py_None) return Py_None;
    entries = Py_BuildValue("((OOOOO))", of[0], of[1], of[2], of[3], of[4]);
    made = entries ? make(Py_TYPE(f->kept), entries, NULL) : NULL;
    Py_XDECREF(entries);
    return hold(h, made);
}

#define NO_PART 1e-12 /* correlation that is rounding */
#define regress_work(n, m) ((size_t)((n) > (m) ? (n) * (2 * (n) + 1) : (m) * (2 * (m) + 1)))

/* H (m, n) = C' P^-1, P (n, n) in units of its own and without directions in which it has no extent, and what of S such a line
   does not explain, noise apart: curvature (m, m). */
static void regress(int n, int m, const double *P, const double *C, const double *S, const double *R, double *H,
                    double *curvature, double *work) {
    const int k = n > m ? n : m;
    double *const A = work, *const V = A + k * k, *const unit = V + k * k, most = 0;
    for (int i = 0; i < n; i++) unit[i] = P[i * n + i] > 0 ? sqrt(P[i * n + i]) : 1;
    for (int i = 0; i < n * n; i++) A[i] = P[i] / (unit[i / n] * unit[i % n]);
    mend_diagonalize(n, A, V);
    for (int i = 0; i < n; i++) most = real_max(most, fabs(A[i * n + i]));
    for (int i = 0; i < m * n; i++) H[i] = 0;
    for (int o = 0; o < n; o++) {
        if (!(fabs(A[o * n + o]) > 1e-15 * most)) continue;
        for (int i = 0; i < m; i++) {
            double along = 0;
            for (int l = 0; l < n; l++) along += V[l * n + o] * (C[l * m + i] / unit[l]);
            for (int l = 0; l < n; l++) H[i * n + l] += V[l * n + o] * along / A[o * n + o];
        }
    }
    for (int i = 0; i < m * n; i++) {
        const double variance = S[i / n * (m + 1)] - R[i / n * (m + 1)];
        H[i] = fabs(H[i]) > NO_PART * sqrt(real_max(variance, 0)) ? H[i] / unit[i % n] : 0;
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            double seen = 0;
            for (int l = 0; l < n; l++) seen += H[i * n + l] * C[l * m + j];
            A[i * m + j] = A[j * m + i] = S[i * m + j] - R[i * m + j] - seen;
        }
    mend_diagonalize(m, A, V);
    mend_compose(m, A, V, 0, curvature);
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            const double variances = (S[i * m + i] - R[i * m + i]) * (S[j * m + j] - R[j * m + j]);
            if (fabs(curvature[i * m + j]) <= NO_PART * sqrt(real_max(variances, 0))) curvature[i * m + j] = 0;
        }
}

/* Add to every model, in parts that it makes one, what no line explains of a prediction (n, n). */
static void bend_models(int n, models *f, const double *curvature) {
    for (int i = 0; i < n * n; i++)
        if (curvature[i] != 0) learnt_join(n, f->rule, &f->s, i / n, i % n);
    for (int i = 0; i < learnt_rows(f->rule) * n * n; i++) f->s.P[i] += curvature[i % (n * n)];
}

/* given: B, F and Q for this call, or None; moved: None where x moves by F, else a function has moved it: False, or the
   P to which sigma points have moved, F then being their covariance with where they were. */
static int take_prediction(held *h, PyObject *filter, PyObject *u, PyObject *const *given, PyObject *moved) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT__kept, AT_Q, AT_F, AT__alpha_sq, AT_B};
    PyObject *const *const own = h->objects;
    filter_state now;
    motion how;
    judge by = {.mixes = 0};
    models f = {NULL};
    PyObject *x, *P, *kept = NULL;
    double stack[STACK_WORK], *work, *control, *curvature = NULL;
    const double *to = NULL;
    /* A filter with sigma points has no F, B and alpha. */
    const int by_points = PyArray_CheckExact(moved);
    int fine;
    if (hold_all(h, filter, names, by_points ? 5 : 8) < 0) return -1;
    /* One model moves as x and P do. */
    if (own[3] != Py_None && take_judge(h, filter, &by) < 0) return -1;
    if (!take_filter(own[0], own[1], own[2], &now)) return 0;
    const int n = (int)now.n, moves = moved == Py_None;
    if (by_points && !(to = matrix_of(moved, n, n))) return 0;
    fine = take_motion(h, given, own[4], by_points ? NULL : own + 5, n, &how);
    if (fine > 0 && by.mixes) fine = take_models(h, &by.mixture, own[3], &now, !moves, &f);
    if (fine <= 0 || (to && !f.rule)) return fine < 0 ? -1 : 0;
    x = array_of(h, NULL, now.ndim, n, 1, 0), P = array_of(h, NULL, 2, n, n, 0);
    if (h->failed) return -1;
    work = work_of(stack, (f.rule ? learnt_predict_work(n, learnt_models(f.rule)) : predict_work(n)) + (size_t)n +
                              (to ? (size_t)(2 * n * n) + regress_work(n, n) : 0));
    if (!work) return -1;
    control = work;
    fine = take_control(how.B, u, n, &control);
    if (fine && f.rule) {
        double *rest = work + n;
        if (to) {
            curvature = rest + n * n;
            regress(n, n, now.P, how.F, to, how.Q, rest, curvature, curvature + n * n);
            how.F = rest, rest = curvature + n * n;
        }
        if (!moves) control = work;
        for (int i = 0; !moves && i < n; i++) control[i] = now.x[i] - real_dot(n, how.F + i * n, f.x);
        learnt_predict(n, f.rule, &f.s, how.F, how.Q, control, how.alpha_sq, rest);
        if (to) bend_models(n, &f, curvature);
        fine = learnt_merge(n, f.rule, &f.s, numbers_of(f.after[3]), numbers_of(f.after[4]), rest);
        show_models(&f, x, P);
    } else if (fine) {
        fine = predict(n, now.x, now.P, how.F, how.Q, control, how.alpha_sq, numbers_of(x), numbers_of(P), work + n);
        if (!moves) real_copy(n, now.x, numbers_of(x));
    }
    work_done(stack, work);
    if (!fine) return 0;
    if (f.rule && !(kept = kept_of(h, &f))) return -1;
    if (!set_state(h, filter, x, P, AT_x_prior, AT_P_prior)) return -1;
    return kept && set_attribute(filter, AT__kept, kept) < 0 ? -1 : 1;
}

STEP(predict_step, 6, take_prediction(&h, arguments[0], arguments[1], arguments + 2, arguments[5]),
     "predict: expected a filter, u, B, F, Q and what has moved x")

/* What a correction leaves: see robust_filterpy.kernel.moments, which reads it. Numbers and rows of m numbers; then S and C',
   or, under a mixture, the mean, P, H, R, what no line explains, and M. */
enum record_number { RECORD_N, RECORD_M, RECORD_KIND, RECORD_LOG_DENSITY, RECORD_HEAD };
enum record_row { ROW_Y, ROW_E, ROW_WEIGHTS, ROW_PSI_DERIV, ROW_D, ROW_SCORE, ROW_ORDER, ROW_JUDGED, RECORD_ROWS };
enum mixed_row { ROW_LAGS, ROW_OUTLYING, ROW_Z = ROW_WEIGHTS + 1, ROW_FACTORS, ROW_LEADS, MIXED_ROWS };
#define RECORD_MIXED (SCALING_BOUNDED + 1) /* the kind of one under a mixture, else its scaling */

static double *record_row(double *record, int which, npy_intp m) { return record + RECORD_HEAD + which * m; }

/* All but the innovations, S and C. */
static void begin_record(double *record, npy_intp m, const correction_rule *rule, const correction *c) {
    record[RECORD_LOG_DENSITY] = correction_log_likelihood(rule, c);
    real_copy((int)(4 * m), c->e, record_row(record, ROW_E, m));     /* e, weights, slopes, d */
    real_copy((int)(2 * m), c->v, record_row(record, ROW_SCORE, m)); /* v, order */
    for (npy_intp i = c->observed; i < m; i++) record_row(record, ROW_ORDER, m)[i] = 0; /* no place for what is missing */
    real_copy((int)m, c->first, record_row(record, ROW_JUDGED, m));  /* S_ii by which it was judged */
}

/* What a correction makes: x and P in the shape of before, a record, z with NaN where missing, the memory of the sensors,
   NULL where nothing is learned, and what the filter keeps besides, NULL where psi bounds. */
typedef struct {
    PyObject *x, *P, *record, *z, *memory, *kept;
} corrected;

/* Make room for all that; z may be there. -1 with an exception. */
static int begin_corrected(held *h, const judge *by, const filter_state *now, const sensors *s, PyObject *z,
                           corrected *made) {
    const npy_intp n = now->n, m = s->m;
    const npy_intp length = by->mixes ? MIXED_ROWS * m + n + n * n + 2 * m * (m + n) : (RECORD_ROWS + m + n) * m;
    made->x = array_of(h, NULL, now->ndim, n, 1, 0), made->P = array_of(h, now->P, 2, n, n, 0);
    made->record = array_of(h, NULL, 1, RECORD_HEAD + length, 0, 0);
    made->z = z ? z : array_of(h, NULL, now->ndim, m, 1, 0);
    made->memory = s->learned ? array_of(h, s->learned, 2, s->memories, by->width, 0) : NULL, made->kept = NULL;
    if (h->failed) return -1;
    const double head[RECORD_HEAD] = {(double)n, (double)m, by->mixes ? RECORD_MIXED : by->bounded.scaling, 0};
    real_copy(RECORD_HEAD, head, numbers_of(made->record));
    return 1;
}

/* An innovation, NaN where missing, and what it has to do with the state: C (n, m) and S, or both follow from H. */
typedef struct {
    const double *y, *C, *S;
} moments_given;

/* Correct a state by the readings of linear sensors in made->z, or by an innovation, y not NULL, for which x counts as 0;
   whether all was ordinary, -1 with an exception. */
static int correct_bounded(const correction_rule *rule, const filter_state *now, const sensors *s,
                           const moments_given *given, corrected *made) {
    const int n = (int)now->n, m = (int)s->m;
    const double *const z = numbers_of(made->z), *const y = given->y ? given->y : z;
    correction c;
    double stack[STACK_WORK], *const work = work_of(stack, update_work(n, m)), *const values = numbers_of(made->record);
    double *const x = numbers_of(made->x), *const innovations = record_row(values, ROW_Y, m);
    double *const shown = record_row(values, RECORD_ROWS, m);
    const spread_memory *const before = (const spread_memory *)s->learned;
    spread_memory *const memory = before ? (spread_memory *)numbers_of(made->memory) : NULL;
    int fine = 0;
    if (!work) return -1;
    correction_begin(n, m, 1, &c, work);
    for (int k = 0; k < n; k++) x[k] = given->y ? 0 : now->x[k];
    for (int i = 0; i < m; i++) {
        innovations[i] = y[i] != y[i] ? 0 : given->y ? y[i] : y[i] - real_dot(n, s->H + i * n, x);
        fine |= y[i] == y[i];
        for (int k = 0; given->S && k < n; k++) c.C[i * n + k] = given->C[k * m + i];
    }
    if (given->S) real_copy(m * m, given->S, c.S);
    fine = fine && is_covariance(s->R, m, shown) &&
           update(n, m, rule, z, y, s->H, s->R, s->M, memory, x, numbers_of(made->P), &c, shown, work);
    if (fine) begin_record(values, m, rule, &c);
    for (int k = 0; given->y && k < n; k++) x[k] = now->x[k] + x[k];
    /* That a sensor's far reading repeats for the first time is said, which may refuse the call: for the definition. */
    for (int i = 0; before && i < m; i++) fine = fine && !(before[i].filled == 0 && memory[i].filled > 0);
    work_done(stack, work);
    return called_outcome(fine && all_finite(x, n));
}

/* Give a filter what was made of a measurement; 1, or -1 with an exception. */
static int set_corrected(held *h, PyObject *filter, const judge *by, const sensors *s, const corrected *made) {
    if (!set_state(h, filter, made->x, made->P, AT_x_post, AT_P_post)) return -1;
    if (made->kept && set_attribute(filter, AT__kept, made->kept) < 0) return -1;
    if (set_attribute(filter, AT_z, made->z) < 0 || set_attribute(filter, AT__last, made->record) < 0) return -1;
    if (by->learns && !(s->by_rows ? set_rows(h, filter, by, s, numbers_of(made->memory))
                                   : set_attribute(filter, AT__memory, made->memory) == 0))
        return -1;
    for (enum attribute which = AT__y; which <= AT__mahalanobis; which++)
        if (set_attribute(filter, which, Py_None) < 0) return -1;
    return 1;
}

/* The models (rows, n) with k further states at 0, with this covariance, each in the part of the first one that its sensor
   sees; whole: H (k, n + k). to: their arrays. */
static void extend(int n, int k, const models *f, const double *covariance, const double *whole, learnt_state *to) {
    const int all = n + k, rows = learnt_rows(f->rule), beliefs = learnt_beliefs(1, f->rule);
    for (int i = 0; i < rows * all; i++) to->x[i] = i % all < n ? f->s.x[i / all * n + i % all] : 0;
    for (int i = 0; i < rows * all * all; i++) {
        const int model = i / (all * all), row = i / all % all, column = i % all;
        to->P[i] = row < n && column < n     ? f->s.P[(model * n + row) * n + column]
                   : row >= n && column >= n ? covariance[(row - n) * k + column - n]
                                             : 0;
    }
    for (int i = 0; i < beliefs * all; i++) {
        const int state = i % all, like = state < n ? state : learnt_sees(all, whole, state - n);
        to->p[i] = f->s.p[i / all * n + (like < n ? like : 0)];
    }
    for (int i = 0; i < k * k; i++)
        if (covariance[i] != 0) learnt_join(all, f->rule, to, n + i / k, n + i % k);
}

#define NO_LAG 0.1 /* standard deviations that a start leaves where there is no noise */

/* Correct models by the readings of linear sensors in made->z, or by an innovation, y not NULL, of a line through the state,
   which counts as 0, and by a state of its own for what the line does not explain; as `correct_bounded`. */
static int correct_models(held *h, const judge *by, PyObject *kept, const filter_state *now, const sensors *s,
                          const moments_given *given, corrected *made) {
    const learnt_rule *const rule = &by->mixture;
    const int n = (int)now->n, m = (int)s->m, k = given->S ? m : 0, all = n + k, rows = learnt_rows(rule);
    const size_t own = (size_t)((rows + 1) * all * (all + 1) + learnt_beliefs(all, rule) + m * all);
    double stack[STACK_WORK], *work;
    models f;
    int fine = m > 1000 ? 0 : take_models(h, rule, kept, now, 0, &f);
    if (fine <= 0) return fine;
    work = work_of(stack, own + correct_work(rule, all, m) + (size_t)(m * m) + regress_work(n, m));
    if (!work) return -1;
    double *const values = numbers_of(made->record), *const weights = record_row(values, ROW_WEIGHTS, m);
    double *const lags = record_row(values, ROW_LAGS, m), *const z = record_row(values, ROW_Z, m);
    double *const x_prior = record_row(values, MIXED_ROWS, m), *const P_prior = x_prior + n, *const H = P_prior + n * n;
    double *const R = H + m * n, *const bend = R + m * m, *const M = bend + m * m;
    double *const x = work, *const P = x + all, *const whole = P + all * all, *const means = whole + m * all;
    double *const rest = means + rows * all * (all + 1) + learnt_beliefs(all, rule);
    double *const mean = numbers_of(f.after[3]), *const covariance = numbers_of(f.after[4]);
    learnt_state state = f.s;
    real_copy(m, given->y ? given->y : numbers_of(made->z), z);
    for (int i = 0; i < n; i++) x_prior[i] = given->y ? 0 : now->x[i];
    real_copy(n * n, now->P, P_prior), real_copy(m * m, s->R, R);
    for (int i = 0; i < m * n; i++) H[i] = s->H ? s->H[i] : 0, M[i] = s->M ? s->M[i] : 0;
    for (int i = 0; i < m * m; i++) bend[i] = 0;
    fine = is_covariance(R, m, rest);
    if (fine && k) regress(n, m, now->P, given->C, given->S, R, H, bend, rest);
    for (int i = 0; i < m; i++) {
        int sees = !given->y;
        for (int j = 0; j < all; j++) whole[i * all + j] = j < n ? H[i * n + j] : j - n == i;
        for (int j = 0; j < n; j++) sees |= H[i * n + j] != 0;
        if (!sees) z[i] = NAN;
        const double lag = real_dot(n, H + i * n, x_prior), factor = s->learned[rule->joint ? 0 : i * by->width];
        const double variance = R[i * m + i] * factor + bend[i * m + i] + real_square(n, H + i * n, P_prior);
        /* The definition says where H x is no number. */
        fine = fine && lag - lag == 0;
        lags[i] = fabs(z[i] - lag) < NO_LAG * sqrt(variance) ? 0 : z[i] - lag;
        record_row(values, ROW_FACTORS, m)[i] = factor, record_row(values, ROW_LEADS, m)[i] = learnt_lead(rule, i);
    }
    for (int i = 0; given->y && i < rows * n; i++) f.s.x[i] -= now->x[i % n];
    if (k) {
        state = (learnt_state){means, means + rows * all, means + rows * all * (all + 1), NULL};
        extend(n, k, &f, bend, whole, &state);
    }
    state.memory = numbers_of(made->memory);
    fine = fine && learnt_correct(all, m, rule, &state, z, numbers_of(made->z), whole, R, s->M, weights,
                                  record_row(values, ROW_OUTLYING, m), values + RECORD_LOG_DENSITY, rest) > 0 &&
           learnt_merge(all, rule, &state, x, P, rest);
    /* That a sensor is stuck is said in words, by the definition. */
    for (int i = 0; i < m; i++) fine = fine && weights[i] != 0;
    for (int i = 0; i < n; i++) {
        mean[i] = given->y ? now->x[i] + x[i] : x[i];
        for (int j = 0; j < n; j++) covariance[i * n + j] = 0.5 * (P[i * all + j] + P[j * all + i]);
    }
    for (int i = 0; given->y && i < rows * n; i++) f.s.x[i] = state.x[i / n * all + i % n] + (mean[i % n] - x[i % n]);
    for (int i = 0; k && i < rows * n * n; i++) f.s.P[i] = state.P[(i / (n * n) * all + i / n % n) * all + i % n];
    for (int i = 0; k && i < learnt_beliefs(n, rule); i++) f.s.p[i] = state.p[i / n * all + i % n];
    work_done(stack, work);
    if (!fine || !all_finite(mean, n) || !all_finite(covariance, n * n)) return 0;
    show_models(&f, made->x, made->P);
    return (made->kept = kept_of(h, &f)) ? 1 : -1;
}

/* Correct, by what judges; 1, 0 or -1. */
static int correct_by(held *h, PyObject *filter, const judge *by, PyObject *kept, const filter_state *now, const sensors *s,
                      const moments_given *given, corrected *made) {
    const int outcome = by->mixes ? correct_models(h, by, kept, now, s, given, made)
                                  : correct_bounded(&by->bounded, now, s, given, made);
    return outcome > 0 ? set_corrected(h, filter, by, s, made) : outcome;
}

/* given: R, H and M for this call, or None. */
static int take_correction(held *h, PyObject *filter, PyObject *z, PyObject *const given[3]) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_dim_z, AT_inv, AT_R, AT_H, AT__memory,
                                           AT__other_sensors, AT__kept};
    static const moments_given none = {NULL, NULL, NULL};
    judge by;
    filter_state now;
    sensors s;
    corrected made;
    PyObject *const *own;
    int outcome = take_judge(h, filter, &by);
    if (outcome <= 0) return outcome;
    own = h->objects + h->count;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0) return -1;
    if (!take_filter(own[0], own[1], own[2], &now)) return 0;
    outcome = take_sensors(h, &by, given, own + 3, now.n, &s);
    if (outcome <= 0) return outcome;
    if (!(z = as_plain(h, z)) || begin_corrected(h, &by, &now, &s, NULL, &made) < 0) return -1;
    if (!take_measurement(z, s.m, numbers_of(made.z))) return 0;
    return correct_by(h, filter, &by, own[9], &now, &s, &none, &made);
}

STEP(correct_step, 5, take_correction(&h, arguments[0], arguments[1], arguments + 2),
     "correct: expected a filter, z, R, H and M")

/* The Jacobian of sensors (m, n) and None, or C (n, m) and S; whether they are that. */
static int take_moments(sensors *s, moments_given *given, PyObject *C, PyObject *S, npy_intp n) {
    const int linear = S == Py_None;
    s->H = s->M = given->S = NULL;
    if (!is_array(C, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)C, !linear);
    if (s->m < 1 || s->m > 10000) return 0;
    given->C = linear ? matrix_of(C, s->m, n) : matrix_of(C, n, s->m);
    if (!given->C || !all_finite(given->C, n * s->m)) return 0;
    if (linear) s->H = given->C;
    else given->S = matrix_of(S, s->m, s->m);
    return linear || (given->S && is_symmetric(given->S, s->m));
}

/* given: z, the prediction of z or None, the innovation or None, C, S, R. */
static int take_innovation(held *h, PyObject *filter, PyObject *const given[6]) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_inv, AT_R, AT__memory, AT__kept};
    judge by;
    filter_state now;
    sensors s = {.by_rows = 0};
    moments_given innovation;
    corrected made;
    PyObject *const *own, *plain[6], *z, *y;
    int outcome = take_judge(h, filter, &by);
    if (outcome <= 0) return outcome;
    own = h->objects + h->count;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0) return -1;
    for (int i = 0; i < 6; i++)
        if (!(plain[i] = given_or(h, given[i], i == 5 ? own[4] : Py_None))) return -1;
    if (own[3] != numpy_inverse || !take_filter(own[0], own[1], own[2], &now)) return 0;
    if (!take_moments(&s, &innovation, plain[3], plain[4], now.n)) return 0;
    s.R = covariance_of(h, plain[5], s.m), s.memory = own[5];
    if (!s.R) return PyErr_Occurred() ? -1 : 0;
    outcome = take_memory(h, &by, &s);
    if (outcome <= 0) return outcome;
    z = array_of(h, NULL, now.ndim, s.m, 1, 0), y = array_of(h, NULL, 1, s.m, 0, 0);
    if (h->failed || begin_corrected(h, &by, &now, &s, z, &made) < 0) return -1;
    if (!take_difference(plain, s.m, numbers_of(z), numbers_of(y))) return 0;
    innovation.y = numbers_of(y);
    return correct_by(h, filter, &by, own[6], &now, &s, &innovation, &made);
}

STEP(innovation_step, 7, take_innovation(&h, arguments[0], arguments + 1),
     "correct_innovation: expected a filter, z, its prediction, y, C, S and R")

/* The writable arrays of a dictionary that nobody else has, and what they hold, one after another: a copy of each as an array
   of its own takes as long as a step. None if one is not of numbers in one piece. See robust_filterpy.filters.snapshot. */
static PyObject *copied_arrays(PyObject *self, PyObject *attributes) {
    PyObject *arrays, *contents, *found, *key, *value;
    Py_ssize_t place = 0, total = 0;
    char *to;
    (void)self;
    if (!PyDict_CheckExact(attributes)) {
        PyErr_SetString(PyExc_TypeError, "copied_arrays: expected a dictionary");
        return NULL;
    }
    arrays = PyList_New(0);
    while (arrays && PyDict_Next(attributes, &place, &key, &value)) {
        PyArrayObject *const array = (PyArrayObject *)value;
        if (!PyArray_CheckExact(value) || !PyArray_ISWRITEABLE(array)) continue;
        if (!PyTypeNum_ISNUMBER(PyArray_TYPE(array)) || !PyArray_ISONESEGMENT(array)) {
            Py_DECREF(arrays);
            Py_RETURN_NONE;
        }
        total += PyArray_NBYTES(array);
        if (PyList_Append(arrays, value) < 0) Py_CLEAR(arrays);
    }
    contents = arrays ? PyBytes_FromStringAndSize(NULL, total) : NULL;
    to = contents ? PyBytes_AsString(contents) : NULL;
    for (Py_ssize_t i = 0; to && i < PyList_Size(arrays); i++) {
        PyArrayObject *const array = (PyArrayObject *)PyList_GetItem(arrays, i);
        memcpy(to, PyArray_DATA(array), (size_t)PyArray_NBYTES(array));
        to += PyArray_NBYTES(array);
    }
    found = contents ? PyTuple_Pack(2, arrays, contents) : NULL;
    Py_XDECREF(arrays);
    Py_XDECREF(contents);
    return found;
}

PyMethodDef step_functions[] = {
    {"predict", (PyCFunction)(void (*)(void))predict_step, METH_FASTCALL,
     "Predict a filter's next state: (filter, u, B, F, Q, moves), None for its own; moves: x too, not P alone."},
    {"correct", (PyCFunction)(void (*)(void))correct_step, METH_FASTCALL,
     "Correct a filter's state: (filter, z, R, H, M), None for its own R and H and for no M."},
    {"correct_innovation", (PyCFunction)(void (*)(void))innovation_step, METH_FASTCALL,
     "Correct a filter's state by an innovation: (filter, z, its prediction or None, y or None, C, S, R or None); the "
     "Jacobian for C, and then None for S."},
    {"copied_arrays", copied_arrays, METH_O, "Return the writable arrays of a dictionary, and what they hold."},
    {NULL, NULL, 0, NULL}};

/* One step of one filter under noise that is learned, as one call: attributes read, the step taken, attributes set. */
#include "groups.h"
#include "mend.h"
#include "online.h"

/* The models of a filter, in arrays of their own that a step may change, and what they merge to. */
typedef struct {
    learnt_rule rule;
    learnt_state s;
    filter_state now;
    PyObject *kept; /* as the filter has it: a tuple, or None where there is one model */
    PyObject *x, *P; /* priors that nobody writes to */
    PyObject *means, *covariances, *p, *x_next, *P_next;
    PyObject *x_set, *P_set; /* what the filter gets of these: code of Python's may have had the others */
} mixture;

static PyObject *array_of(held *h, int ndim, npy_intp first, npy_intp second, npy_intp third) {
    npy_intp shape[3] = {first, second, third};
    return hold(h, PyArray_SimpleNew(ndim, shape, NPY_DOUBLE));
}

/* An array of this shape with the same numbers. */
static PyObject *copied(held *h, const double *numbers, int ndim, npy_intp first, npy_intp second) {
    PyObject *const found = array_of(h, ndim, first, second, 0);
    if (found) real_copy((int)(ndim == 1 ? first : first * second), numbers, numbers_of(found));
    return found;
}

/* Read x, P and the models; whether all is ordinary, -1 with an exception. x or P that have been assigned from outside are
   for the definition. given: dim_x, x, P, _kept; rule: of the policy. */
static int take_mixture(held *h, PyObject *const given[4], PyObject *rule, mixture *f) {
    const double *means, *covariances, *p;
    npy_intp rows, n, shape[3], beliefs[2];
    if (!take_rule(&f->rule, rule) || !take_filter(given[0], given[1], given[2], &f->now) || f->now.n > 1000) return 0;
    n = shape[1] = shape[2] = f->now.n;
    rows = shape[0] = learnt_rows(&f->rule);
    beliefs[0] = learnt_beliefs(1, &f->rule), beliefs[1] = n;
    f->kept = given[3];
    if (f->kept == Py_None) {
        if (rows != 1) return 0;
        means = f->now.x, covariances = f->now.P, p = NULL;
        f->x = copied(h, f->now.x, 1, n, 0);
        f->P = f->x ? copied(h, f->now.P, 2, n, n) : NULL;
        if (!f->P) return -1;
    } else {
        const double *x, *P;
        if (!PyTuple_Check(f->kept) || PyTuple_Size(f->kept) != 5) return 0;
        means = writable(PyTuple_GetItem(f->kept, 0), 2, shape);
        covariances = writable(PyTuple_GetItem(f->kept, 1), 3, shape);
        p = writable(PyTuple_GetItem(f->kept, 2), 2, beliefs);
        f->x = PyTuple_GetItem(f->kept, 3), f->P = PyTuple_GetItem(f->kept, 4);
        x = vector_of(f->x, n), P = matrix_of(f->P, n, n);
        if (!means || !covariances || !p || !x || !P) return 0;
        if (memcmp(x, f->now.x, (size_t)n * sizeof *x) || memcmp(P, f->now.P, (size_t)(n * n) * sizeof *P)) return 0;
    }
    f->means = array_of(h, 2, rows, n, 0);
    f->covariances = f->means ? array_of(h, 3, rows, n, n) : NULL;
    f->p = f->covariances ? array_of(h, 2, beliefs[0], n, 0) : NULL;
    f->x_next = f->p ? array_of(h, 1, n, 0, 0) : NULL;
    f->P_next = f->x_next ? array_of(h, 2, n, n, 0) : NULL;
    f->x_set = f->P_next ? array_of(h, f->now.ndim, n, 1, 0) : NULL;
    f->P_set = f->x_set ? array_of(h, 2, n, n, 0) : NULL;
    if (!f->P_set) return -1;
    f->s.x = numbers_of(f->means), f->s.P = numbers_of(f->covariances), f->s.p = numbers_of(f->p);
    f->s.memory = NULL;
    real_copy((int)(rows * n), means, f->s.x);
    real_copy((int)(rows * n * n), covariances, f->s.P);
    /* Of one model there is one part. */
    for (npy_intp i = 0; i < beliefs[0] * n; i++) f->s.p[i] = p ? p[i] : i < n;
    return learnt_has_parts((int)n, &f->rule, &f->s);
}

static int merge(mixture *f, double *work) {
    const int n = (int)f->now.n;
    if (!learnt_merge(n, &f->rule, &f->s, numbers_of(f->x_next), numbers_of(f->P_next), work)) return 0;
    real_copy(n, numbers_of(f->x_next), numbers_of(f->x_set));
    real_copy(n * n, numbers_of(f->P_next), numbers_of(f->P_set));
    return 1;
}

/* What the filter is to keep after the step: a tuple of the same kind, or None. */
static PyObject *next_kept(held *h, const mixture *f) {
    if (f->kept == Py_None) return Py_None;
    return hold(h, PyObject_CallFunction((PyObject *)Py_TYPE(f->kept), "OOOOO", f->means, f->covariances, f->p, f->x_next,
                                         f->P_next));
}

/* Set x, P, their copies and what is kept; whether that went well. */
static int set_mixture(held *h, PyObject *filter, const mixture *f, enum attribute x_too, enum attribute P_too) {
    PyObject *const kept = next_kept(h, f);
    return kept && set_state(h, filter, f->x_set, f->P_set, x_too, P_too) &&
           set_attribute(filter, AT__kept, kept) == 0;
}

/* given: B, F and Q for this call, or None. */
static int predict_mixture(held *h, PyObject *filter, PyObject *u, PyObject *const *given) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT__kept, AT_F, AT_Q, AT__alpha_sq, AT_B, AT__policy};
    PyObject *const *const own = h->objects;
    mixture f;
    motion how;
    double stack[STACK_WORK], *work, *control;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0 || !hold_attribute(h, own[8], AT_rule)) return -1;
    fine = take_mixture(h, own, own[9], &f);
    if (fine <= 0) return fine;
    const int n = (int)f.now.n;
    fine = take_motion(h, given, own + 4, n, &how);
    if (fine <= 0) return fine;
    work = work_of(stack, learnt_predict_work(n, learnt_models(&f.rule)) + (size_t)n);
    if (!work) return -1;
    control = work;
    fine = take_control(how.B, u, n, &control);
    if (fine) {
        learnt_predict(n, &f.rule, &f.s, how.F, how.Q, control, how.alpha_sq, work + n);
        fine = merge(&f, work + n);
    }
    work_done(stack, work);
    if (!fine) return 0;
    return set_mixture(h, filter, &f, AT_x_prior, AT_P_prior) ? 1 : -1;
}

/* Whether H x is a number everywhere. */
static int is_finite_product(const double *H, const double *x, npy_intp m, npy_intp n) {
    for (npy_intp i = 0; i < m; i++) {
        const double total = real_dot((int)n, H + i * n, x);
        if (total - total != 0) return 0;
    }
    return 1;
}

/* What a correction leaves besides the state. */
typedef struct {
    PyObject *memory, *weights, *outlying;
    double likelihood;
} weighed;

static int begin_weighed(held *h, const learnt_rule *rule, const double *before, npy_intp m, weighed *made) {
    made->memory = copied(h, before, 2, memory_rows(rule, m), learnt_width(rule->K));
    made->weights = made->memory ? array_of(h, 1, m, 0, 0) : NULL;
    made->outlying = made->weights ? array_of(h, 1, m, 0, 0) : NULL;
    made->likelihood = 0;
    return made->outlying != NULL;
}

/* Correct by z (m), the sensors having read `readings`; whether that was ordinary. work: correct_work. */
static int weigh(int n, int m, const learnt_rule *rule, learnt_state *s, const double *z, const double *readings,
                 const double *H, const double *R, const double *M, weighed *made, double *work) {
    const double *const weights = numbers_of(made->weights);
    s->memory = numbers_of(made->memory);
    if (learnt_correct(n, m, rule, s, z, readings, H, R, M, numbers_of(made->weights), numbers_of(made->outlying),
                       &made->likelihood, work) <= 0)
        return 0;
    /* That a sensor is stuck is said in words, by the definition. */
    for (int i = 0; i < m; i++)
        if (weights[i] == 0) return 0;
    return 1;
}

#define NO_LAG 0.1 /* standard deviations that a start leaves where there is no noise */

/* Innovations z - H x as Mixed.lags has them. x: NULL for a state at 0; before: memory of the noise, rows of width,
   or 0 for one row; curvature (m, m) or NULL. */
static PyObject *lags_of(held *h, int n, int m, const double *z, const double *x, const double *P, const double *H,
                         const double *R, const double *before, int width, const double *curvature) {
    PyObject *const lags = array_of(h, 1, m, 0, 0);
    for (int i = 0; lags && i < m; i++) {
        const double y = z[i] - (x ? real_dot(n, H + i * n, x) : 0), noise = R[i * m + i] * before[i * width];
        const double variance = noise + (curvature ? curvature[i * m + i] : 0) + real_square(n, H + i * n, P);
        numbers_of(lags)[i] = fabs(y) < NO_LAG * sqrt(variance) ? 0 : y;
    }
    return lags;
}

/* The probability that a component was an outlier; sensors that fail together have one. */
static double outlier_probability(const learnt_rule *rule, int m, const double *outlying) {
    double ordinary = 1;
    for (int i = 0; i < m; i++) {
        double most = outlying[i];
        int first = 1;
        for (int j = 0; j < m; j++)
            if (learnt_lead(rule, j) == learnt_lead(rule, i)) most = real_max(most, outlying[j]), first &= j >= i;
        if (first && (m == 1 || rule->joint)) return most;
        if (first) ordinary *= 1 - most;
    }
    return 1 - ordinary;
}

/* Give a filter what a correction has left of it but x and P; 1, or -1 with an exception. */
static int set_weighed(held *h, PyObject *filter, const learnt_rule *rule, int m, PyObject *z, PyObject *record,
                       const weighed *made, const sensor_rows *rows) {
    PyObject *const probability =
        hold(h, PyFloat_FromDouble(outlier_probability(rule, m, numbers_of(made->outlying))));
    if (!probability || set_attribute(filter, AT__outlier_probability, probability) < 0) return -1;
    return set_measured(h, filter, z, record, rows, rule->learns ? made->memory : NULL);
}

/* given: R, H and M for this call, or None. */
static int correct_mixture(held *h, PyObject *filter, PyObject *z, PyObject *const *given) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT__kept, AT_dim_z, AT_inv, AT_R, AT_H,
                                           AT__memory, AT__other_sensors, AT__policy};
    PyObject *const *const own = h->objects;
    PyObject *seen, *shown, *lags, *H_too, *R_too, *M_too = Py_None, *make, *record;
    mixture f;
    sensors s;
    weighed made;
    const double *before;
    double stack[STACK_WORK], *work;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0 || !hold_attribute(h, own[10], AT_rule)) return -1;
    make = hold_attribute(h, own[10], AT_record);
    z = make ? as_plain(h, z) : NULL;
    if (!z) return -1;
    fine = take_mixture(h, own, own[11], &f);
    if (fine <= 0) return fine;
    const int n = (int)f.now.n, width = learnt_width(f.rule.K);
    s.memory = own[8];
    s.rows = (sensor_rows){.width = f.rule.learns && !f.rule.joint ? width : 0, .begin = f.rule.begin};
    fine = take_sensors(h, given, own + 4, n, &s);
    if (fine <= 0) return fine;
    const int m = (int)s.m;
    const double *const H = s.H, *const R = s.R, *const M = s.M;
    if (m > 1000 || !is_finite_product(H, f.now.x, m, n)) return 0;
    if (M && !(M_too = copied(h, M, 2, n, m))) return -1;
    if (!f.rule.learns) {
        s.memory = array_of(h, 2, memory_rows(&f.rule, m), width, 0);
        if (!s.memory) return -1;
        for (npy_intp k = 0; k < memory_rows(&f.rule, m) * width; k++) numbers_of(s.memory)[k] = f.rule.begin[k % width];
    }
    before = matrix_of(s.memory, memory_rows(&f.rule, m), width);
    if (!before) return 0;
    /* z is shown in the shape of x, and kept as a vector. */
    seen = array_of(h, 1, m, 0, 0);
    if (!seen || !begin_weighed(h, &f.rule, before, m, &made)) return -1;
    work = work_of(stack, correct_work(&f.rule, n, m) + (size_t)(m * m));
    if (!work) return -1;
    fine = take_measurement(z, m, numbers_of(seen)) && is_covariance(R, m, work) &&
           weigh(n, m, &f.rule, &f.s, numbers_of(seen), numbers_of(seen), H, R, M, &made, work) && merge(&f, work);
    work_done(stack, work);
    if (!fine) return 0;
    H_too = copied(h, H, 2, m, n);
    R_too = H_too ? copied(h, R, 2, m, m) : NULL;
    shown = R_too ? copied(h, numbers_of(seen), f.now.ndim, m, 1) : NULL;
    lags = shown ? lags_of(h, n, m, numbers_of(seen), f.now.x, f.now.P, H, R, before,
                           memory_rows(&f.rule, m) > 1 ? width : 0, NULL)
                 : NULL;
    record = lags ? hold(h, PyObject_CallFunction(make, "OOOdOOOOOOOOOO", f.x_next, f.P_next, made.memory, made.likelihood,
                                                  made.weights, made.outlying, f.x, f.P, H_too, R_too, M_too, seen,
                                                  s.memory, lags))
                  : NULL;
    if (!record || !set_mixture(h, filter, &f, AT_x_post, AT_P_post)) return -1;
    return set_weighed(h, filter, &f.rule, m, shown, record, &made, &s.rows);
}

/* H (m, n) = C' P^-1, P (n, n) in units of its own and without directions in which it has no extent, and what of S such a line
   does not explain, noise apart: curvature (m, m). work: 3 k k + k, k the larger of n and m. */
static void regress(int n, int m, const double *P, const double *C, const double *S, const double *R, double *H,
                    double *curvature, double *work) {
    const int k = n > m ? n : m;
    double *const A = work, *const V = A + k * k, *const W = V + k * k, *const unit = W + k * k, most = 0;
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
    for (int i = 0; i < m * n; i++) H[i] /= unit[i % n];
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            double seen = 0;
            for (int l = 0; l < n; l++) seen += H[i * n + l] * C[l * m + j];
            W[i * m + j] = W[j * m + i] = S[i * m + j] - R[i * m + j] - seen;
        }
    mend_diagonalize(m, W, V);
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            curvature[i * m + j] = 0;
            for (int o = 0; o < m; o++) curvature[i * m + j] += V[i * m + o] * real_max(W[o * m + o], 0) * V[j * m + o];
        }
}

/* Correct a state at 0 by a line, and by a state of its own for what the line does not explain. given_now: z, its prediction
   or None, the innovation or None, C and S, or the Jacobian and None, R or None. */
static int correct_innovation(held *h, PyObject *filter, PyObject *const *given_now) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_inv, AT_R, AT__memory, AT__policy, AT__kept};
    PyObject *const *const given = h->objects;
    PyObject *plain[6], *make, *seen, *y, *H, *zero, *P_too, *R_too, *curvature, *shown, *lags, *record, *x_next, *P_next;
    learnt_rule rule;
    filter_state now;
    weighed made;
    const double *C, *S, *R, *before;
    double stack[STACK_WORK], *work;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0 || !hold_attribute(h, given[6], AT_rule)) return -1;
    make = hold_attribute(h, given[6], AT_record);
    for (int i = 0; i < 6; i++)
        if (!make || !(plain[i] = as_plain(h, i == 5 && given_now[5] == Py_None ? given[4] : given_now[i]))) return -1;
    if (given[3] != numpy_inverse || given[7] != Py_None || !take_rule(&rule, given[8]) || learnt_models(&rule) != 1 ||
        !take_filter(given[0], given[1], given[2], &now) || !is_array(plain[3], 2))
        return 0;
    const int linear = plain[4] == Py_None, n = (int)now.n, width = learnt_width(rule.K);
    const int m = (int)PyArray_DIM((PyArrayObject *)plain[3], !linear), all = linear ? n : n + m;
    if (m < 1 || m > 1000 || n > 1000) return 0;
    C = linear ? matrix_of(plain[3], m, n) : matrix_of(plain[3], n, m), S = linear ? NULL : matrix_of(plain[4], m, m);
    R = covariance_of(h, plain[5], m), before = matrix_of(given[5], memory_rows(&rule, m), width);
    if (!R && PyErr_Occurred()) return -1;
    if (!C || !R || !before || !all_finite(C, n * m) || (!linear && (!S || !is_symmetric(S, m)))) return 0;
    seen = array_of(h, 1, m, 0, 0), y = seen ? array_of(h, 1, m, 0, 0) : NULL;
    H = y ? copied(h, C, 2, m, n) : NULL, zero = H ? array_of(h, 1, n, 0, 0) : NULL;
    P_too = zero ? copied(h, now.P, 2, n, n) : NULL, R_too = P_too ? copied(h, R, 2, m, m) : NULL;
    curvature = R_too ? array_of(h, 2, m, m, 0) : NULL, x_next = curvature ? array_of(h, now.ndim, n, 1, 0) : NULL;
    P_next = x_next ? array_of(h, 2, n, n, 0) : NULL;
    if (!P_next || !begin_weighed(h, &rule, before, m, &made)) return -1;
    if (!take_difference(plain, m, numbers_of(seen), numbers_of(y))) return 0;
    const size_t k = (size_t)(n > m ? n : m), own = (size_t)(all * (all + 1 + m) + 3 * all);
    work = work_of(stack, own + correct_work(&rule, all, m) + (size_t)(m * m) + 3 * k * k + k);
    if (!work) return -1;
    {
        double *const x = work, *const P = x + all, *const p = P + all * all, *const whole = p + 3 * all;
        double *const rest = whole + m * all, *const h_of = numbers_of(H), *const bend = numbers_of(curvature);
        learnt_state s = {x, P, p, NULL};
        for (int i = 0; i < m * m; i++) bend[i] = 0;
        fine = is_covariance(R, m, rest);
        if (fine && !linear) regress(n, m, now.P, C, S, R, h_of, bend, rest);
        for (int i = 0; i < all; i++) x[i] = 0, p[i] = 1, p[all + i] = p[2 * all + i] = 0;
        for (int i = 0; i < all * all; i++) {
            const int row = i / all, column = i % all;
            P[i] = row < n && column < n ? now.P[row * n + column]
                                         : row >= n && column >= n ? bend[(row - n) * m + column - n] : 0;
        }
        for (int i = 0; i < m; i++) {
            int sees = 0;
            for (int j = 0; j < all; j++) whole[i * all + j] = j < n ? h_of[i * n + j] : j - n == i;
            for (int j = 0; j < n; j++) sees |= h_of[i * n + j] != 0;
            if (!sees) numbers_of(y)[i] = NAN;
        }
        fine = fine && weigh(all, m, &rule, &s, numbers_of(y), numbers_of(seen), whole, R, NULL, &made, rest);
        for (int i = 0; i < n; i++) {
            numbers_of(zero)[i] = 0, numbers_of(x_next)[i] = now.x[i] + x[i];
            for (int j = 0; j < n; j++) numbers_of(P_next)[i * n + j] = 0.5 * (P[i * all + j] + P[j * all + i]);
        }
    }
    work_done(stack, work);
    if (!fine || !all_finite(numbers_of(x_next), n) || !all_finite(numbers_of(P_next), n * n)) return 0;
    shown = copied(h, numbers_of(seen), now.ndim, m, 1);
    lags = shown ? lags_of(h, n, m, numbers_of(y), NULL, now.P, numbers_of(H), R, before,
                           memory_rows(&rule, m) > 1 ? width : 0, numbers_of(curvature))
                 : NULL;
    record = lags ? hold(h, PyObject_CallFunction(make, "OOOdOOOOOOOOOOO", copied(h, numbers_of(x_next), 1, n, 0),
                                                  copied(h, numbers_of(P_next), 2, n, n), made.memory, made.likelihood,
                                                  made.weights, made.outlying, zero, P_too, H, R_too, Py_None, y,
                                                  given[5], lags, curvature))
                  : NULL;
    if (!record || !set_state(h, filter, x_next, P_next, AT_x_post, AT_P_post)) return -1;
    return set_weighed(h, filter, &rule, m, shown, record, &made, NULL);
}

STEP(innovation_step, 7, correct_innovation(&h, arguments[0], arguments + 1),
     "correct_mixture_innovation: expected a filter, z, its prediction, y, C, S and R")

STEP(predict_step, 5, predict_mixture(&h, arguments[0], arguments[1], arguments + 2),
     "predict_mixture: expected a filter, u, B, F and Q")

STEP(correct_step, 5, correct_mixture(&h, arguments[0], arguments[1], arguments + 2),
     "correct_mixture: expected a filter, z, R, H and M")

PyMethodDef mixture_functions[] = {
    {"predict_mixture", (PyCFunction)(void (*)(void))predict_step, METH_FASTCALL,
     "Predict the next state of a filter under noise=: (filter, u, B, F, Q), None for its own."},
    {"correct_mixture", (PyCFunction)(void (*)(void))correct_step, METH_FASTCALL,
     "Correct the state of a filter under noise=: (filter, z, R, H, M), None for its own R and H and for no M."},
    {"correct_mixture_innovation", (PyCFunction)(void (*)(void))innovation_step, METH_FASTCALL,
     "Correct the state of a filter under noise= by an innovation; arguments as of correct_innovation."},
    {NULL, NULL, 0, NULL}};

/* One step of one filter under noise that is learnt, as one call: attributes read, the step taken, attributes set. */
#include "groups.h"
#include "online.h"

/* The copies of a filter, in arrays of their own that a step may change, and what they merge to. */
typedef struct {
    learnt_rule rule;
    learnt_state s;
    filter_state now;
    PyObject *kept; /* as the filter has it: a tuple, or None where there is one copy */
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

/* Read x, P and the copies; whether all is ordinary, -1 with an exception. x or P that have been assigned from outside are
   for the definition. given: dim_x, x, P, _kept; rule: of the policy. */
static int take_mixture(held *h, PyObject *const given[4], PyObject *rule, mixture *f) {
    const double *means, *covariances, *p;
    npy_intp copies, n, shape[3], beliefs[2];
    if (!take_rule(&f->rule, rule) || !take_filter(given[0], given[1], given[2], &f->now) || f->now.n > 1000) return 0;
    n = shape[1] = shape[2] = f->now.n;
    copies = shape[0] = learnt_copies(&f->rule);
    beliefs[0] = copies + 2, beliefs[1] = n;
    f->kept = given[3];
    if (f->kept == Py_None) {
        if (copies != 1) return 0;
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
    f->means = array_of(h, 2, copies, n, 0);
    f->covariances = f->means ? array_of(h, 3, copies, n, n) : NULL;
    f->p = f->covariances ? array_of(h, 2, copies + 2, n, 0) : NULL;
    f->x_next = f->p ? array_of(h, 1, n, 0, 0) : NULL;
    f->P_next = f->x_next ? array_of(h, 2, n, n, 0) : NULL;
    f->x_set = f->P_next ? array_of(h, f->now.ndim, n, 1, 0) : NULL;
    f->P_set = f->x_set ? array_of(h, 2, n, n, 0) : NULL;
    if (!f->P_set) return -1;
    f->s.x = numbers_of(f->means), f->s.P = numbers_of(f->covariances), f->s.p = numbers_of(f->p);
    f->s.memory = NULL;
    real_copy((int)(copies * n), means, f->s.x);
    real_copy((int)(copies * n * n), covariances, f->s.P);
    /* Of one copy there is one part. */
    for (npy_intp i = 0; i < (copies + 2) * n; i++) f->s.p[i] = p ? p[i] : i < n;
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

static int predict_mixture(held *h, PyObject *filter, PyObject *u) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT__kept, AT_F, AT_Q, AT__alpha_sq, AT_B, AT__policy};
    PyObject *const *const given = h->objects;
    mixture f;
    const double *F, *Q;
    double stack[STACK_WORK], *work, *control, alpha_sq;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0 || !hold_attribute(h, given[8], AT_rule)) return -1;
    fine = take_mixture(h, given, given[9], &f);
    if (fine <= 0) return fine;
    const int n = (int)f.now.n;
    F = matrix_of(given[4], n, n), Q = covariance_of(h, given[5], n);
    if (!Q && PyErr_Occurred()) return -1;
    if (!F || !Q || !number_of(given[6], &alpha_sq) || !is_symmetric(Q, n)) return 0;
    for (int i = 0; i < n; i++) fine = fine && Q[i * n + i] >= 0;
    if (!fine) return 0;
    work = work_of(stack, learnt_predict_work(n, learnt_copies(&f.rule)) + (size_t)n);
    if (!work) return -1;
    control = work;
    fine = take_control(given[7], u, n, &control);
    if (fine) {
        learnt_predict(n, &f.rule, &f.s, F, Q, control, alpha_sq, work + n);
        fine = merge(&f, work + n);
    }
    work_done(stack, work);
    if (!fine) return 0;
    return set_mixture(h, filter, &f, AT_x_prior, AT_P_prior) ? 1 : -1;
}

/* Whether H x is a number everywhere. */
static int is_finite_product(const double *H, const double *x, npy_intp m, npy_intp n) {
    for (npy_intp i = 0; i < m; i++) {
        double total = 0;
        for (npy_intp k = 0; k < n; k++) total += H[i * n + k] * x[k];
        if (total - total != 0) return 0;
    }
    return 1;
}

/* R: another one for this call, or None. */
static int correct_mixture(held *h, PyObject *filter, PyObject *z, PyObject *told) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT__kept, AT_dim_z,
                                           AT_inv, AT_R, AT_H, AT__memory, AT__policy};
    PyObject *const *const given = h->objects;
    PyObject *seen, *shown, *known, *weights, *outlying, *H_too, *R_too, *make, *record, *probability;
    mixture f;
    const double *H, *R, *before;
    double stack[STACK_WORK], *work, likelihood = 0, ordinary = 1;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0 || !hold_attribute(h, given[9], AT_rule)) return -1;
    make = hold_attribute(h, given[9], AT_record);
    z = make ? as_plain(h, z) : NULL;
    told = z ? as_plain(h, told == Py_None ? given[6] : told) : NULL;
    if (!told) return -1;
    fine = take_mixture(h, given, given[10], &f);
    if (fine <= 0) return fine;
    const int n = (int)f.now.n, m = (int)whole_number(given[4]), width = learnt_width(f.rule.K);
    if (m < 1 || m > 1000 || given[5] != numpy_inverse || !f.rule.learns) return 0;
    R = covariance_of(h, told, m), H = matrix_of(given[7], m, n), before = matrix_of(given[8], m, width);
    if (!R && PyErr_Occurred()) return -1;
    if (!R || !H || !before || !is_finite_product(H, f.now.x, m, n)) return 0;
    /* z is shown in the shape of x, and kept as a vector. */
    seen = array_of(h, 1, m, 0, 0);
    known = seen ? copied(h, before, 2, m, width) : NULL;
    weights = known ? array_of(h, 1, m, 0, 0) : NULL;
    outlying = weights ? array_of(h, 1, m, 0, 0) : NULL;
    if (!outlying) return -1;
    f.s.memory = numbers_of(known);
    work = work_of(stack, learnt_correct_work(n, m, learnt_copies(&f.rule), f.rule.K) + (size_t)(m * m));
    if (!work) return -1;
    fine = take_measurement(z, m, numbers_of(seen)) && is_covariance(R, m, work) &&
           learnt_correct(n, m, &f.rule, &f.s, numbers_of(seen), numbers_of(seen), H, R, numbers_of(weights),
                          numbers_of(outlying), &likelihood, work) > 0 &&
           merge(&f, work);
    work_done(stack, work);
    /* That a sensor is stuck is said in words, by the definition. */
    for (int i = 0; i < m; i++) fine = fine && numbers_of(weights)[i] != 0;
    if (!fine) return 0;
    for (int i = 0; i < m; i++) ordinary *= 1 - numbers_of(outlying)[i];
    H_too = copied(h, H, 2, m, n);
    R_too = H_too ? copied(h, R, 2, m, m) : NULL;
    probability = R_too ? hold(h, PyFloat_FromDouble(m == 1 ? numbers_of(outlying)[0] : 1 - ordinary)) : NULL;
    shown = probability ? copied(h, numbers_of(seen), f.now.ndim, m, 1) : NULL;
    record = shown ? hold(h, PyObject_CallFunction(make, "OOOdOOOOOOOOO", f.x_next, f.P_next, known, likelihood, weights,
                                                   outlying, f.x, f.P, H_too, R_too, Py_None, seen, given[8]))
                   : NULL;
    if (!record || !set_mixture(h, filter, &f, AT_x_post, AT_P_post)) return -1;
    if (set_attribute(filter, AT_z, shown) < 0 || set_attribute(filter, AT__last, record) < 0 ||
        set_attribute(filter, AT__memory, known) < 0 || set_attribute(filter, AT__outlier_probability, probability) < 0)
        return -1;
    for (enum attribute which = AT__y; which <= AT__mahalanobis; which++)
        if (set_attribute(filter, which, Py_None) < 0) return -1;
    return 1;
}

static PyObject *predict_step(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    held h = {.count = 0};
    (void)self;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "predict_mixture: expected a filter and u");
        return NULL;
    }
    return answer(&h, predict_mixture(&h, arguments[0], arguments[1]));
}

static PyObject *correct_step(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    held h = {.count = 0};
    (void)self;
    if (count != 3) {
        PyErr_SetString(PyExc_TypeError, "correct_mixture: expected a filter, z and R");
        return NULL;
    }
    return answer(&h, correct_mixture(&h, arguments[0], arguments[1], arguments[2]));
}

PyMethodDef mixture_functions[] = {
    {"predict_mixture", (PyCFunction)(void (*)(void))predict_step, METH_FASTCALL,
     "Predict the next state of a filter that learns its noise: (filter, u)."},
    {"correct_mixture", (PyCFunction)(void (*)(void))correct_step, METH_FASTCALL,
     "Correct the state of a filter that learns its noise by its own H: (filter, z, R), None for its own R."},
    {NULL, NULL, 0, NULL}};

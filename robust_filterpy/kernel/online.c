/* One step of one filter as one call: attributes read, the step taken, attributes set. */
#include "online.h"

#include "groups.h"
#include "moments.h"
#include "prediction.h"

/* Python code may run where an attribute is read (a property of a subclass), and may do anything to arrays. So all that a
   step needs is read first, and looked into only then. */
int hold_all(held *h, PyObject *filter, const enum attribute *which, int count) {
    for (int i = 0; i < count; i++) {
        PyObject *const found = hold_attribute(h, filter, which[i]);
        if (!found) return -1;
        if (which[i] >= AT_F && which[i] <= AT_B) {
            PyObject *const plain = as_plain(h, found);
            if (!plain) return -1;
            /* Its place is that of the attribute. */
            if (plain != found) {
                h->count--;
                h->objects[h->count - 1] = plain;
                Py_DECREF(found);
            }
        }
    }
    return 1;
}

/* A whole number from 1 to 10000, or 0: also of the square of such a size there is an int. */
npy_intp whole_number(PyObject *object) {
    npy_intp found;
    if (!PyLong_CheckExact(object)) return 0;
    found = PyLong_AsSsize_t(object);
    if (found == -1 && PyErr_Occurred()) PyErr_Clear();
    return found > 0 && found <= 10000 ? found : 0;
}

/* Whether x is (n,) or (n, 1) and P a symmetric (n, n). */
int take_filter(PyObject *dim_x, PyObject *x, PyObject *P, filter_state *s) {
    s->n = whole_number(dim_x);
    s->x = vector_of(x, s->n);
    s->P = matrix_of(P, s->n, s->n);
    if (!s->n || !s->x || !s->P || !is_symmetric(s->P, s->n)) return 0;
    s->ndim = PyArray_NDIM((PyArrayObject *)x);
    return 1;
}

/* Set x and P and their copies; return whether that went well. */
int set_state(held *h, PyObject *filter, PyObject *x, PyObject *P, enum attribute x_too, enum attribute P_too) {
    PyObject *const x_copy = hold(h, PyArray_NewCopy((PyArrayObject *)x, NPY_CORDER));
    PyObject *const P_copy = x_copy ? hold(h, PyArray_NewCopy((PyArrayObject *)P, NPY_CORDER)) : NULL;
    return P_copy && set_attribute(filter, AT_x, x) == 0 && set_attribute(filter, AT_P, P) == 0 &&
           set_attribute(filter, x_too, x_copy) == 0 && set_attribute(filter, P_too, P_copy) == 0;
}

/* Write B u into control, and let the pointer to it be NULL if there is none; return whether that is all ordinary. */
int take_control(PyObject *B, PyObject *u, npy_intp n, double **control) {
    npy_intp width;
    double number;
    const double *values = &number, *matrix;
    if (u == Py_None || B == Py_None) {
        *control = NULL;
        return 1;
    }
    if (!is_array(B, 2)) return 0;
    width = PyArray_DIM((PyArrayObject *)B, 1);
    matrix = matrix_of(B, n, width);
    if (width != 1 || !number_of(u, &number)) values = vector_of(u, width);
    if (!matrix || !values) return 0;
    for (npy_intp i = 0; i < n; i++) {
        (*control)[i] = 0;
        for (npy_intp k = 0; k < width; k++) (*control)[i] += matrix[i * width + k] * values[k];
    }
    return 1;
}

static int take_prediction(held *h, PyObject *filter, PyObject *u) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_F, AT_Q, AT__alpha_sq, AT_B};
    PyObject *const *const given = h->objects;
    filter_state now;
    const double *F, *Q;
    PyObject *x_next, *P_next;
    double stack[STACK_WORK], *work, *control, alpha_sq;
    int fine = 1;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0) return -1;
    if (!take_filter(given[0], given[1], given[2], &now)) return 0;
    F = matrix_of(given[3], now.n, now.n);
    Q = covariance_of(h, given[4], now.n);
    if (!Q && PyErr_Occurred()) return -1;
    if (!F || !Q || !number_of(given[5], &alpha_sq) || !is_symmetric(Q, now.n)) return 0;
    for (npy_intp i = 0; i < now.n; i++) fine = fine && Q[i * now.n + i] >= 0;
    if (!fine) return 0;
    x_next = hold(h, new_array(now.ndim, now.n, 1));
    P_next = x_next ? hold(h, new_array(2, now.n, now.n)) : NULL;
    work = P_next ? work_of(stack, predict_work((int)now.n) + (size_t)now.n) : NULL;
    if (!work) return -1;
    control = work;
    fine = take_control(given[6], u, now.n, &control) &&
           predict((int)now.n, now.x, now.P, F, Q, control, alpha_sq, numbers_of(x_next), numbers_of(P_next), work + now.n);
    work_done(stack, work);
    if (!fine) return 0;
    return set_state(h, filter, x_next, P_next, AT_x_prior, AT_P_prior) ? 1 : -1;
}

static PyObject *predict_step(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    held h = {.count = 0};
    (void)self;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "predict: expected a filter and u");
        return NULL;
    }
    return answer(&h, take_prediction(&h, arguments[0], arguments[1]));
}

/* Write a measurement into z, NaN where missing; return whether it is an ordinary one with something in it. */
int take_measurement(PyObject *object, npy_intp m, double *z) {
    PyArrayObject *const array = (PyArrayObject *)object;
    int seen = 0;
    if (m == 1 && number_of(object, z)) {
    } else if (PyList_CheckExact(object) || PyTuple_CheckExact(object)) {
        const int list = PyList_CheckExact(object);
        if ((list ? PyList_Size(object) : PyTuple_Size(object)) != m) return 0;
        for (npy_intp i = 0; i < m; i++)
            if (!number_of(list ? PyList_GetItem(object, i) : PyTuple_GetItem(object, i), z + i)) return 0;
    } else {
        /* With strides: a row of a table may be a column of its array. */
        if (!PyArray_CheckExact(object) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISBEHAVED_RO(array)) return 0;
        if (PyArray_NDIM(array) < 1 || PyArray_NDIM(array) > 2 || PyArray_DIM(array, 0) != m) return 0;
        if (PyArray_NDIM(array) == 2 && PyArray_DIM(array, 1) != 1) return 0;
        for (npy_intp i = 0; i < m; i++) z[i] = *(double *)(PyArray_BYTES(array) + i * PyArray_STRIDE(array, 0));
    }
    for (npy_intp i = 0; i < m; i++) {
        if (isinf(z[i])) return 0;
        seen |= z[i] == z[i];
    }
    return seen;
}

/* Everything that a measurement is taken up by, checked. */
typedef struct {
    correction_rule rule;
    npy_intp m;
    const double *H, *R, *M, *memory; /* M and memory may be NULL */
} sensors;

/* Take M, or None, and the memory of sensors that learn; whether they are that. */
static int take_more(sensors *s, npy_intp n, PyObject *M, PyObject *memory) {
    s->M = s->memory = NULL;
    if (M != Py_None) {
        s->M = matrix_of(M, n, s->m);
        if (!s->M || !all_finite(s->M, n * s->m)) return 0;
    }
    if (s->rule.scaling == SCALING_LEARNT) {
        s->memory = matrix_of(memory, s->m, SPREAD_NUMBERS);
        if (!s->memory || !all_finite(s->memory, s->m * SPREAD_NUMBERS)) return 0;
    }
    return 1;
}

/* given: R, H, M, then what take_correction has read. */
static int take_sensors(held *h, PyObject *const given[3], PyObject *const own[5], npy_intp n, sensors *s) {
    PyObject *const dim_z = own[0], *const inverse = own[1], *const memory = own[4];
    PyObject *const R = as_plain(h, given[0] == Py_None ? own[2] : given[0]);
    PyObject *const H = R ? as_plain(h, given[1] == Py_None ? own[3] : given[1]) : NULL;
    if (!H) return -1;
    if (inverse != numpy_inverse || !is_array(H, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)H, 0);
    s->H = matrix_of(H, s->m, n);
    s->R = s->m > 0 && s->m <= 10000 ? covariance_of(h, R, s->m) : NULL;
    if (!s->R && PyErr_Occurred()) return -1;
    if (s->m < 1 || s->m > 10000 || !s->H || !s->R || (given[1] == Py_None && s->m != whole_number(dim_z))) return 0;
    /* Sensors of an H that is passed are known by its rows. */
    if (s->rule.scaling == SCALING_LEARNT && given[1] != Py_None) return 0;
    return take_more(s, n, given[2], memory);
}

/* What a correction leaves: see robust_filterpy.kernel.record, which reads it. Not the innovations, S and C. */
static void begin_record(double *values, npy_intp n, npy_intp m, const correction_rule *rule, const correction *c) {
    double *const vectors = values + 4;
    values[0] = (double)n;
    values[1] = (double)m;
    values[2] = (double)rule->scaling;
    values[3] = correction_log_likelihood(rule, c);
    real_copy((int)(4 * m), c->e, vectors + m);     /* e, weights, slopes, d */
    real_copy((int)(2 * m), c->v, vectors + 5 * m); /* v, order */
    real_copy((int)m, c->first, vectors + 7 * m);   /* S_ii by which it was judged */
}

static void write_innovations(double *y, npy_intp n, npy_intp m, const double *z, const double *H, const double *x) {
    for (npy_intp i = 0; i < m; i++) {
        double predicted = 0;
        for (npy_intp k = 0; k < n; k++) predicted += H[i * n + k] * x[k];
        y[i] = z[i] == z[i] ? z[i] - predicted : 0;
    }
}
#define RECORD(n, m) (4 + 8 * (m) + (m) * (m) + (m) * (n))

/* What a correction makes: x and P in the shape of before, a record, z with NaN where missing, and what is then known of the
   sensors, NULL where nothing is learnt. */
typedef struct {
    PyObject *x, *P, *record, *z, *memory;
} corrected;

/* Correct a state by a measurement of linear sensors; whether all was ordinary, -1 with an exception. */
static int correct_linear(held *h, const filter_state *now, const sensors *s, PyObject *z, corrected *made) {
    const npy_intp n = now->n, m = s->m;
    correction c;
    double stack[STACK_WORK], *work, *values;
    int outcome;
    made->memory = NULL;
    made->x = hold(h, new_array(now->ndim, n, 1));
    made->P = made->x ? hold(h, new_array(2, n, n)) : NULL;
    made->record = made->P ? hold(h, new_array(1, RECORD(n, m), 0)) : NULL;
    made->z = made->record ? hold(h, new_array(now->ndim, m, 1)) : NULL;
    if (made->z && s->memory) made->memory = hold(h, new_array(2, m, SPREAD_NUMBERS));
    work = made->z && (made->memory || !s->memory) ? work_of(stack, update_work((int)n, (int)m)) : NULL;
    if (!work) return -1;
    values = numbers_of(made->record);
    correction_begin((int)n, (int)m, 1, &c, work);
    outcome = take_measurement(z, m, numbers_of(made->z)) && is_covariance(s->R, m, c.S);
    if (outcome) {
        real_copy((int)n, now->x, numbers_of(made->x));
        real_copy((int)(n * n), now->P, numbers_of(made->P));
        if (made->memory) real_copy((int)(SPREAD_NUMBERS * m), s->memory, numbers_of(made->memory));
        outcome = update((int)n, (int)m, &s->rule, numbers_of(made->z), s->H, s->R, s->M,
                         made->memory ? (spread_memory *)numbers_of(made->memory) : NULL, numbers_of(made->x),
                         numbers_of(made->P), &c, values + 4 + 8 * m, work);
        begin_record(values, n, m, &s->rule, &c);
        write_innovations(values + 4, n, m, numbers_of(made->z), s->H, now->x);
    }
    work_done(stack, work);
    return outcome;
}

static int take_correction(held *h, PyObject *filter, PyObject *z, PyObject *const given[3]) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_dim_z, AT_inv, AT_R, AT_H, AT__memory};
    filter_state now;
    sensors s;
    corrected made;
    PyObject *const *own;
    int outcome = rule_of_filter(h, filter, &s.rule);
    if (outcome <= 0) return outcome;
    own = h->objects + h->count;
    /* The last is for scaling "learnt" alone. */
    if (hold_all(h, filter, names, s.rule.scaling == SCALING_LEARNT ? 8 : 7) < 0) return -1;
    if (!take_filter(own[0], own[1], own[2], &now)) return 0;
    outcome = take_sensors(h, given, own + 3, now.n, &s);
    if (outcome <= 0) return outcome;
    z = as_plain(h, z);
    if (!z) return -1;
    outcome = correct_linear(h, &now, &s, z, &made);
    if (outcome <= 0) return outcome;
    if (!set_state(h, filter, made.x, made.P, AT_x_post, AT_P_post)) return -1;
    if (set_attribute(filter, AT_z, made.z) < 0 || set_attribute(filter, AT__last, made.record) < 0) return -1;
    if (made.memory && set_attribute(filter, AT__memory, made.memory) < 0) return -1;
    for (enum attribute which = AT__y; which <= AT__mahalanobis; which++)
        if (set_attribute(filter, which, Py_None) < 0) return -1;
    return 1;
}

static PyObject *correct_step(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    held h = {.count = 0};
    (void)self;
    if (count != 5) {
        PyErr_SetString(PyExc_TypeError, "correct: expected a filter, z, R, H and M");
        return NULL;
    }
    return answer(&h, take_correction(&h, arguments[0], arguments[1], arguments + 2));
}

/* Correct a state by linear sensors: (rule, x, P, z, H, R, M or None, memory or None); the answer is (x, P, record, memory),
   or None where that is for the definition. */
static PyObject *correct_arrays(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    held h = {.count = 0};
    filter_state now;
    sensors s = {.M = NULL, .memory = NULL};
    corrected made;
    PyObject *found = NULL;
    int outcome;
    (void)self;
    if (count != 8) {
        PyErr_SetString(PyExc_TypeError, "correct_arrays: expected rule, x, P, z, H, R, M and memory");
        return NULL;
    }
    if (!rule_of(given[0], &s.rule) || !is_array(given[1], 1) || !is_array(given[4], 2)) Py_RETURN_NONE;
    now.ndim = 1, now.n = PyArray_DIM((PyArrayObject *)given[1], 0), s.m = PyArray_DIM((PyArrayObject *)given[4], 0);
    if (now.n < 1 || s.m < 1 || now.n > 10000 || s.m > 10000) Py_RETURN_NONE;
    now.x = vector_of(given[1], now.n), now.P = matrix_of(given[2], now.n, now.n);
    s.H = matrix_of(given[4], s.m, now.n), s.R = matrix_of(given[5], s.m, s.m);
    if (!now.x || !now.P || !s.H || !s.R || !is_symmetric(now.P, now.n)) Py_RETURN_NONE;
    if (!take_more(&s, now.n, given[6], given[7])) Py_RETURN_NONE;
    outcome = correct_linear(&h, &now, &s, given[3], &made);
    if (outcome > 0) found = PyTuple_Pack(4, made.x, made.P, made.record, made.memory ? made.memory : Py_None);
    Py_XDECREF(answer(&h, 0));
    if (found || PyErr_Occurred()) return found;
    Py_RETURN_NONE;
}

/* Correct a state at 0 by an innovation: (rule, P, z, y, C, S, R, memory or None), or the Jacobian H in the place of C and
   None in that of S; the answer is (x, P, record, memory), or None where that is for the definition. */
static PyObject *correct_moments(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    held h = {.count = 0};
    correction_rule rule;
    correction c;
    PyObject *x, *P_next, *record, *learnt = Py_None, *found = NULL;
    const double *P, *z, *y, *C, *S = NULL, *R, *H = NULL, *memory = NULL;
    double stack[STACK_WORK], *work, *values;
    int fine;
    (void)self;
    if (count != 8) {
        PyErr_SetString(PyExc_TypeError, "correct_moments: expected rule, P, z, y, C, S, R and memory");
        return NULL;
    }
    const int linear = given[5] == Py_None;
    if (!rule_of(given[0], &rule) || !is_array(given[4], 2)) Py_RETURN_NONE;
    const npy_intp n = PyArray_DIM((PyArrayObject *)given[4], linear), m = PyArray_DIM((PyArrayObject *)given[4], !linear);
    P = matrix_of(given[1], n, n), z = vector_of(given[2], m), y = vector_of(given[3], m);
    C = linear ? matrix_of(given[4], m, n) : matrix_of(given[4], n, m), R = matrix_of(given[6], m, m);
    if (n < 1 || m < 1 || n > 10000 || m > 10000 || !P || !z || !y || !C || !R) Py_RETURN_NONE;
    if (linear) {
        H = C;
    } else {
        S = matrix_of(given[5], m, m);
        if (!S || !is_symmetric(S, m)) Py_RETURN_NONE;
    }
    if (rule.scaling == SCALING_LEARNT) {
        memory = matrix_of(given[7], m, SPREAD_NUMBERS);
        if (!memory || !all_finite(memory, m * SPREAD_NUMBERS)) Py_RETURN_NONE;
    }
    if (!is_symmetric(P, n) || !is_symmetric(R, m) || !all_finite(C, n * m)) Py_RETURN_NONE;
    x = hold(&h, new_array(1, n, 0));
    P_next = x ? hold(&h, new_array(2, n, n)) : NULL;
    record = P_next ? hold(&h, new_array(1, RECORD(n, m), 0)) : NULL;
    if (record && memory) learnt = hold(&h, new_array(2, m, SPREAD_NUMBERS));
    work = record && learnt ? work_of(stack, update_moments_work((int)n, (int)m)) : NULL;
    if (!work) {
        Py_XDECREF(answer(&h, 0));
        return NULL;
    }
    values = numbers_of(record);
    correction_begin((int)n, (int)m, 1, &c, work);
    if (S) {
        for (npy_intp i = 0; i < m; i++)
            for (npy_intp k = 0; k < n; k++) c.C[i * n + k] = C[k * m + i];
        real_copy((int)(m * m), S, c.S);
    }
    real_copy((int)(n * n), P, numbers_of(P_next));
    for (npy_intp k = 0; k < n; k++) numbers_of(x)[k] = 0;
    if (memory) real_copy((int)(SPREAD_NUMBERS * m), memory, numbers_of(learnt));
    fine = update_moments((int)n, (int)m, &rule, z, y, H, R, memory ? (spread_memory *)numbers_of(learnt) : NULL,
                          numbers_of(x), numbers_of(P_next), &c, work);
    if (fine) {
        const double *const shown = work + update_work((int)n, (int)m);
        begin_record(values, n, m, &rule, &c);
        real_copy((int)m, shown + m * m + m * n, values + 4);
        real_copy((int)(m * m + m * n), shown, values + 4 + 8 * m);
    }
    work_done(stack, work);
    if (fine) found = PyTuple_Pack(4, x, P_next, record, learnt);
    Py_XDECREF(answer(&h, 0));
    if (fine || PyErr_Occurred()) return found;
    Py_RETURN_NONE;
}

PyMethodDef online_functions[] = {
    {"predict", (PyCFunction)(void (*)(void))predict_step, METH_FASTCALL, "Predict a filter's next state: (filter, u)."},
    {"correct", (PyCFunction)(void (*)(void))correct_step, METH_FASTCALL,
     "Correct a filter's state: (filter, z, R, H, M), None for its own R and H and for no M."},
    {"correct_arrays", (PyCFunction)(void (*)(void))correct_arrays, METH_FASTCALL,
     "Correct a state by linear sensors; see robust_filterpy.kernel.moments."},
    {"correct_moments", (PyCFunction)(void (*)(void))correct_moments, METH_FASTCALL,
     "Correct a state at 0 by an innovation of known moments; see robust_filterpy.kernel.moments."},
    {NULL, NULL, 0, NULL}};

/* What the steps of one filter share, whatever judges its measurements: attributes read, checked and set. */
#ifndef ROBUST_FILTERPY_ONLINE_H
#define ROBUST_FILTERPY_ONLINE_H

#include "glue.h"

/* x, (n,) or (n, 1), and P, symmetric. */
typedef struct {
    const double *x, *P;
    npy_intp n;
    int ndim; /* of x */
} filter_state;

/* What judges a filter's measurements: psi, or a mixture of what their noise may have been. */
typedef struct {
    int mixes;
    correction_rule bounded;
    learnt_rule mixture;
    PyObject *make, *named; /* under a mixture: the class of a record, and the last entry of one */
} judge;

/* Sensors by their places in z, or, of an H that is passed, by its rows: robust_filterpy.filters.states in C. */
#define ROWS_MOST 32 /* rows that are remembered */
#define ROWS_NOW 16  /* sensors at once */
typedef struct {
    npy_intp m, width;           /* m: 0 where places tell */
    npy_intp place[ROWS_NOW];
    PyObject *key[ROWS_NOW];     /* bytes of its row, NULL where the place tells */
    PyObject *places, *rows;     /* memories: an array, a dictionary */
    const double *begin;         /* (width) memory of a new sensor; NULL: zeros */
} sensor_rows;

/* What a measurement is taken up by, checked. */
typedef struct {
    npy_intp m;
    const double *H, *R, *M; /* M may be NULL */
    PyObject *memory;        /* of these sensors, as the filter has it or read by rows; NULL where nothing is learned */
    const double *learned;   /* its numbers, where it is bounded by psi */
    sensor_rows rows;        /* width and begin are given, width 0 where nothing is learned by rows */
} sensors;

/* What moves a state. */
typedef struct {
    const double *F, *Q;
    PyObject *B;
    double alpha_sq;
} motion;

/* Python code may run where an attribute is read (a property of a subclass), and may do anything to arrays. So all that a
   step needs is read first, and looked into only then. */
static int hold_all(held *h, PyObject *filter, const enum attribute *which, int count) {
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

/* 1, 0 if the kernel does not know it, or -1 with an exception. */
static int take_judge(held *h, PyObject *filter, judge *by) {
    PyObject *const policy = hold_attribute(h, filter, AT__policy), *rule, *of[2];
    rule = policy ? hold_attribute(h, policy, AT_rule) : NULL;
    if (!rule) return -1;
    by->mixes = !PyTuple_Check(rule);
    if (by->mixes) {
        PyObject *const record = hold_attribute(h, policy, AT_record);
        if (!record || !take_objects(record, 2, of)) return record ? 0 : -1;
        by->make = of[0], by->named = of[1];
        return take_rule(&by->mixture, rule);
    }
    if (!take_objects(rule, 2, of) || !rule_of(of[0], &by->bounded)) return 0;
    if (of[1] != Py_None) by->bounded.psi = (psi_function){PSI_CALLED, 0, 0, 0, call_choices, of[1]};
    return 1;
}

/* A whole number from 1 to 10000, or 0: also of the square of such a size there is an int. */
static npy_intp whole_number(PyObject *object) {
    npy_intp found;
    if (!PyLong_CheckExact(object)) return 0;
    found = PyLong_AsSsize_t(object);
    if (found == -1 && PyErr_Occurred()) PyErr_Clear();
    return found > 0 && found <= 10000 ? found : 0;
}

/* Whether x and P are a filter's as it should be. */
static int take_filter(PyObject *dim_x, PyObject *x, PyObject *P, filter_state *s) {
    s->n = whole_number(dim_x);
    s->x = vector_of(x, s->n);
    s->P = matrix_of(P, s->n, s->n);
    if (!s->n || !s->x || !s->P || !is_symmetric(s->P, s->n)) return 0;
    s->ndim = PyArray_NDIM((PyArrayObject *)x);
    return 1;
}

/* Set x and P, which array_of made, and their copies; return whether that went well. */
static int set_state(held *h, PyObject *filter, PyObject *x, PyObject *P, enum attribute x_too, enum attribute P_too) {
    const npy_intp n = PyArray_DIM((PyArrayObject *)P, 0);
    PyObject *const x_copy = array_of(h, numbers_of(x), PyArray_NDIM((PyArrayObject *)x), n, 1, 0);
    PyObject *const P_copy = array_of(h, numbers_of(P), 2, n, n, 0);
    return !h->failed && set_attribute(filter, AT_x, x) == 0 && set_attribute(filter, AT_P, P) == 0 &&
           set_attribute(filter, x_too, x_copy) == 0 && set_attribute(filter, P_too, P_copy) == 0;
}

/* Write B u into control, and let the pointer to it be NULL if there is none; return whether that is all ordinary. */
static int take_control(PyObject *B, PyObject *u, npy_intp n, double **control) {
    npy_intp width;
    double number;
    const int one = number_of(u, &number);
    const double *values = &number, *matrix;
    if (u == Py_None || B == Py_None || (one && number == 0 && number_of(B, &number) && number == 0)) {
        *control = NULL;
        return 1;
    }
    if (!is_array(B, 2)) return 0;
    width = PyArray_DIM((PyArrayObject *)B, 1);
    matrix = matrix_of(B, n, width);
    if (one && number == 0 && matrix) {
        /* Of any number of inputs. */
        *control = NULL;
        return 1;
    }
    if (width != 1 || !one) values = vector_of(u, width);
    if (!matrix || !values) return 0;
    for (npy_intp i = 0; i < n; i++) {
        (*control)[i] = 0;
        for (npy_intp k = 0; k < width; k++) (*control)[i] += matrix[i * width + k] * values[k];
    }
    return 1;
}

/* Plain, own where given is None; NULL with an exception. */
static PyObject *given_or(held *h, PyObject *given, PyObject *own) { return as_plain(h, given == Py_None ? own : given); }

/* Say which sensors the rows of an H are, the ones with such rows; 1, 0, or -1 with an exception. */
static int take_rows(held *h, sensor_rows *c, const double *H, PyObject *own, npy_intp n) {
    const npy_intp m = c->m, rows = is_array(own, 2) ? PyArray_DIM((PyArrayObject *)own, 0) : 0;
    const double *const ours = rows > 0 ? matrix_of(own, rows, n) : NULL;
    const size_t size = (size_t)n * sizeof(double);
    int same = 0;
    if (m > ROWS_NOW || !ours || !PyDict_CheckExact(c->rows) || !is_array(c->places, 2) ||
        !matrix_of(c->places, PyArray_DIM((PyArrayObject *)c->places, 0), c->width))
        return 0;
    for (npy_intp i = 0; i < m; i++) {
        c->place[i] = 0, c->key[i] = NULL;
        while (c->place[i] < rows && memcmp(H + i * n, ours + c->place[i] * n, size)) c->place[i]++;
        for (npy_intp j = 0; j < i; j++) same |= !memcmp(H + i * n, H + j * n, size);
    }
    for (npy_intp i = 0; i < m; i++) {
        if (!same && c->place[i] == rows) {
            c->key[i] = hold(h, PyBytes_FromStringAndSize((const char *)(H + i * n), (Py_ssize_t)size));
            if (!c->key[i]) return -1;
        }
        /* Sensors that see exactly the same are distinguished by their places. */
        if (same || c->key[i]) c->place[i] = i;
    }
    return 1;
}

/* The memory of these sensors: of a row that is met for the first time that of its place. */
static int read_rows(const sensor_rows *c, double *memory) {
    const npy_intp places = PyArray_DIM((PyArrayObject *)c->places, 0), width = c->width;
    for (npy_intp i = 0; i < c->m; i++) {
        PyObject *const row = c->key[i] ? PyDict_GetItemWithError(c->rows, c->key[i]) : NULL;
        const double *from = row ? vector_of(row, width) : NULL;
        if (row && !from) return 0;
        if (!row && c->place[i] < places) from = numbers_of(c->places) + c->place[i] * width;
        if (!from) from = c->begin;
        for (npy_intp k = 0; k < width; k++) memory[i * width + k] = from ? from[k] : 0;
    }
    return 1;
}

/* Whether that went well. */
static int set_rows(held *h, PyObject *filter, const sensor_rows *c, const double *memory) {
    const npy_intp before = PyArray_DIM((PyArrayObject *)c->places, 0), width = c->width;
    npy_intp count = before, at = 0;
    PyObject *places, *rows = c->rows, *first, *none;
    for (npy_intp i = 0; i < c->m; i++) count = c->place[i] < count ? count : c->place[i] + 1;
    places = array_of(h, NULL, 2, count, width, 0);
    if (!places) return 0;
    real_copy((int)(before * width), numbers_of(c->places), numbers_of(places));
    for (npy_intp k = before * width; k < count * width; k++) numbers_of(places)[k] = c->begin ? c->begin[k % width] : 0;
    for (npy_intp i = 0; i < c->m; i++) {
        PyObject *row;
        real_copy((int)width, memory + i * width, numbers_of(places) + c->place[i] * width);
        if (!c->key[i]) continue;
        if (rows == c->rows && !(rows = hold(h, PyDict_Copy(c->rows)))) return 0;
        row = array_of(h, memory + i * width, 1, width, 0, 0);
        if (!row) return 0;
        /* The one that was met longest ago stands first. */
        if (PyDict_Contains(rows, c->key[i]) == 1 && PyDict_DelItem(rows, c->key[i]) < 0) return 0;
        if (PyDict_SetItem(rows, c->key[i], row) < 0) return 0;
    }
    while (rows != c->rows && PyDict_Size(rows) > ROWS_MOST) {
        at = 0;
        if (!PyDict_Next(rows, &at, &first, &none)) return 0;
        Py_INCREF(first);
        if (PyDict_DelItem(rows, hold(h, first)) < 0) return 0;
    }
    return set_attribute(filter, AT__memory, places) == 0 && set_attribute(filter, AT__other_sensors, rows) == 0;
}

/* given: B, F and Q, or None for the filter's; own: its F, alpha_sq and B, NULL where it has none. 1, 0, or -1 with an
   exception. */
static int take_motion(held *h, PyObject *const given[3], PyObject *own_Q, PyObject *const *own, npy_intp n, motion *found) {
    PyObject *const F = given_or(h, given[1], own ? own[0] : Py_None), *const Q = F ? given_or(h, given[2], own_Q) : NULL;
    found->B = Q ? given_or(h, given[0], own ? own[2] : Py_None) : NULL;
    if (!found->B) return -1;
    found->F = matrix_of(F, n, n), found->Q = covariance_of(h, Q, n), found->alpha_sq = 1;
    if (!found->Q) return PyErr_Occurred() ? -1 : 0;
    if (!found->F || (own && !number_of(own[1], &found->alpha_sq)) || !is_symmetric(found->Q, n)) return 0;
    for (npy_intp i = 0; i < n; i++)
        if (!(found->Q[i * n + i] >= 0)) return 0;
    return 1;
}

/* Write a measurement into z, NaN where missing; return whether it is an ordinary one with something in it. */
static int take_measurement(PyObject *object, npy_intp m, double *z) {
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

/* Write z, and z less its prediction or, where that is None, the innovation; given: these three. Whether all is
   ordinary. */
static int take_difference(PyObject *const given[3], npy_intp m, double *z, double *y) {
    const int subtracts = given[1] != Py_None;
    double single;
    const double *at;
    if (!take_measurement(given[0], m, z)) return 0;
    if (subtracts && m == 1 && number_of(given[1], &single)) at = &single;
    else at = vector_of(given[subtracts ? 1 : 2], m);
    if (!at || (subtracts && !all_finite(at, m))) return 0;
    for (npy_intp i = 0; i < m; i++) y[i] = subtracts ? z[i] - at[i] : at[i];
    return 1;
}

/* M, or None; whether it is that. */
static int take_cross(sensors *s, npy_intp n, PyObject *M) {
    s->M = M == Py_None ? NULL : matrix_of(M, n, s->m);
    return M == Py_None || (s->M && all_finite(s->M, n * s->m));
}

/* What psi has learned of the sensors; whether it is that. */
static int take_memory(const correction_rule *rule, sensors *s, PyObject *memory) {
    s->learned = rule->scaling == SCALING_LEARNT ? matrix_of(memory, s->m, SPREAD_NUMBERS) : NULL;
    return rule->scaling != SCALING_LEARNT || (s->learned && all_finite(s->learned, s->m * SPREAD_NUMBERS));
}

/* given: R, H and M, or None for the filter's and for none; own: dim_z, inv, R, H, memory, other sensors, the last two where
   something is learned. 1, 0, or -1 with an exception. */
static int take_sensors(held *h, PyObject *const given[3], PyObject *const *own, npy_intp n, sensors *s) {
    PyObject *const R = given_or(h, given[0], own[2]);
    PyObject *const H = R ? given_or(h, given[1], own[3]) : NULL;
    sensor_rows *const rows = &s->rows;
    int outcome;
    if (!H) return -1;
    if (own[1] != numpy_inverse || !is_array(H, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)H, 0);
    if (s->m < 1 || s->m > 10000 || (given[1] == Py_None && s->m != whole_number(own[0]))) return 0;
    s->H = matrix_of(H, s->m, n);
    s->R = covariance_of(h, R, s->m);
    if (!s->R && PyErr_Occurred()) return -1;
    if (!s->H || !s->R || !take_cross(s, n, given[2])) return 0;
    rows->m = 0;
    if (rows->width == 0 || H == own[3]) return 1;
    rows->m = s->m, rows->places = own[4], rows->rows = own[5];
    outcome = take_rows(h, rows, s->H, own[3], n);
    if (outcome <= 0) return outcome;
    s->memory = array_of(h, NULL, 2, s->m, rows->width, 0);
    if (!s->memory) return -1;
    return read_rows(rows, numbers_of(s->memory)) ? 1 : PyErr_Occurred() ? -1 : 0;
}

/* Give a filter what a measurement has left of it but x and P; memory: NULL where nothing is learned. 1, or -1. */
static int set_measured(held *h, PyObject *filter, PyObject *z, PyObject *record, const sensor_rows *rows, PyObject *memory) {
    if (set_attribute(filter, AT_z, z) < 0 || set_attribute(filter, AT__last, record) < 0) return -1;
    if (memory && !(rows && rows->m ? set_rows(h, filter, rows, numbers_of(memory))
                                    : set_attribute(filter, AT__memory, memory) == 0))
        return -1;
    for (enum attribute which = AT__y; which <= AT__mahalanobis; which++)
        if (set_attribute(filter, which, Py_None) < 0) return -1;
    return 1;
}

/* A function of the module for one step of a filter: call it with h and arguments, if there are so many. */
#define STEP(name, wanted, call, expected) \
    static PyObject *name(PyObject *self, PyObject *const *arguments, Py_ssize_t count) { \
        held h = {.count = 0}; \
        (void)self; \
        if (count == (wanted)) return answer(&h, call); \
        PyErr_SetString(PyExc_TypeError, expected); \
        return NULL; \
    }

#endif

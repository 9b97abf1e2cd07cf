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
    int mixes, learns;
    correction_rule bounded;
    learnt_rule mixture;
    npy_intp width;      /* numbers that are learned of a sensor, */
    const double *begin; /* and what they are at first; NULL: zeros */
} judge;

/* What a measurement is taken up by, checked, and whose readings it has: sensors by their places in z, or, of an H that is
   passed, by its rows: robust_filterpy.filters.states in C. */
#define ROWS_MOST 32 /* rows that are remembered */
#define ROWS_NOW 16  /* sensors at once */
typedef struct {
    npy_intp m, memories;    /* memories: rows of what is learned */
    const double *H, *R, *M; /* M may be NULL */
    PyObject *memory;        /* of these sensors, as the filter has it or read by rows */
    const double *learned;   /* its numbers; NULL where nothing is */
    int by_rows;             /* 0 where places tell; else */
    npy_intp place[ROWS_NOW];
    PyObject *key[ROWS_NOW]; /* bytes of its row, NULL where the place tells */
    PyObject *places, *rows; /* memories: an array, a dictionary */
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
    PyObject *const policy = hold_attribute(h, filter, AT__policy), *rule, *psi;
    rule = policy ? hold_attribute(h, policy, AT_rule) : NULL;
    if (!rule) return -1;
    by->mixes = !PyTuple_Check(rule);
    if (by->mixes) {
        if (!take_rule(&by->mixture, rule)) return 0;
        by->learns = by->mixture.learns, by->width = learnt_width(by->mixture.K), by->begin = by->mixture.begin;
        return 1;
    }
    if (PyTuple_Size(rule) != 2 || !rule_of(PyTuple_GetItem(rule, 0), &by->bounded)) return 0;
    psi = PyTuple_GetItem(rule, 1);
    if (psi != Py_None) by->bounded.psi = (psi_function){PSI_CALLED, 0, 0, 0, call_choices, psi};
    by->learns = by->bounded.scaling == SCALING_LEARNT, by->width = SPREAD_NUMBERS, by->begin = NULL;
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

/* Say which sensors the rows of an H are, the ones with such rows, and read their memory: of a row that is met for the
   first time that of its place. 1, 0, or -1 with an exception. */
static int take_rows(held *h, const judge *by, sensors *s, PyObject *own, npy_intp n) {
    const npy_intp m = s->m, rows = is_array(own, 2) ? PyArray_DIM((PyArrayObject *)own, 0) : 0, width = by->width;
    const npy_intp places = is_array(s->places, 2) ? PyArray_DIM((PyArrayObject *)s->places, 0) : 0;
    const double *const ours = rows > 0 ? matrix_of(own, rows, n) : NULL;
    const double *const learned = matrix_of(s->places, places, width);
    const size_t size = (size_t)n * sizeof(double);
    int same = 0;
    if (m > ROWS_NOW || !ours || !PyDict_CheckExact(s->rows) || !learned) return 0;
    for (npy_intp i = 0; i < m; i++) {
        s->place[i] = 0, s->key[i] = NULL;
        while (s->place[i] < rows && memcmp(s->H + i * n, ours + s->place[i] * n, size)) s->place[i]++;
        for (npy_intp j = 0; j < i; j++) same |= !memcmp(s->H + i * n, s->H + j * n, size);
    }
    s->by_rows = 1, s->memory = array_of(h, NULL, 2, m, width, 0);
    for (npy_intp i = 0; i < m; i++) {
        if (!same && s->place[i] == rows)
            s->key[i] = hold(h, PyBytes_FromStringAndSize((const char *)(s->H + i * n), (Py_ssize_t)size));
        if (h->failed) return -1;
        /* Sensors that see exactly the same are distinguished by their places. */
        if (same || s->key[i]) s->place[i] = i;
        PyObject *const row = s->key[i] ? PyDict_GetItemWithError(s->rows, s->key[i]) : NULL;
        const double *const from = row                   ? vector_of(row, width)
                                   : s->place[i] < places ? learned + s->place[i] * width
                                                          : by->begin;
        if ((row && !from) || PyErr_Occurred()) return PyErr_Occurred() ? -1 : 0;
        for (npy_intp k = 0; k < width; k++) numbers_of(s->memory)[i * width + k] = from ? from[k] : 0;
    }
    return 1;
}

/* Whether that went well. */
static int set_rows(held *h, PyObject *filter, const judge *by, const sensors *s, const double *memory) {
    const npy_intp before = PyArray_DIM((PyArrayObject *)s->places, 0), width = by->width;
    npy_intp count = before, at = 0;
    PyObject *places, *rows = s->rows, *first, *none;
    for (npy_intp i = 0; i < s->m; i++) count = s->place[i] < count ? count : s->place[i] + 1;
    places = array_of(h, NULL, 2, count, width, 0);
    if (!places) return 0;
    real_copy((int)(before * width), numbers_of(s->places), numbers_of(places));
    for (npy_intp k = before * width; k < count * width; k++) numbers_of(places)[k] = by->begin ? by->begin[k % width] : 0;
    for (npy_intp i = 0; i < s->m; i++) {
        PyObject *row;
        real_copy((int)width, memory + i * width, numbers_of(places) + s->place[i] * width);
        if (!s->key[i]) continue;
        if (rows == s->rows && !(rows = hold(h, PyDict_Copy(s->rows)))) return 0;
        row = array_of(h, memory + i * width, 1, width, 0, 0);
        if (!row) return 0;
        /* The one that was met longest ago stands first. */
        if (PyDict_Contains(rows, s->key[i]) == 1 && PyDict_DelItem(rows, s->key[i]) < 0) return 0;
        if (PyDict_SetItem(rows, s->key[i], row) < 0) return 0;
    }
    while (rows != s->rows && PyDict_Size(rows) > ROWS_MOST) {
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

/* What has been learned of the sensors, s->memory, or what is of each at first; whether it is that, -1 with an exception. */
static int take_memory(held *h, const judge *by, sensors *s) {
    s->memories = by->mixes ? memory_rows(&by->mixture, s->m) : s->m, s->learned = NULL;
    if (!by->learns && !by->mixes) return 1;
    if (!by->learns) {
        if (!(s->memory = array_of(h, NULL, 2, s->memories, by->width, 0))) return -1;
        for (npy_intp k = 0; k < s->memories * by->width; k++) numbers_of(s->memory)[k] = by->begin[k % by->width];
    }
    s->learned = matrix_of(s->memory, s->memories, by->width);
    return s->learned && all_finite(s->learned, s->memories * by->width);
}

/* given: R, H and M, or None for the filter's and for none; own: dim_z, inv, R, H, memory, other sensors. 1, 0, or -1 with
   an exception. */
static int take_sensors(held *h, const judge *by, PyObject *const given[3], PyObject *const *own, npy_intp n, sensors *s) {
    PyObject *const R = given_or(h, given[0], own[2]);
    PyObject *const H = R ? given_or(h, given[1], own[3]) : NULL;
    int outcome = 1;
    if (!H) return -1;
    if (own[1] != numpy_inverse || !is_array(H, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)H, 0);
    if (s->m < 1 || s->m > 10000 || (given[1] == Py_None && s->m != whole_number(own[0]))) return 0;
    s->H = matrix_of(H, s->m, n);
    s->R = covariance_of(h, R, s->m);
    if (!s->R && PyErr_Occurred()) return -1;
    if (!s->H || !s->R || !take_cross(s, n, given[2])) return 0;
    s->by_rows = 0, s->memory = s->places = own[4], s->rows = own[5];
    if (by->learns && H != own[3] && !(by->mixes && by->mixture.joint)) outcome = take_rows(h, by, s, own[3], n);
    return outcome > 0 ? take_memory(h, by, s) : outcome;
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

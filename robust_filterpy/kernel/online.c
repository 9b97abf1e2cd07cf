/* One step of one filter as one call: attributes read, the step taken, attributes set. */
#include "online.h"

#include "groups.h"

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
static npy_intp whole_number(PyObject *object) {
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

/* A copy of an array that new_array made, in a third of the time of numpy's. */
static PyObject *copy_of(held *h, PyObject *array) {
    PyArrayObject *const from = (PyArrayObject *)array;
    PyObject *const found = hold(h, PyArray_SimpleNew(PyArray_NDIM(from), PyArray_DIMS(from), NPY_DOUBLE));
    if (found) memcpy(numbers_of(found), PyArray_DATA(from), (size_t)PyArray_NBYTES(from));
    return found;
}

/* Set x and P, which new_array made, and their copies; return whether that went well. */
int set_state(held *h, PyObject *filter, PyObject *x, PyObject *P, enum attribute x_too, enum attribute P_too) {
    PyObject *const x_copy = copy_of(h, x);
    PyObject *const P_copy = x_copy ? copy_of(h, P) : NULL;
    return P_copy && set_attribute(filter, AT_x, x) == 0 && set_attribute(filter, AT_P, P) == 0 &&
           set_attribute(filter, x_too, x_copy) == 0 && set_attribute(filter, P_too, P_copy) == 0;
}

/* Write B u into control, and let the pointer to it be NULL if there is none; return whether that is all ordinary. */
int take_control(PyObject *B, PyObject *u, npy_intp n, double **control) {
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

/* Plain; own where given is None; NULL with an exception. */
static PyObject *given_or(held *h, PyObject *given, PyObject *own) { return as_plain(h, given == Py_None ? own : given); }

/* Say which sensors the rows of an H are; 1, 0, or -1 with an exception. */
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
        /* Sensors that see exactly the same are told apart by their places. */
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
    places = hold(h, new_array(2, count, width));
    if (!places) return 0;
    real_copy((int)(before * width), numbers_of(c->places), numbers_of(places));
    for (npy_intp k = before * width; k < count * width; k++) numbers_of(places)[k] = c->begin ? c->begin[k % width] : 0;
    for (npy_intp i = 0; i < c->m; i++) {
        PyObject *row;
        real_copy((int)width, memory + i * width, numbers_of(places) + c->place[i] * width);
        if (!c->key[i]) continue;
        if (rows == c->rows && !(rows = hold(h, PyDict_Copy(c->rows)))) return 0;
        row = hold(h, new_array(1, width, 0));
        if (!row) return 0;
        real_copy((int)width, memory + i * width, numbers_of(row));
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

int take_motion(held *h, PyObject *const given[3], PyObject *const own[4], npy_intp n, motion *found) {
    PyObject *const F = given_or(h, given[1], own[0]), *const Q = F ? given_or(h, given[2], own[1]) : NULL;
    found->B = Q ? given_or(h, given[0], own[3]) : NULL;
    if (!found->B) return -1;
    found->F = matrix_of(F, n, n), found->Q = covariance_of(h, Q, n);
    if (!found->Q) return PyErr_Occurred() ? -1 : 0;
    if (!found->F || !number_of(own[2], &found->alpha_sq) || !is_symmetric(found->Q, n)) return 0;
    for (npy_intp i = 0; i < n; i++)
        if (!(found->Q[i * n + i] >= 0)) return 0;
    return 1;
}

/* given: B, F and Q for this call, or None; moves: whether x does too. */
static int take_prediction(held *h, PyObject *filter, PyObject *u, PyObject *const *given, int moves) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_F, AT_Q, AT__alpha_sq, AT_B};
    PyObject *const *const own = h->objects;
    filter_state now;
    motion how;
    PyObject *x_next, *P_next;
    double stack[STACK_WORK], *work, *control;
    int fine;
    if (hold_all(h, filter, names, sizeof names / sizeof *names) < 0) return -1;
    if (!take_filter(own[0], own[1], own[2], &now)) return 0;
    fine = take_motion(h, given, own + 3, now.n, &how);
    if (fine <= 0) return fine;
    x_next = hold(h, new_array(now.ndim, now.n, 1));
    P_next = x_next ? hold(h, new_array(2, now.n, now.n)) : NULL;
    work = P_next ? work_of(stack, predict_work((int)now.n) + (size_t)now.n) : NULL;
    if (!work) return -1;
    control = work;
    fine = take_control(how.B, u, now.n, &control) &&
           predict((int)now.n, now.x, now.P, how.F, how.Q, control, how.alpha_sq, numbers_of(x_next), numbers_of(P_next),
                   work + now.n);
    work_done(stack, work);
    if (!fine) return 0;
    if (!moves) real_copy((int)now.n, now.x, numbers_of(x_next));
    return set_state(h, filter, x_next, P_next, AT_x_prior, AT_P_prior) ? 1 : -1;
}

STEP(predict_step, 5, take_prediction(&h, arguments[0], arguments[1], arguments + 2, 1),
     "predict: expected a filter, u, B, F and Q")

static PyObject *covariance_step(PyObject *self, PyObject *filter) {
    PyObject *const none[3] = {Py_None, Py_None, Py_None};
    held h = {.count = 0};
    (void)self;
    return answer(&h, take_prediction(&h, filter, Py_None, none, 0));
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

int take_difference(PyObject *const given[3], npy_intp m, double *z, double *y) {
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

/* Take M, or None; whether it is that. */
static int take_cross(sensors *s, npy_intp n, PyObject *M) {
    s->M = M == Py_None ? NULL : matrix_of(M, n, s->m);
    return M == Py_None || (s->M && all_finite(s->M, n * s->m));
}

/* Take the memory of sensors that are bounded by psi and learn; whether it is that. */
static int take_memory(sensors *s, PyObject *memory) {
    s->learned = s->rule.scaling == SCALING_LEARNT ? matrix_of(memory, s->m, SPREAD_NUMBERS) : NULL;
    return s->rule.scaling != SCALING_LEARNT || (s->learned && all_finite(s->learned, s->m * SPREAD_NUMBERS));
}

int take_sensors(held *h, PyObject *const given[3], PyObject *const *own, npy_intp n, sensors *s) {
    PyObject *const R = given_or(h, given[0], own[2]), *const H = R ? given_or(h, given[1], own[3]) : NULL;
    sensor_rows *const rows = &s->rows;
    int outcome;
    if (!H) return -1;
    if (own[1] != numpy_inverse || !is_array(H, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)H, 0);
    if (s->m < 1 || s->m > 10000 || (given[1] == Py_None && s->m != whole_number(own[0]))) return 0;
    s->H = matrix_of(H, s->m, n), s->R = covariance_of(h, R, s->m);
    if (!s->R && PyErr_Occurred()) return -1;
    if (!s->H || !s->R || !take_cross(s, n, given[2])) return 0;
    rows->m = 0;
    if (rows->width == 0 || H == own[3]) return 1;
    rows->m = s->m, rows->places = own[4], rows->rows = own[5];
    outcome = take_rows(h, rows, s->H, own[3], n);
    if (outcome <= 0) return outcome;
    s->memory = hold(h, new_array(2, s->m, rows->width));
    if (!s->memory) return -1;
    return read_rows(rows, numbers_of(s->memory)) ? 1 : PyErr_Occurred() ? -1 : 0;
}

/* What a correction leaves: see robust_filterpy.kernel.moments, which reads it. Numbers, rows of m numbers, S and C'. */
enum record_number { RECORD_N, RECORD_M, RECORD_SCALING, RECORD_LOG_DENSITY, RECORD_HEAD };
enum record_row { ROW_Y, ROW_E, ROW_WEIGHTS, ROW_PSI_DERIV, ROW_D, ROW_SCORE, ROW_ORDER, ROW_JUDGED, RECORD_ROWS };

static double *record_row(double *record, enum record_row which, npy_intp m) { return record + RECORD_HEAD + which * m; }

/* All but the innovations, S and C. */
static void begin_record(double *record, npy_intp n, npy_intp m, const correction_rule *rule, const correction *c) {
    record[RECORD_N] = (double)n;
    record[RECORD_M] = (double)m;
    record[RECORD_SCALING] = (double)rule->scaling;
    record[RECORD_LOG_DENSITY] = correction_log_likelihood(rule, c);
    real_copy((int)(4 * m), c->e, record_row(record, ROW_E, m));     /* e, weights, slopes, d */
    real_copy((int)(2 * m), c->v, record_row(record, ROW_SCORE, m)); /* v, order */
    for (npy_intp i = c->observed; i < m; i++) record_row(record, ROW_ORDER, m)[i] = 0; /* no place for what is missing */
    real_copy((int)m, c->first, record_row(record, ROW_JUDGED, m));  /* S_ii by which it was judged */
}

static void write_innovations(double *y, npy_intp n, npy_intp m, const double *z, const double *H, const double *x) {
    for (npy_intp i = 0; i < m; i++) {
        y[i] = z[i] == z[i] ? z[i] - real_dot((int)n, H + i * n, x) : 0;
    }
}

/* What a correction makes: x and P in the shape of before, a record, z with NaN where missing, and the memory of the
   sensors, NULL where nothing is learned. */
typedef struct {
    PyObject *x, *P, *record, *z, *memory;
} corrected;

/* Make room for all that; -1 with an exception. */
static int begin_corrected(held *h, const filter_state *now, const sensors *s, corrected *made) {
    const npy_intp n = now->n, m = s->m;
    made->memory = NULL;
    made->x = hold(h, new_array(now->ndim, n, 1));
    made->P = made->x ? hold(h, new_array(2, n, n)) : NULL;
    made->record = made->P ? hold(h, new_array(1, RECORD_HEAD + (RECORD_ROWS + m + n) * m, 0)) : NULL;
    made->z = made->record ? hold(h, new_array(now->ndim, m, 1)) : NULL;
    if (made->z && s->learned) made->memory = hold(h, new_array(2, m, SPREAD_NUMBERS));
    if (!made->z || (s->learned && !made->memory)) return -1;
    real_copy((int)(n * n), now->P, numbers_of(made->P));
    if (made->memory) real_copy((int)(SPREAD_NUMBERS * m), s->learned, numbers_of(made->memory));
    return 1;
}

static spread_memory *spreads_of(const corrected *made) {
    return made->memory ? (spread_memory *)numbers_of(made->memory) : NULL;
}

/* Correct a state by a measurement of linear sensors; whether all was ordinary, -1 with an exception. */
static int correct_linear(held *h, const filter_state *now, const sensors *s, PyObject *z, corrected *made) {
    const npy_intp n = now->n, m = s->m;
    correction c;
    double stack[STACK_WORK], *work, *values;
    int outcome = begin_corrected(h, now, s, made);
    work = outcome > 0 ? work_of(stack, update_work((int)n, (int)m)) : NULL;
    if (!work) return -1;
    values = numbers_of(made->record);
    correction_begin((int)n, (int)m, 1, &c, work);
    outcome = take_measurement(z, m, numbers_of(made->z)) && is_covariance(s->R, m, c.S);
    if (outcome) {
        real_copy((int)n, now->x, numbers_of(made->x));
        outcome = update((int)n, (int)m, &s->rule, numbers_of(made->z), numbers_of(made->z), s->H, s->R, s->M, spreads_of(made),
                         numbers_of(made->x), numbers_of(made->P), &c, record_row(values, RECORD_ROWS, m), work);
        begin_record(values, n, m, &s->rule, &c);
        write_innovations(record_row(values, ROW_Y, m), n, m, numbers_of(made->z), s->H, now->x);
    }
    work_done(stack, work);
    return outcome;
}

/* An innovation, NaN where missing, and what it has to do with the state: C (n, m) and S, or both follow from H. */
typedef struct {
    const double *y, *C, *S;
} moments_given;

/* The Jacobian of sensors (m, n) and None, or C (n, m) and S; whether they are that. */
static int take_moments(sensors *s, moments_given *given, PyObject *C, PyObject *S, npy_intp n) {
    const int linear = S == Py_None;
    s->H = s->M = given->S = NULL;
    if (!is_array(C, 2)) return 0;
    s->m = PyArray_DIM((PyArrayObject *)C, !linear);
    if (s->m < 1 || s->m > 10000) return 0;
    given->C = linear ? matrix_of(C, s->m, n) : matrix_of(C, n, s->m);
    if (!given->C || !all_finite(given->C, n * s->m)) return 0;
    if (linear) {
        s->H = given->C;
        return 1;
    }
    given->S = matrix_of(S, s->m, s->m);
    return given->S && is_symmetric(given->S, s->m);
}

/* Correct a state by an innovation and the readings in made->z; whether all was ordinary, -1 with an exception. */
static int correct_innovation(const filter_state *now, const sensors *s, const moments_given *given, corrected *made) {
    const npy_intp n = now->n, m = s->m;
    correction c;
    double stack[STACK_WORK], *work, *const values = numbers_of(made->record), *const x = numbers_of(made->x);
    int fine;
    work = work_of(stack, update_work((int)n, (int)m));
    if (!work) return -1;
    correction_begin((int)n, (int)m, 1, &c, work);
    if (given->S) {
        for (npy_intp i = 0; i < m; i++)
            for (npy_intp k = 0; k < n; k++) c.C[i * n + k] = given->C[k * m + i];
        real_copy((int)(m * m), given->S, c.S);
    }
    for (npy_intp k = 0; k < n; k++) x[k] = 0;
    fine = 0;
    for (npy_intp i = 0; i < m; i++) {
        record_row(values, ROW_Y, m)[i] = given->y[i] == given->y[i] ? given->y[i] : 0;
        fine |= given->y[i] == given->y[i];
    }
    fine = fine && update((int)n, (int)m, &s->rule, numbers_of(made->z), given->y, s->H, s->R, NULL, spreads_of(made), x,
                          numbers_of(made->P), &c, record_row(values, RECORD_ROWS, m), work);
    if (fine) {
        begin_record(values, n, m, &s->rule, &c);
        for (npy_intp k = 0; now->x && k < n; k++) x[k] = now->x[k] + x[k];
        fine = all_finite(x, n);
    }
    work_done(stack, work);
    return fine;
}

int set_measured(held *h, PyObject *filter, PyObject *z, PyObject *record, const sensor_rows *rows, PyObject *memory) {
    if (set_attribute(filter, AT_z, z) < 0 || set_attribute(filter, AT__last, record) < 0) return -1;
    if (memory && !(rows && rows->m ? set_rows(h, filter, rows, numbers_of(memory))
                                    : set_attribute(filter, AT__memory, memory) == 0))
        return -1;
    for (enum attribute which = AT__y; which <= AT__mahalanobis; which++)
        if (set_attribute(filter, which, Py_None) < 0) return -1;
    return 1;
}

/* Give a filter what a correction made; 1, or -1 with an exception. */
static int set_corrected(held *h, PyObject *filter, const corrected *made, const sensor_rows *rows) {
    if (!set_state(h, filter, made->x, made->P, AT_x_post, AT_P_post)) return -1;
    return set_measured(h, filter, made->z, made->record, rows, made->memory);
}

/* Whether a sensor's far reading repeats for the first time: that is said, which may refuse the call, so that it is the
   definition's. */
static int is_to_be_said(const sensors *s, const corrected *made) {
    for (npy_intp i = 0; made->memory && i < s->m; i++)
        if (spreads_of(made)[i].filled > ((const spread_memory *)s->learned)[i].filled &&
            ((const spread_memory *)s->learned)[i].filled == 0) return 1;
    return 0;
}

static int take_correction(held *h, PyObject *filter, PyObject *z, PyObject *const given[3]) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_dim_z, AT_inv, AT_R, AT_H, AT__memory,
                                           AT__other_sensors};
    filter_state now;
    sensors s;
    corrected made;
    PyObject *const *own;
    int outcome = rule_of_filter(h, filter, &s.rule);
    if (outcome <= 0) return outcome;
    own = h->objects + h->count;
    /* The last are for scaling "learnt" alone. */
    const int learns = s.rule.scaling == SCALING_LEARNT;
    if (hold_all(h, filter, names, learns ? 9 : 7) < 0) return -1;
    if (!take_filter(own[0], own[1], own[2], &now)) return 0;
    s.memory = learns ? own[7] : NULL, s.rows = (sensor_rows){.width = learns ? SPREAD_NUMBERS : 0};
    outcome = take_sensors(h, given, own + 3, now.n, &s);
    if (outcome <= 0) return outcome;
    if (!take_memory(&s, s.memory)) return 0;
    z = as_plain(h, z);
    if (!z) return -1;
    outcome = called_outcome(correct_linear(h, &now, &s, z, &made));
    if (outcome > 0 && is_to_be_said(&s, &made)) return 0;
    return outcome > 0 ? set_corrected(h, filter, &made, &s.rows) : outcome;
}

STEP(correct_step, 5, take_correction(&h, arguments[0], arguments[1], arguments + 2),
     "correct: expected a filter, z, R, H and M")

/* given: z, the prediction of z or None, the innovation or None, C, S, R. */
static int take_innovation(held *h, PyObject *filter, PyObject *const given[6]) {
    static const enum attribute names[] = {AT_dim_x, AT_x, AT_P, AT_inv, AT_R, AT__memory};
    filter_state now;
    sensors s;
    moments_given innovation;
    corrected made;
    PyObject *const *own, *plain[6], *room;
    int outcome = rule_of_filter(h, filter, &s.rule);
    if (outcome <= 0) return outcome;
    own = h->objects + h->count;
    if (hold_all(h, filter, names, s.rule.scaling == SCALING_LEARNT ? 6 : 5) < 0) return -1;
    for (int i = 0; i < 6; i++)
        if (!(plain[i] = as_plain(h, i == 5 && given[5] == Py_None ? own[4] : given[i]))) return -1;
    if (own[3] != numpy_inverse || !take_filter(own[0], own[1], own[2], &now)) return 0;
    if (!take_moments(&s, &innovation, plain[3], plain[4], now.n) || !take_memory(&s, own[5])) return 0;
    s.R = covariance_of(h, plain[5], s.m);
    if (!s.R) return PyErr_Occurred() ? -1 : 0;
    if (begin_corrected(h, &now, &s, &made) < 0 || !(room = hold(h, new_array(2, s.m, s.m)))) return -1;
    if (!is_covariance(s.R, s.m, numbers_of(room))) return 0;
    innovation.y = numbers_of(room);
    if (!take_difference(plain, s.m, numbers_of(made.z), numbers_of(room))) return 0;
    outcome = called_outcome(correct_innovation(&now, &s, &innovation, &made));
    if (outcome > 0 && is_to_be_said(&s, &made)) return 0;
    return outcome > 0 ? set_corrected(h, filter, &made, NULL) : outcome;
}

STEP(innovation_step, 7, take_innovation(&h, arguments[0], arguments + 1),
     "correct_innovation: expected a filter, z, its prediction, y, C, S and R")

/* What a correction of arrays answers: (x, P, record, memory), or None where it was not for the kernel. */
static PyObject *answer_arrays(held *h, const corrected *made, int outcome) {
    PyObject *found = NULL;
    if (outcome > 0) found = PyTuple_Pack(4, made->x, made->P, made->record, made->memory ? made->memory : Py_None);
    Py_XDECREF(answer(h, 0));
    if (found || PyErr_Occurred()) return found;
    Py_RETURN_NONE;
}

/* Correct a state by linear sensors: (rule, x, P, z, H, R, M or None, memory or None). */
static PyObject *correct_arrays(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    held h = {.count = 0};
    filter_state now;
    sensors s;
    corrected made;
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
    if (!take_cross(&s, now.n, given[6]) || !take_memory(&s, given[7])) Py_RETURN_NONE;
    return answer_arrays(&h, &made, correct_linear(&h, &now, &s, given[3], &made));
}

/* Correct a state at 0 by an innovation: (rule, P, z, y, C, S, R, memory or None), or the Jacobian H in the place of C and
   None in that of S. */
static PyObject *correct_moments(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    held h = {.count = 0};
    filter_state now = {.x = NULL, .ndim = 1};
    sensors s;
    moments_given innovation;
    corrected made;
    const double *z;
    (void)self;
    if (count != 8) {
        PyErr_SetString(PyExc_TypeError, "correct_moments: expected rule, P, z, y, C, S, R and memory");
        return NULL;
    }
    if (!rule_of(given[0], &s.rule) || !is_array(given[1], 2)) Py_RETURN_NONE;
    now.n = PyArray_DIM((PyArrayObject *)given[1], 0), now.P = matrix_of(given[1], now.n, now.n);
    if (now.n < 1 || now.n > 10000 || !now.P || !is_symmetric(now.P, now.n)) Py_RETURN_NONE;
    if (!take_moments(&s, &innovation, given[4], given[5], now.n) || !take_memory(&s, given[7]))
        Py_RETURN_NONE;
    s.R = matrix_of(given[6], s.m, s.m), z = vector_of(given[2], s.m), innovation.y = vector_of(given[3], s.m);
    if (!s.R || !z || !innovation.y || !is_symmetric(s.R, s.m)) Py_RETURN_NONE;
    if (begin_corrected(&h, &now, &s, &made) < 0) return answer_arrays(&h, &made, -1);
    real_copy((int)s.m, z, numbers_of(made.z));
    return answer_arrays(&h, &made, correct_innovation(&now, &s, &innovation, &made));
}

/* Whether the numbers of an array lie in one piece. */
static int in_one_piece(PyArrayObject *array) {
    const int one = NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_F_CONTIGUOUS;
    return PyArray_TYPE(array) == NPY_DOUBLE && (PyArray_FLAGS(array) & one) != 0;
}

/* What arrays in one piece hold, one after another: a copy of each as an array of its own takes as long as a step. */
static PyObject *contents_of(PyObject *arrays) {
    const Py_ssize_t count = PyList_Size(arrays);
    Py_ssize_t total = 0;
    PyObject *contents;
    char *to;
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *const array = PyList_GetItem(arrays, i);
        if (PyArray_CheckExact(array)) total += PyArray_NBYTES((PyArrayObject *)array);
    }
    contents = PyBytes_FromStringAndSize(NULL, total);
    to = contents ? PyBytes_AsString(contents) : NULL;
    for (Py_ssize_t i = 0; to && i < count; i++) {
        PyArrayObject *const array = (PyArrayObject *)PyList_GetItem(arrays, i);
        if (!PyArray_CheckExact(array)) continue;
        memcpy(to, PyArray_DATA(array), (size_t)PyArray_NBYTES(array));
        to += PyArray_NBYTES(array);
    }
    return contents;
}

/* The writable arrays of a dictionary that nobody else has, and what they hold: see robust_filterpy.filters.snapshot. */
static PyObject *copied_arrays(PyObject *self, PyObject *attributes) {
    PyObject *arrays, *contents, *found, *key, *value;
    Py_ssize_t place = 0;
    (void)self;
    if (!PyDict_CheckExact(attributes)) {
        PyErr_SetString(PyExc_TypeError, "copied_arrays: expected a dictionary");
        return NULL;
    }
    arrays = PyList_New(0);
    while (arrays && PyDict_Next(attributes, &place, &key, &value)) {
        PyObject *copy, *pair;
        int added;
        if (!PyArray_CheckExact(value) || !PyArray_ISWRITEABLE((PyArrayObject *)value)) continue;
        if (in_one_piece((PyArrayObject *)value)) {
            added = PyList_Append(arrays, value);
        } else {
            copy = PyArray_NewCopy((PyArrayObject *)value, NPY_KEEPORDER);
            pair = copy ? PyTuple_Pack(2, value, copy) : NULL;
            added = pair ? PyList_Append(arrays, pair) : -1;
            Py_XDECREF(copy);
            Py_XDECREF(pair);
        }
        if (added < 0) Py_CLEAR(arrays);
    }
    contents = arrays ? contents_of(arrays) : NULL;
    found = contents ? PyTuple_Pack(2, arrays, contents) : NULL;
    Py_XDECREF(arrays);
    Py_XDECREF(contents);
    return found;
}

PyMethodDef online_functions[] = {
    {"predict", (PyCFunction)(void (*)(void))predict_step, METH_FASTCALL, "Predict a filter's next state: (filter, u, B, F, Q), None for its own."},
    {"predict_covariance", covariance_step, METH_O, "Predict a filter's P, and leave x where it is."},
    {"correct", (PyCFunction)(void (*)(void))correct_step, METH_FASTCALL,
     "Correct a filter's state: (filter, z, R, H, M), None for its own R and H and for no M."},
    {"correct_innovation", (PyCFunction)(void (*)(void))innovation_step, METH_FASTCALL,
     "Correct a filter's state by an innovation: (filter, z, its prediction or None, y or None, C, S, R or None); the "
     "Jacobian for C, and then None for S."},
    {"correct_arrays", (PyCFunction)(void (*)(void))correct_arrays, METH_FASTCALL,
     "Correct a state by linear sensors; see robust_filterpy.kernel.moments."},
    {"correct_moments", (PyCFunction)(void (*)(void))correct_moments, METH_FASTCALL,
     "Correct a state at 0 by an innovation of known moments; see robust_filterpy.kernel.moments."},
    {"copied_arrays", copied_arrays, METH_O, "Return the writable arrays of a dictionary, and what they hold."},
    {NULL, NULL, 0, NULL}};

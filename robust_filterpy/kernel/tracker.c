/* Recordings of many actuators through tracker.h, from Python: see robust_filterpy.identification.recursive.track. */
#include "glue.h"

#include "tracker.h"

/* Signals of all actuators; strides in numbers, 0 where an axis is shared. */
typedef struct {
    const double *data;
    npy_intp by_actuator, by_sample;
} signal;

typedef struct {
    tracker_layout layout;
    series_matrices options, F, Q; /* (RULE_NUMBERS), (n, n), (n, n) of each actuator or of all; one step */
    const double *alpha_sq, *windup, *centre;
    const npy_intp *flags; /* (actuators, 5): filtered, guard, cleans, learns, judges */
    npy_intp actuators, samples;
    signal y, u, R;        /* R has no data where none is given */
    double *state[11];     /* the arrays of tracker_state in its order */
    npy_intp sizes[11];
    double *theta, *variance, *prediction, *residual, *weights; /* what is written, (actuators, samples, ..) */
    npy_intp *guard, *done;
} job;

static int is_identity(const int n, const double *F) {
    for (int i = 0; i < n * n; i++)
        if (F[i] != (i % (n + 1) == 0 ? 1.0 : 0.0)) return 0;
    return 1;
}

/* Whether a is finite and, but for rounding, symmetric. */
static int is_settled(const int n, const double *a) {
    double size = 0, apart = 0, total = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            total += fabs(a[i * n + j]);
            size = fmax(size, fabs(a[i * n + j]));
            apart = fmax(apart, fabs(a[i * n + j] - a[j * n + i]));
        }
    return total <= DBL_MAX && apart <= 1e-13 * size;
}

/* Take an actuator through its samples; n is a constant where this is inlined. */
INLINE void one_actuator(const job *const j, const int n, const npy_intp i, double *const work) {
    const npy_intp *const flags = j->flags + 5 * i;
    const double *const F = j->F.data + i * j->F.by_series;
    tracker_rule rule = {.filtered = flags[0] != 0, .guard = (int)flags[1], .cleans = flags[2] != 0,
                         .learns = flags[3] != 0, .judges = flags[4] != 0, .F = is_identity(n, F) ? NULL : F,
                         .Q = j->Q.data + i * j->Q.by_series, .alpha_sq = j->alpha_sq[i], .windup = j->windup[i]};
    double *at[11];
    for (int a = 0; a < 11; a++) at[a] = j->state[a] + i * j->sizes[a];
    const tracker_state state = {at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8],
                                 (tracker_scale *)at[9], (tracker_readings *)at[10]};
    npy_intp k = 0;
    j->done[i] = 0;
    if (!rule_of_numbers(j->options.data + i * j->options.by_series, &rule.correction)) return;
    if (!is_settled(n, state.P) || !is_settled(n, rule.Q)) return;
    for (; k < j->samples; k++) {
        const double y = j->y.data[i * j->y.by_actuator + k * j->y.by_sample] - j->centre[i];
        const double given = j->R.data ? j->R.data[i * j->R.by_actuator + k * j->R.by_sample] : (double)NAN;
        const npy_intp row = i * j->samples + k;
        tracker_sample sample;
        if (!tracker_step(&j->layout, n, &rule, &state, y, j->u.data + i * j->u.by_actuator + k * j->u.by_sample, given,
                          &sample, work))
            break;
        j->prediction[row] = sample.prediction + j->centre[i];
        j->residual[row] = sample.residual;
        j->weights[row] = sample.weight;
        j->guard[row] = sample.guard;
        for (int p = 0; p < n; p++) {
            j->theta[row * n + p] = state.theta[p];
            j->variance[row * n + p] = state.P[p * n + p];
        }
    }
    j->done[i] = k;
}

typedef void span(const job *j, int n, double *work);

static void any_size(const job *const j, const int n, double *const work) {
    for (npy_intp i = 0; i < j->actuators; i++) one_actuator(j, n, i, work);
}

#define SIZE(size) \
    static void size_##size(const job *const j, const int n, double *const work) { \
        (void)n; \
        for (npy_intp i = 0; i < j->actuators; i++) one_actuator(j, size, i, work); \
    }
SIZE(2)

SIZE(4)

SIZE(8)

static span *const spans[] = {any_size, any_size, size_2, any_size, size_4, any_size, any_size, any_size, size_8};

/* An array of float64 of any strides, aligned: (actuators, samples) or (actuators, samples, width). */
static int take_signal(PyObject *object, const job *const j, const npy_intp width, signal *const found) {
    PyArrayObject *const array = (PyArrayObject *)object;
    const int ndim = width < 0 ? 2 : 3;
    if (!is_array(object, ndim) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISBEHAVED_RO(array) ||
        PyArray_DIM(array, 0) != j->actuators || PyArray_DIM(array, 1) != j->samples)
        return 0;
    if (ndim == 3 && (PyArray_DIM(array, 2) != width || (width > 1 && PyArray_STRIDE(array, 2) != sizeof(double)))) return 0;
    if (PyArray_STRIDE(array, 0) % (npy_intp)sizeof(double) || PyArray_STRIDE(array, 1) % (npy_intp)sizeof(double)) return 0;
    found->data = numbers_of(object);
    found->by_actuator = PyArray_STRIDE(array, 0) / (npy_intp)sizeof(double);
    found->by_sample = PyArray_STRIDE(array, 1) / (npy_intp)sizeof(double);
    return 1;
}

#define PLACES 12 /* na nc nd nf, a c d f, inputs, lags, length, starts; then start, used, source */

/* The layout from its integers: ints are written into room (as long). */
static int take_layout(PyObject *object, const int n, const npy_intp width, tracker_layout *const l, int *const room) {
    const npy_intp *const given = integers(object, -1, -1);
    const npy_intp count = given ? PyArray_DIM((PyArrayObject *)object, 0) : 0;
    if (count < PLACES) return 0;
    for (npy_intp i = 0; i < count; i++) {
        if (given[i] < -n - 1 || given[i] > 1000000) return 0;
        room[i] = (int)given[i];
    }
    const tracker_layout found = {room[0], room[1], room[2], room[3], room[4], room[5], room[6], room[7],
                                  room[8], room[9], room[10], room[11], room + PLACES, room + PLACES + room[11],
                                  room + PLACES + 2 * room[11]};
    for (int i = 0; i < PLACES; i++)
        if (room[i] < 0) return 0;
    if (count != PLACES + 2 * (npy_intp)found.starts + found.lags) return 0;
    if (found.a + found.na > n || found.c + found.nc > n || found.d + found.nd > n || found.f + found.nf > n ||
        found.inputs + found.lags > n)
        return 0;
    for (int i = 0; i < found.starts; i++)
        if (found.start[i] < 0 || found.start[i] >= found.length || found.used[i] < -1 || found.used[i] >= width) return 0;
    for (int i = 0; i < found.lags; i++)
        if (found.source[i] < -found.starts || found.source[i] >= found.length) return 0;
    *l = found;
    return 1;
}

static PyObject *track(PyObject *self, PyObject *arguments) {
    PyObject *groups[6], *given[7], *signals[3], *state[11], *out[6], *layout, *y, *u, *R;
    job j = {0};
    double *work = NULL;
    int *room = NULL;
    (void)self;
    if (!take_objects(arguments, 6, groups) || !take_objects(groups[1], 7, given) ||
        !take_objects(groups[2], 3, signals) || !take_objects(groups[3], 11, state) || !take_objects(groups[4], 6, out))
        goto refused;
    layout = groups[0], y = signals[0], u = signals[1], R = signals[2];
    if (!is_array(y, 2) || !is_array(state[0], 2) || !is_array(u, 3) || !is_array(layout, 1)) goto refused;
    j.actuators = PyArray_DIM((PyArrayObject *)y, 0), j.samples = PyArray_DIM((PyArrayObject *)y, 1);
    const npy_intp n = PyArray_DIM((PyArrayObject *)state[0], 1), width = PyArray_DIM((PyArrayObject *)u, 2);
    if (n < 1 || n > 10000) goto refused;
    room = PyMem_Malloc((size_t)(PyArray_DIM((PyArrayObject *)layout, 0) + 1) * sizeof(int));
    work = PyMem_Malloc(tracker_work((int)n) * sizeof(double));
    if (!room || !work) {
        PyErr_NoMemory();
        goto failed;
    }
    if (!take_layout(layout, (int)n, width, &j.layout, room)) goto refused;
    {
        const tracker_layout *const l = &j.layout;
        const npy_intp past = l->na + l->nd, rows = l->nf > l->nd ? l->nf : l->nd;
        const npy_intp shapes[11][3] = {{0, n, 0}, {0, n, n}, {0, past, 0}, {0, past, 0}, {0, l->length, 0},
                                        {0, l->nc, 0}, {0, l->nf, 0}, {0, rows, n}, {0, l->nc, n}, {0, 5, 0},
                                        {0, (npy_intp)(sizeof(tracker_readings) / sizeof(double)), 0}};
        for (int a = 0; a < 11; a++) {
            const npy_intp shape[3] = {j.actuators, shapes[a][1], shapes[a][2]};
            const int ndim = a == 1 || a == 7 || a == 8 ? 3 : 2;
            j.sizes[a] = shape[1] * (ndim == 3 ? shape[2] : 1);
            j.state[a] = writable(state[a], ndim, shape);
            if (!j.state[a]) goto refused;
        }
    }
    {
        const npy_intp wide[3] = {j.actuators, j.samples, n};
        j.alpha_sq = vector_of(given[3], j.actuators), j.windup = vector_of(given[4], j.actuators);
        j.centre = vector_of(given[5], j.actuators), j.flags = integers(given[6], j.actuators, 5);
        j.theta = writable(out[0], 3, wide), j.variance = writable(out[1], 3, wide);
        j.prediction = writable(out[2], 2, wide), j.residual = writable(out[3], 2, wide);
        j.weights = writable(out[4], 2, wide), j.guard = integers(out[5], j.actuators, j.samples);
        j.done = integers(groups[5], j.actuators, -1);
    }
    if (!take_matrices(&j.options, given[0], j.actuators, 1, RULE_NUMBERS, 0) ||
        !take_matrices(&j.F, given[1], j.actuators, 1, n, n) || !take_matrices(&j.Q, given[2], j.actuators, 1, n, n) ||
        !j.alpha_sq || !j.windup || !j.centre || !j.flags || !j.theta || !j.variance || !j.prediction || !j.residual ||
        !j.weights || !j.guard || !j.done || !take_signal(y, &j, -1, &j.y) || !take_signal(u, &j, width, &j.u) ||
        (R != Py_None && !take_signal(R, &j, -1, &j.R)))
        goto refused;
    Py_BEGIN_ALLOW_THREADS;
    spans[n < (npy_intp)(sizeof spans / sizeof *spans) ? n : 0](&j, (int)n, work);
    Py_END_ALLOW_THREADS;
    PyMem_Free(work);
    PyMem_Free(room);
    Py_RETURN_NONE;
refused:
    PyErr_SetString(PyExc_ValueError, "track: expected arrays of matching shapes, as "
                                      "robust_filterpy.identification.recursive.track makes them");
failed:
    PyMem_Free(work);
    PyMem_Free(room);
    return NULL;
}

PyMethodDef tracker_functions[] = {
    {"track", track, METH_VARARGS, "Take recordings through the recursion; see identification.recursive.track."},
    {NULL, NULL, 0, NULL}};

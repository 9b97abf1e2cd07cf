/* Recordings of many actuators through tracker.h, from Python: see robust_filterpy.identification.recursive.track. */
#include "glue.h"

#include "tracker.h"

#define STAYS 5 /* numbers of an actuator that stay: centre, windup and three that the kernel has no use for */

typedef struct {
    tracker_layout layout;
    series_matrices options, F, Q; /* (RULE_NUMBERS), (n, n), (n, n) of each actuator or of all; one step */
    const double *alpha_sq;
    const npy_intp *flags; /* (actuators, 5): filtered, guard, cleans, learns, judges */
    npy_intp actuators, samples;
    series_matrices y, u, R;        /* R has no data where none is given */
    double *moved;         /* (actuators, width): the arrays of tracker_state in its order, then centre and windup */
    npy_intp sizes[11], width;
    double *out;           /* (actuators, samples, 2 n + 4): theta, variances, prediction, residual, weight, guard */
    npy_intp *done;
} job;

static int is_identity(const int n, const double *F) {
    for (int i = 0; i < n * n; i++)
        if (F[i] != (i % (n + 1) == 0 ? 1.0 : 0.0)) return 0;
    return 1;
}

/* Whether a is finite and, but for rounding, symmetric. */
static int is_settled(const int n, const double *a) { return all_finite(a, (npy_intp)n * n) && is_symmetric(a, n); }

/* Take an actuator through its samples; n is a constant where this is inlined. */
INLINE void one_actuator(const job *const j, const int n, const npy_intp i, double *const work) {
    const npy_intp *const flags = j->flags + 5 * i;
    const double *const F = j->F.data + i * j->F.by_series;
    tracker_rule rule = {.filtered = flags[0] != 0, .guard = (int)flags[1], .cleans = flags[2] != 0,
                         .learns = flags[3] != 0, .judges = flags[4] != 0, .F = is_identity(n, F) ? NULL : F,
                         .Q = j->Q.data + i * j->Q.by_series, .alpha_sq = j->alpha_sq[i]};
    double *at[12] = {j->moved + i * j->width};
    for (int a = 0; a < 11; a++) at[a + 1] = at[a] + j->sizes[a];
    const tracker_state state = {at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8],
                                 (tracker_scale *)at[9], (tracker_readings *)at[10]};
    const double centre = at[11][0];
    rule.windup = at[11][1];
    npy_intp k = 0;
    j->done[i] = 0;
    if (!rule_of_numbers(j->options.data + i * j->options.by_series, &rule.correction)) return;
    if (!is_settled(n, state.P) || !is_settled(n, rule.Q)) return;
    for (; k < j->samples; k++) {
        const double y = *series_at(&j->y, i, k) - centre;
        const double given = j->R.data ? *series_at(&j->R, i, k) : (double)NAN;
        double *const row = j->out + (i * j->samples + k) * (2 * n + 4), *const shown = row + 2 * n;
        tracker_sample sample;
        if (!tracker_step(&j->layout, n, &rule, &state, y, series_at(&j->u, i, k), given, &sample, work))
            break;
        shown[0] = sample.prediction + centre;
        shown[1] = sample.residual;
        shown[2] = sample.weight;
        shown[3] = sample.guard;
        for (int p = 0; p < n; p++) {
            row[p] = state.theta[p];
            row[n + p] = state.P[p * n + p];
        }
    }
    j->done[i] = k;
}

/* Take all of them, with sizes that the compiler knows. */
static void every_actuator(const job *const j, const int n, double *const work) {
    for (npy_intp i = 0; i < j->actuators; i++) {
        if (n == 2) one_actuator(j, 2, i, work);
        else if (n == 4) one_actuator(j, 4, i, work);
        else if (n == 8) one_actuator(j, 8, i, work);
        else one_actuator(j, n, i, work);
    }
}

#define PLACES 12 /* na nc nd nf, a c d f, inputs, lags, length, starts; then start, used, source */

/* The layout from its integers. */
static int take_layout(const int *const given, const npy_intp count, const int n, const npy_intp width,
                       tracker_layout *const l) {
    if (count < PLACES) return 0;
    for (npy_intp i = 0; i < count; i++)
        if (given[i] < (i < PLACES ? 0 : -n - 1) || given[i] > 1000000) return 0;
    const int *const start = given + PLACES, *const used = start + given[11];
    const tracker_layout found = {given[0], given[1], given[2], given[3], given[4], given[5], given[6], given[7],
                                  given[8], given[9], given[10], given[11], start, used, used + given[11]};
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

/* How many numbers of an actuator there are of each kind that moves; whether their sum is the width. */
static int take_sizes(job *const j, const npy_intp n) {
    const tracker_layout *const l = &j->layout;
    const npy_intp past = l->na + l->nd, rows = l->nf > l->nd ? l->nf : l->nd;
    const npy_intp sizes[11] = {n, n * n, past, past, l->length, l->nc, l->nf, rows * n, l->nc * n,
                                (npy_intp)(sizeof(tracker_scale) / sizeof(double)),
                                (npy_intp)(sizeof(tracker_readings) / sizeof(double))};
    npy_intp total = STAYS;
    for (int a = 0; a < 11; a++) total += j->sizes[a] = sizes[a];
    return total == j->width;
}

static PyObject *track(PyObject *self, PyObject *arguments) {
    npy_intp lengths[AXES] = UNKNOWN_AXES;
    const int *layout;
    job j = {0};
    (void)self;
    AXIS('o') = 1, AXIS('r') = RULE_NUMBERS, AXIS('f') = 5;
    int fine = take_arrays(arguments, ".ak .aku ?.ak %l .aor .aonn .aonn a #af !aw !akc #!a", lengths,
                           (void *[]){&j.y, &j.u, &j.R, &layout, &j.options, &j.F, &j.Q, &j.alpha_sq, &j.flags, &j.moved,
                                      &j.out, &j.done});
    const npy_intp n = AXIS('n');
    j.actuators = AXIS('a'), j.samples = AXIS('k'), j.width = AXIS('w');
    fine = fine && n >= 1 && n <= 10000 && AXIS('c') == 2 * n + 4 &&
           take_layout(layout, AXIS('l'), (int)n, AXIS('u'), &j.layout) && take_sizes(&j, n);
    if (!fine) return refuse_arrays("track", "identification.recursive.track");
    double *const work = PyMem_Malloc(tracker_work((int)n) * sizeof(double));
    if (!work) return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS;
    every_actuator(&j, (int)n, work);
    Py_END_ALLOW_THREADS;
    PyMem_Free(work);
    Py_RETURN_NONE;
}

PyMethodDef tracker_functions[] = {
    {"track", track, METH_VARARGS, "Take recordings through the recursion; see identification.recursive.track."},
    {NULL, NULL, 0, NULL}};

/* Series and recordings: the loop of series.h, without the interpreter's lock. */
#include "online.h"

/* Sizes of the state that the compiler knows; to know one sensor too gains nothing that can be measured. */
#define SPAN(name, n) \
    static void name(const series_job *job, ptrdiff_t low, ptrdiff_t high, double *work) { \
        if (job->mixes) series_span(n, job->m, 1, job, low, high, work); \
        else series_span(n, job->m, 0, job, low, high, work); \
    }
SPAN(span_any, job->n)
SPAN(span_1, 1) SPAN(span_2, 2) SPAN(span_3, 3) SPAN(span_4, 4)
SPAN(span_5, 5) SPAN(span_6, 6) SPAN(span_7, 7) SPAN(span_8, 8)

static void (*const spans[])(const series_job *, ptrdiff_t, ptrdiff_t, double *) = {
    span_any, span_1, span_2, span_3, span_4, span_5, span_6, span_7, span_8};

/* Take x, P, memory and, under a mixture, x, P and p of the models, of so many series; whether they are that. */
static int take_moving(series_job *job, PyObject *const of[6], npy_intp series) {
    const learnt_rule *const rule = &job->mixture;
    const npy_intp n = job->n, m = job->m, models = job->mixes ? learnt_rows(rule) : 0;
    const npy_intp rows = job->mixes ? memory_rows(rule, m) : m;
    const npy_intp width = job->mixes ? learnt_width(rule->K) : SPREAD_NUMBERS;
    const npy_intp shapes[4][3] = {{rows, width, 1},
                                   {models, n, 1}, {models, n, n}, {job->mixes ? learnt_beliefs(1, rule) : 0, n, 1}};
    job->x = writable(of[0], 2, (npy_intp[]){series, n}), job->P = writable(of[1], 3, (npy_intp[]){series, n, n});
    for (int a = 0; a < (job->mixes ? 4 : 1); a++) {
        const npy_intp shape[4] = {series, shapes[a][0], shapes[a][1], shapes[a][2]};
        if (!job->mixes && job->bounded.scaling != SCALING_LEARNT) continue;
        if (!(job->moving[a] = writable(of[2 + a], a == 2 ? 4 : 3, shape))) return 0;
        job->sizes[a] = (int)(shape[1] * shape[2] * shape[3]);
    }
    for (npy_intp s = 0; job->mixes && s < series; s++) {
        const learnt_state state = {NULL, NULL, job->moving[3] + s * job->sizes[3], NULL};
        if (!learnt_has_parts(job->n, rule, &state)) return 0;
    }
    return job->x && job->P;
}

static PyObject *filter_series(PyObject *self, PyObject *arguments) {
    PyObject *rule, *z, *readings, *matrices, *state, *rooms, *likelihood, *done, *model[6], *moving[6], *out[7];
    Py_ssize_t first, last, low, high, every, width;
    series_job job = {0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOOOOO(nnnndpnin)", &rule, &z, &readings, &matrices, &state, &rooms, &likelihood,
                          &done, &first, &last, &low, &high, &job.alpha_sq, &job.update_first, &every, &job.which, &width))
        return NULL;
    if (!take_objects(matrices, 6, model) || !take_objects(state, 6, moving) || !take_objects(rooms, 7, out) ||
        !is_array(z, 3) || !is_array(moving[0], 2))
        goto refused;
    {
        const npy_intp series = PyArray_DIM((PyArrayObject *)z, 0), all = PyArray_DIM((PyArrayObject *)z, 1);
        const npy_intp m = PyArray_DIM((PyArrayObject *)z, 2), n = PyArray_DIM((PyArrayObject *)moving[0], 1);
        job.mixes = !rule_of(rule, &job.bounded);
        const npy_intp most = job.mixes ? 1000 : 10000;
        if ((job.mixes && !take_rule(&job.mixture, rule)) || n < 1 || m < 1 || n > most || m > most || every < 1 ||
            first < 0 || last < first || last > all || low < 0 || high < low || high > series ||
            (width != 0 && width != n && width != n * n))
            goto refused;
        const npy_intp rows = all / every;
        job.n = (int)n, job.m = (int)m, job.first = first, job.last = last, job.every = every, job.rows = rows;
        job.width = (int)width;
        if (!take_matrices(&job.z, z, series, all, m, 0) || !take_matrices(&job.readings, readings, series, all, m, 0) ||
            !take_matrices(&job.F, model[0], series, all, n, n) || !take_matrices(&job.Q, model[1], series, all, n, n) ||
            !take_matrices(&job.H, model[2], series, all, m, n) || !take_matrices(&job.R, model[3], series, all, m, m) ||
            (model[4] != Py_None && !take_matrices(&job.control, model[4], series, all, n, 0)) ||
            (model[5] != Py_None && !take_matrices(&job.M, model[5], series, all, n, m)) ||
            !take_moving(&job, moving, series) || !(job.log_likelihood = writable(likelihood, 1, &series)) ||
            !take_room(&job.means, out[0], series, rows, n) || !take_room(&job.covariances, out[1], series, rows, width) ||
            !take_room(&job.means_p, out[2], series, rows, n) ||
            !take_room(&job.covariances_p, out[3], series, rows, width) ||
            !take_room(&job.weights, out[4], series, rows, m) || !take_room(&job.outlying, out[5], series, rows, m) ||
            !take_room(&job.scale, out[6], series, rows, n) || !(job.done = integers(done, series, -1)))
            goto refused;
        double *const work = PyMem_Malloc(series_work(job.n, job.m, &job) * sizeof(double));
        if (!work) return PyErr_NoMemory();
        Py_BEGIN_ALLOW_THREADS;
        spans[n < (npy_intp)(sizeof spans / sizeof *spans) ? n : 0](&job, low, high, work);
        Py_END_ALLOW_THREADS;
        PyMem_Free(work);
    }
    Py_RETURN_NONE;
refused:
    PyErr_SetString(PyExc_ValueError, "filter_series: expected C-contiguous arrays of float64 of matching shapes, as "
                                      "robust_filterpy.kernel.series makes them");
    return NULL;
}

PyMethodDef series_functions[] = {
    {"filter_series", filter_series, METH_VARARGS, "Take the steps of some series; see robust_filterpy.kernel.series."},
    {NULL, NULL, 0, NULL}};

/* Series and recordings: the loop of series.h, without the interpreter's lock. */
#include "groups.h"
#include "series.h"

/* Sizes of the state that the compiler knows; to know one sensor too gains nothing that can be measured. */
#define SIZES(X) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8)
typedef void span_function(const series_job *, ptrdiff_t, ptrdiff_t, double *);

#define SPAN(size) \
    static void span_##size(const series_job *job, ptrdiff_t low, ptrdiff_t high, double *work) { \
        series_span(size, job->m, job, low, high, work); \
    }
SIZES(SPAN)
#undef SPAN

static void span_any(const series_job *job, ptrdiff_t low, ptrdiff_t high, double *work) {
    series_span(job->n, job->m, job, low, high, work);
}

static span_function *const spans[] = {span_any,
#define SPAN(size) span_##size,
                                       SIZES(SPAN)
#undef SPAN
};

static PyObject *filter_series(PyObject *self, PyObject *arguments) {
    PyObject *rule, *z, *matrices, *x, *P, *memory, *rooms, *likelihood, *done, *model[5], *out[5];
    Py_ssize_t steps, first, every, low, high, width;
    series_job job = {0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOOOOOO(nnnndpn)n", &rule, &z, &matrices, &x, &P, &memory, &rooms, &likelihood,
                          &done, &first, &steps, &low, &high, &job.alpha_sq, &job.update_first, &every, &width))
        return NULL;
    if (!take_objects(matrices, 5, model) || !take_objects(rooms, 5, out) || !is_array(z, 3) || !is_array(x, 2))
        goto refused;
    {
        const npy_intp series = PyArray_DIM((PyArrayObject *)z, 0), all = PyArray_DIM((PyArrayObject *)z, 1);
        const npy_intp m = PyArray_DIM((PyArrayObject *)z, 2), n = PyArray_DIM((PyArrayObject *)x, 1);
        const npy_intp states[3] = {series, n, n}, memories[3] = {series, m, SPREAD_NUMBERS};
        if (n < 1 || m < 1 || n > 10000 || m > 10000 || every < 1 || first < 0 || steps < first || steps > all ||
            low < 0 || high < low || high > series || (width != 0 && width != n && width != n * n))
            goto refused;
        const npy_intp rows = all / every;
        if (!rule_of(rule, &job.rule) || !take_matrices(&job.z, z, series, all, m, 0) ||
            !take_matrices(&job.F, model[0], series, all, n, n) || !take_matrices(&job.Q, model[1], series, all, n, n) ||
            !take_matrices(&job.H, model[2], series, all, m, n) || !take_matrices(&job.R, model[3], series, all, m, m) ||
            (model[4] != Py_None && !take_matrices(&job.control, model[4], series, all, n, 0)))
            goto refused;
        /* Of z no axis may be shared. */
        job.z.by_series = all * m, job.z.by_step = m;
        job.x = writable(x, 2, states), job.P = writable(P, 3, states);
        job.memory = memory == Py_None ? NULL : (spread_memory *)writable(memory, 3, memories);
        job.log_likelihood = writable(likelihood, 1, states);
        if (!job.x || !job.P || !job.log_likelihood || (job.rule.scaling == SCALING_LEARNT && !job.memory) ||
            !take_room(&job.means, out[0], series, rows, n) || !take_room(&job.covariances, out[1], series, rows, width) ||
            !take_room(&job.means_p, out[2], series, rows, n) ||
            !take_room(&job.covariances_p, out[3], series, rows, width) ||
            !take_room(&job.weights, out[4], series, rows, m) || !(job.done = integers(done, series, -1)))
            goto refused;
        if (job.rule.scaling != SCALING_LEARNT) job.memory = NULL;
        job.n = (int)n, job.m = (int)m, job.steps = steps, job.first_step = first, job.every = every, job.rows = rows;
        job.covariance_width = (int)width;
        double *const work = PyMem_Malloc(series_work(job.n, job.m) * sizeof(double));
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

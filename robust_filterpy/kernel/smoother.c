/* A smoother's pass: the loops of smoother.h, without the interpreter's lock. */
#include "glue.h"
#include "smoother.h"

/* Sizes of the state that the compiler knows, each with one sensor and with any number. */
#define SPAN(name, n) \
    static void name(const smoother_job *job, ptrdiff_t series, double *work) { \
        if (job->m == 1) smoother_span(n, 1, job, 0, series, work); \
        else smoother_span(n, job->m, job, 0, series, work); \
    }
SPAN(span_any, job->n)
SPAN(span_1, 1) SPAN(span_2, 2) SPAN(span_3, 3) SPAN(span_4, 4) SPAN(span_6, 6)

static void (*const spans[])(const smoother_job *, ptrdiff_t, double *) = {span_any, span_1, span_2,  span_3,
                                                                           span_4,   span_any, span_6};

/* Room for a result of so many numbers in front of the last axes; of length 0 along its steps where it is not wanted.
   Return whether it is either. */
static int take_result(double **found, PyObject *object, int ndim, npy_intp series, npy_intp steps, npy_intp rows,
                       npy_intp columns) {
    const npy_intp shape[4] = {series, steps, rows, columns}, none[4] = {series, 0, rows, columns};
    *found = writable(object, ndim, shape);
    return *found != NULL || writable(object, ndim, none) != NULL;
}

static PyObject *smooth(PyObject *self, PyObject *arguments) {
    PyObject *groups[3], *model[7], *weighting[3], *out[8];
    double sharpest = 0;
    smoother_job job = {.sharpest = &sharpest};
    (void)self;
    if (!take_objects(arguments, 3, groups) || !take_objects(groups[0], 7, model) ||
        !take_objects(groups[1], 3, weighting) || !take_objects(groups[2], 8, out) || !is_array(model[4], 3) ||
        !is_array(model[1], 4))
        goto refused;
    {
        PyObject *const G = model[1], *const z = model[4];
        const npy_intp series = PyArray_DIM((PyArrayObject *)z, 0), steps = PyArray_DIM((PyArrayObject *)z, 1);
        const npy_intp m = PyArray_DIM((PyArrayObject *)z, 2), n = PyArray_DIM((PyArrayObject *)G, 2);
        const npy_intp r = PyArray_DIM((PyArrayObject *)G, 3), states[3] = {series, n, n};
        if (n < 1 || m < 1 || r < 0 || n > 10000 || m > 10000 || r > 10000) goto refused;
        if (!take_matrices(&job.F, model[0], series, steps, n, n) || !take_matrices(&job.G, G, series, steps, n, r) ||
            !take_matrices(&job.c, model[2], series, steps, n, 0) ||
            !take_matrices(&job.H, model[3], series, steps, m, n) || !take_matrices(&job.z, z, series, steps, m, 0) ||
            !take_matrices(&job.x0, model[5], series, 1, n, 0) || !take_matrices(&job.P0, model[6], series, 1, n, n) ||
            !take_matrices(&job.d, weighting[0], series, steps, m, 0) ||
            !take_matrices(&job.o, weighting[1], series, steps, m, 0) ||
            !take_matrices(&job.q, weighting[2], series, steps, 1, 0))
            goto refused;
        if (!(job.fitted = writable(out[0], 3, (npy_intp[]){series, steps, m})) ||
            !take_result(&job.spread, out[1], 4, series, steps, m, m) ||
            !take_result(&job.score, out[2], 3, series, steps, r, 0) ||
            !take_result(&job.information, out[3], 4, series, steps, r, r) ||
            !take_result(&job.x, out[4], 3, series, steps, n, 0) ||
            !take_result(&job.P, out[5], 4, series, steps, n, n) || !(job.x_first = writable(out[6], 2, states)) ||
            !(job.P_first = writable(out[7], 3, states)))
            goto refused;
        if (!job.x != !job.P || !job.score != !job.information || ((job.x || job.score) && !job.spread)) goto refused;
        job.steps = steps, job.n = (int)n, job.m = (int)m, job.r = (int)r;
        double *const work = PyMem_Malloc(smoother_work(steps, job.n, job.m, job.r) * sizeof(double));
        if (!work) return PyErr_NoMemory();
        Py_BEGIN_ALLOW_THREADS;
        spans[n < (npy_intp)(sizeof spans / sizeof *spans) ? n : 0](&job, series, work);
        Py_END_ALLOW_THREADS;
        PyMem_Free(work);
    }
    return PyFloat_FromDouble(sharpest);
refused:
    PyErr_SetString(PyExc_ValueError, "smooth: expected C-contiguous arrays of float64 of matching shapes, as "
                                      "robust_filterpy.smoothing.linear_pass makes them");
    return NULL;
}

PyMethodDef smoother_functions[] = {
    {"smooth", smooth, METH_VARARGS, "Smooth some series once: (model, weighting, results), as linear_pass has them; return how sharp a measurement was."},
    {NULL, NULL, 0, NULL}};

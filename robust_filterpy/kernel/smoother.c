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

static PyObject *smooth(PyObject *self, PyObject *arguments) {
    PyObject *model, *weighting, *results;
    double sharpest = 0;
    npy_intp lengths[AXES] = UNKNOWN_AXES;
    smoother_job job = {.sharpest = &sharpest};
    (void)self;
    AXIS('o') = 1;
    if (!PyArg_ParseTuple(arguments, "OOO", &model, &weighting, &results)) return NULL;
    if (!take_arrays(results, "!skm !skmm ?!skr ?!skrr ?!skn ?!sknn !sn !snn", lengths,
                     (void *[]){&job.fitted, &job.spread, &job.score, &job.information, &job.x, &job.P, &job.x_first,
                                &job.P_first}) ||
        !take_arrays(model, ".sknn .sknr .skn .skmn .skm .son .sonn", lengths,
                     (void *[]){&job.F, &job.G, &job.c, &job.H, &job.z, &job.x0, &job.P0}) ||
        !take_arrays(weighting, ".skm .skm .sko", lengths, (void *[]){&job.d, &job.o, &job.q}))
        return refuse_arrays("smooth", "smoothing.linear_pass");
    const npy_intp n = AXIS('n'), m = AXIS('m'), r = AXIS('r');
    if (n < 1 || m < 1 || n > 10000 || m > 10000 || r > 10000 || !job.x != !job.P || !job.score != !job.information)
        return refuse_arrays("smooth", "smoothing.linear_pass");
    job.steps = AXIS('k'), job.n = (int)n, job.m = (int)m, job.r = (int)r;
    double *const work = PyMem_Malloc(smoother_work(job.steps, job.n, job.m, job.r) * sizeof(double));
    if (!work) return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS;
    spans[n < (npy_intp)(sizeof spans / sizeof *spans) ? n : 0](&job, AXIS('s'), work);
    Py_END_ALLOW_THREADS;
    PyMem_Free(work);
    return PyFloat_FromDouble(sharpest);
}

PyMethodDef smoother_functions[] = {
    {"smooth", smooth, METH_VARARGS, "Smooth some series once: (model, weighting, results), as linear_pass has them; return how sharp a measurement was."},
    {NULL, NULL, 0, NULL}};

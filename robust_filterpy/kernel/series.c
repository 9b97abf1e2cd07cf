/* Series and recordings: the loop of series.h, without the interpreter's lock. */
#include "glue.h"

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

/* Take x, P, memory and, under a mixture, x, P and p of the models; whether they are that. */
static int take_moving(series_job *job, PyObject *of, npy_intp lengths[AXES]) {
    const learnt_rule *const rule = &job->mixture;
    const char *const words = job->mixes                                 ? "!sn !snn !srw !sqn !sqnn !sbn"
                              : job->bounded.scaling == SCALING_LEARNT ? "!sn !snn !srw" : "!sn !snn";
    AXIS('r') = job->mixes ? memory_rows(rule, job->m) : job->m;
    AXIS('w') = job->mixes ? learnt_width(rule->K) : SPREAD_NUMBERS;
    AXIS('q') = learnt_rows(rule), AXIS('b') = learnt_beliefs(1, rule);
    if (!take_arrays(of, words, lengths, (void *[]){&job->x, &job->P, job->moving, job->moving + 1, job->moving + 2,
                                                    job->moving + 3}))
        return 0;
    const npy_intp sizes[4] = {AXIS('r') * AXIS('w'), AXIS('q') * job->n, AXIS('q') * job->n * job->n, AXIS('b') * job->n};
    for (int a = 0; a < 4; a++) job->sizes[a] = job->moving[a] ? (int)sizes[a] : 0;
    for (npy_intp s = 0; job->mixes && s < AXIS('s'); s++) {
        const learnt_state state = {NULL, NULL, job->moving[3] + s * job->sizes[3], NULL};
        if (!learnt_has_parts(job->n, rule, &state)) return 0;
    }
    return 1;
}

/* Whether there is all that a job wants. */
static int take_job(series_job *job, PyObject *rule, PyObject *given, PyObject *state, PyObject *rooms, npy_intp *lengths) {
    job->mixes = !rule_of(rule, &job->bounded);
    const npy_intp most = job->mixes ? 1000 : 10000;
    if ((job->mixes && !take_rule(&job->mixture, rule)) || job->every < 1 ||
        !take_arrays(given, ".skm .skm .sknn .sknn .skmn .skmm ?.skn ?.sknm", lengths,
                     (void *[]){&job->z, &job->readings, &job->F, &job->Q, &job->H, &job->R, &job->control, &job->M}))
        return 0;
    const npy_intp n = AXIS('n'), m = AXIS('m');
    if (n < 1 || m < 1 || n > most || m > most || job->first < 0 || job->last < job->first || job->last > AXIS('k')) return 0;
    job->n = (int)n, job->m = (int)m, job->rows = AXIS('e') = AXIS('k') / job->every;
    if (!take_moving(job, state, lengths) ||
        !take_arrays(rooms, "?!sen ?!sev ?!sen ?!sev ?!sem ?!sem ?!sen !s #!s", lengths,
                     (void *[]){&job->means, &job->covariances, &job->means_p, &job->covariances_p, &job->weights,
                                &job->outlying, &job->scale, &job->log_likelihood, &job->done}))
        return 0;
    job->width = (int)AXIS('v');
    return AXIS('v') < 0 || AXIS('v') == n || AXIS('v') == n * n;
}

static PyObject *filter_series(PyObject *self, PyObject *arguments) {
    PyObject *rule, *given, *state, *rooms;
    npy_intp lengths[AXES] = UNKNOWN_AXES, low, high;
    series_job job = {0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOO(nnnndpni)", &rule, &given, &state, &rooms, &job.first, &job.last, &low, &high,
                          &job.alpha_sq, &job.update_first, &job.every, &job.which))
        return NULL;
    if (!take_job(&job, rule, given, state, rooms, lengths) || low < 0 || high < low || high > AXIS('s'))
        return refuse_arrays("filter_series", "kernel.series");
    double *const work = PyMem_Malloc(series_work(job.n, job.m, &job) * sizeof(double));
    if (!work) return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS;
    spans[job.n < (int)(sizeof spans / sizeof *spans) ? job.n : 0](&job, low, high, work);
    Py_END_ALLOW_THREADS;
    PyMem_Free(work);
    Py_RETURN_NONE;
}

PyMethodDef series_functions[] = {
    {"filter_series", filter_series, METH_VARARGS, "Take the steps of some series; see robust_filterpy.kernel.series."},
    {NULL, NULL, 0, NULL}};

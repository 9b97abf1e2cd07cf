/* Learnt noise: a prediction, a correction, and a recording of many steps, on arrays that are changed in place. */
#include "learnt.h"

#include "groups.h"
#include "online.h"

/* The rule from the array that robust_filterpy.kernel.learnt makes of it; return whether it is that. */
int take_rule(learnt_rule *rule, PyObject *object) {
    enum { HEAD = 7 };
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!PyArray_CheckExact(object) || PyArray_NDIM(array) != 1 || PyArray_DIM(array, 0) < HEAD) return 0;
    const double *const numbers = vector_of(object, PyArray_DIM(array, 0));
    if (!numbers || !(numbers[0] >= 1 && numbers[0] < 1000 && numbers[1] >= 1 && numbers[1] < 1000)) return 0;
    rule->q = (int)numbers[0], rule->K = (int)numbers[1];
    rule->stay = numbers[2], rule->jump = numbers[3], rule->memory = numbers[4], rule->r_memory = numbers[5];
    rule->learns = numbers[6] != 0;
    rule->process = numbers + HEAD;
    rule->scales = rule->process + rule->q;
    rule->begin = rule->scales + rule->K;
    return PyArray_DIM(array, 0) == HEAD + rule->q + rule->K + learnt_width(rule->K);
}

/* The copies and what is known of m sensors; m < 0: of none. Return whether the arrays are that. */
static int take_copies(learnt_state *s, const learnt_rule *rule, npy_intp n, npy_intp m, PyObject *x, PyObject *P,
                      PyObject *p, PyObject *unseen, PyObject *memory) {
    const npy_intp copies = learnt_copies(rule), means[2] = {copies, n}, covariances[3] = {copies, n, n};
    const npy_intp one[1] = {1}, known[2] = {m, learnt_width(rule->K)};
    s->x = writable(x, 2, means), s->P = writable(P, 3, covariances), s->p = writable(p, 1, &copies);
    s->unseen = writable(unseen, 1, one), s->memory = m < 0 ? NULL : writable(memory, 2, known);
    return s->x && s->P && s->p && s->unseen && (m < 0 || s->memory);
}

static PyObject *wrong(void) {
    PyErr_SetString(PyExc_ValueError,
                    "expected C-contiguous arrays of float64 of matching shapes, as robust_filterpy.kernel.learnt "
                    "makes them");
    return NULL;
}

/* Matrices for each step, or one for all: (steps or 1, rows, columns), columns 0 for vectors. */
typedef struct {
    const double *data;
    npy_intp by_step;
} step_matrices;

static int take_steps(step_matrices *found, PyObject *object, npy_intp steps, npy_intp rows, npy_intp columns) {
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!PyArray_CheckExact(object) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISCARRAY_RO(array)) return 0;
    if (PyArray_NDIM(array) != (columns ? 3 : 2) || PyArray_DIM(array, 1) != rows) return 0;
    if (columns && PyArray_DIM(array, 2) != columns) return 0;
    if (PyArray_DIM(array, 0) != 1 && PyArray_DIM(array, 0) < steps) return 0;
    found->data = PyArray_DATA(array);
    found->by_step = PyArray_DIM(array, 0) == 1 ? 0 : rows * (columns ? columns : 1);
    return 1;
}

typedef struct {
    learnt_rule rule;
    learnt_state state;
    step_matrices z, F, Q, H, R, control;
    int n, m, update_first;
    int which; /* halves of a step: 1 its prediction, 2 its correction, 3 both */
    npy_intp first, last, every, width;
    double alpha_sq, *x, *P; /* mean and covariance of all: written */
    double *means, *covariances, *means_p, *covariances_p, *weights, *outlying, *scale, *log_likelihood;
} learnt_job;

static void keep(const learnt_job *job, npy_intp row, double *means, double *covariances) {
    const int n = job->n;
    if (means) real_copy(n, job->x, means + row * n);
    if (!covariances) return;
    for (npy_intp i = 0; i < job->width; i++)
        covariances[row * job->width + i] = job->width == n ? job->P[i * n + i] : job->P[i];
}

/* Take steps until one is out of the ordinary; return the first that was not taken. */
INLINE npy_intp run(const int n, const int m, learnt_job *job, double *work) {
    const learnt_rule rule = job->rule;
    const int copies = learnt_copies(&rule), known = m * learnt_width(rule.K);
    double *const kept = work, *weights = kept + copies * (n * n + n + 1) + known + 1 + n + n * n;
    double *const outlying = weights + m, *const spare = outlying + m;
    learnt_state *const s = &job->state;
    const learnt_state before = {kept, kept + copies * n, kept + copies * (n + n * n),
                                 kept + copies * (n + n * n + 1) + known, kept + copies * (n + n * n + 1)};
    double *const x = before.unseen + 1, *const P = x + n;
    for (npy_intp k = job->first; k < job->last; k++) {
        const npy_intp row = (k + 1) / job->every - 1;
        const int kept_step = (k + 1) % job->every == 0;
        int fine = 1;
        double likelihood = 0;
        real_copy(copies * n, s->x, before.x), real_copy(copies * n * n, s->P, before.P);
        real_copy(copies, s->p, before.p), real_copy(known, s->memory, before.memory);
        *before.unseen = *s->unseen;
        real_copy(n, job->x, x), real_copy(n * n, job->P, P);
        for (int half = 0; half < 2 && fine; half++) {
            const int corrects = (half == 0) == job->update_first;
            if (!(job->which & (corrects ? 2 : 1))) continue;
            if (corrects)
                fine = learnt_correct(n, m, &rule, s, job->z.data + k * job->z.by_step,
                                      job->H.data + k * job->H.by_step, job->R.data + k * job->R.by_step, weights,
                                      outlying, &likelihood, spare) >= 0;
            else
                learnt_predict(n, &rule, s, job->F.data + k * job->F.by_step, job->Q.data + k * job->Q.by_step,
                               job->control.data ? job->control.data + k * job->control.by_step : NULL, job->alpha_sq,
                               spare);
            fine = fine && learnt_merge(n, &rule, s, job->x, job->P, spare);
            if (fine && kept_step) {
                if (corrects) keep(job, row, job->means, job->covariances);
                else keep(job, row, job->means_p, job->covariances_p);
            }
        }
        if (!fine) {
            real_copy(copies * n, before.x, s->x), real_copy(copies * n * n, before.P, s->P);
            real_copy(copies, before.p, s->p), real_copy(known, before.memory, s->memory);
            *s->unseen = *before.unseen;
            real_copy(n, x, job->x), real_copy(n * n, P, job->P);
            return k;
        }
        *job->log_likelihood += likelihood;
        if (kept_step && job->which & 2) {
            double ordinary = 1, slow = 0, total = 0;
            for (int i = 0; i < m; i++) {
                ordinary *= 1 - outlying[i];
                if (job->weights) job->weights[row * m + i] = weights[i];
            }
            for (int c = 0; c < rule.q; c++) slow += s->p[c], total += s->p[c] * rule.process[c];
            if (job->outlying) job->outlying[row] = 1 - ordinary;
            if (job->scale) job->scale[row] = total / slow;
        }
    }
    return job->last;
}

static npy_intp run_sized(learnt_job *job, double *work) {
#define SIZE(states, sensors) \
    if (job->n == states && job->m == sensors) return run(states, sensors, job, work)
    SIZE(1, 1);
    SIZE(2, 1);
    SIZE(4, 1);
    SIZE(4, 2);
#undef SIZE
    return run(job->n, job->m, job, work);
}

static double *room(PyObject *object, npy_intp rows, npy_intp width, int *fine) {
    const npy_intp shape[2] = {rows, width};
    double *found;
    if (object == Py_None) return NULL;
    found = writable(object, 2, shape);
    *fine = *fine && found;
    return found;
}

static PyObject *learnt_steps(PyObject *self, PyObject *arguments) {
    PyObject *rule, *x, *P, *p, *unseen, *memory, *mean, *covariance, *z, *F, *Q, *H, *R, *u, *means, *covariances;
    PyObject *means_p, *covariances_p, *weights, *outlying, *scale, *likelihood;
    Py_ssize_t first, last, every, width;
    learnt_job job = {0};
    int fine = 1;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O(OOOOOOO)O(OOOOO)(OOOOOOOO)(nnndpni)", &rule, &x, &P, &p, &memory, &mean,
                          &covariance, &unseen, &z, &F, &Q, &H, &R, &u, &means, &covariances, &means_p, &covariances_p,
                          &weights, &outlying, &scale, &likelihood, &first, &last, &every, &job.alpha_sq,
                          &job.update_first, &width, &job.which))
        return NULL;
    if (!take_rule(&job.rule, rule) || !PyArray_CheckExact(z) || PyArray_NDIM((PyArrayObject *)z) != 2 ||
        !PyArray_CheckExact(x) || PyArray_NDIM((PyArrayObject *)x) != 2)
        return wrong();
    const npy_intp m = PyArray_DIM((PyArrayObject *)z, 1), n = PyArray_DIM((PyArrayObject *)x, 1);
    const npy_intp states[2] = {n, n}, one[1] = {1}, all = PyArray_DIM((PyArrayObject *)z, 0);
    if (n < 1 || m < 1 || n > 1000 || m > 1000 || every < 1 || first < 0 || last < first || last > all) return wrong();
    if (width != 0 && width != n && width != n * n) return wrong();
    const npy_intp rows = all / every;
    if (!take_copies(&job.state, &job.rule, n, m, x, P, p, unseen, memory) || !take_steps(&job.z, z, all, m, 0) ||
        !take_steps(&job.F, F, all, n, n) || !take_steps(&job.Q, Q, all, n, n) || !take_steps(&job.H, H, all, m, n) ||
        !take_steps(&job.R, R, all, m, m) || (u != Py_None && !take_steps(&job.control, u, all, n, 0)))
        return wrong();
    job.z.by_step = m;
    job.x = writable(mean, 1, states), job.P = writable(covariance, 2, states);
    job.means = room(means, rows, n, &fine), job.means_p = room(means_p, rows, n, &fine);
    job.covariances = room(covariances, rows, width, &fine);
    job.covariances_p = room(covariances_p, rows, width, &fine);
    job.weights = room(weights, rows, m, &fine);
    job.outlying = room(outlying, rows, 1, &fine), job.scale = room(scale, rows, 1, &fine);
    job.log_likelihood = writable(likelihood, 1, one);
    if (!fine || !job.x || !job.P || !job.log_likelihood) return wrong();
    job.n = (int)n, job.m = (int)m, job.first = first, job.last = last, job.every = every, job.width = width;
    const int copies = learnt_copies(&job.rule), K = job.rule.K;
    const size_t step = learnt_correct_work(job.n, job.m, copies, K) + learnt_predict_work(job.n, copies);
    const size_t kept = (size_t)(copies * (n * n + n + 1) + m * learnt_width(K) + 1 + n + n * n + 2 * m);
    double *const work = PyMem_Malloc((step + kept) * sizeof(double));
    if (!work) return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS;
    first = run_sized(&job, work);
    Py_END_ALLOW_THREADS;
    PyMem_Free(work);
    return PyLong_FromSsize_t(first);
}

PyMethodDef learnt_functions[] = {
    {"learnt_steps", learnt_steps, METH_VARARGS, "Take steps of a recording; see robust_filterpy.kernel.learnt."},
    {NULL, NULL, 0, NULL}};

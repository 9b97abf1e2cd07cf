/* Learnt noise: a prediction, a correction, and a recording of many steps, on arrays that are changed in place. */
#include "learnt.h"

#include "groups.h"
#include "online.h"

/* The rule from the array that robust_filterpy.kernel.learnt makes of it; return whether it is that. */
int take_rule(learnt_rule *rule, PyObject *object) {
    /* `Head` there. */
    typedef struct {
        double models, classes, stay, jump, memory, r_memory, learns, draws, grouped;
    } rule_head;
    const npy_intp length = is_array(object, 1) ? PyArray_DIM((PyArrayObject *)object, 0) : 0, least = sizeof(rule_head) / sizeof(double);
    const double *const numbers = length < least ? NULL : vector_of(object, length);
    const rule_head *const head = (const rule_head *)numbers;
    if (!numbers || !(head->models >= 1 && head->models < 1000 && head->classes >= 1 && head->classes < 1000)) return 0;
    rule->q = (int)head->models, rule->K = (int)head->classes;
    rule->stay = head->stay, rule->jump = head->jump, rule->memory = head->memory, rule->r_memory = head->r_memory;
    rule->learns = head->learns != 0;
    rule->process = numbers + least;
    rule->scales = rule->process + rule->q;
    rule->begin = rule->scales + rule->K;
    rule->drawn = head->draws != 0 ? rule->begin + learnt_width(rule->K) : NULL;
    rule->joint = head->grouped < 0;
    rule->named = rule->joint || !(head->grouped < 1000) ? 0 : (int)head->grouped;
    rule->leads = rule->begin + learnt_width(rule->K) + (rule->drawn ? rule->q : 0);
    if (rule->leads + rule->named != numbers + length) return 0;
    for (int i = 0; i < rule->named; i++)
        if (!(rule->leads[i] >= 0 && rule->leads[i] <= i)) return 0;
    return 1;
}

size_t correct_work(const learnt_rule *rule, npy_intp n, npy_intp m) {
    return learnt_correct_work(n, m, learnt_models(rule), rule->K);
}

npy_intp memory_rows(const learnt_rule *rule, npy_intp m) { return rule->joint ? 1 : m; }

/* The models and the memory of m sensors; m < 0: of none. Return whether the arrays are that. */
static int take_models(learnt_state *s, const learnt_rule *rule, npy_intp n, npy_intp m, PyObject *x, PyObject *P,
                      PyObject *p, PyObject *memory) {
    const npy_intp rows = learnt_rows(rule), means[2] = {rows, n}, covariances[3] = {rows, n, n};
    const npy_intp beliefs[2] = {learnt_beliefs(1, rule), n}, memories[2] = {memory_rows(rule, m), learnt_width(rule->K)};
    s->x = writable(x, 2, means), s->P = writable(P, 3, covariances), s->p = writable(p, 2, beliefs);
    s->memory = m < 0 ? NULL : writable(memory, 2, memories);
    return s->x && s->P && s->p && (m < 0 || s->memory) && learnt_has_parts((int)n, rule, s);
}

static PyObject *wrong(void) {
    PyErr_SetString(PyExc_ValueError,
                    "expected C-contiguous arrays of float64 of matching shapes, as robust_filterpy.kernel.learnt "
                    "makes them");
    return NULL;
}

typedef struct {
    learnt_rule rule;
    learnt_state state;
    series_matrices z, readings, F, Q, H, R, control, M; /* of one series */
    int n, m, update_first;
    int which; /* halves of a step: 1 its prediction, 2 its correction, 3 both */
    npy_intp first, last, every, width;
    double alpha_sq, *x, *P; /* mean and covariance of all: written */
    double *means, *covariances, *means_p, *covariances_p, *weights, *outlying, *scale, *log_likelihood;
} learnt_job;

/* Take steps until one is out of the ordinary; return the first that was not taken. */
INLINE npy_intp run(const int n, const int m, learnt_job *job, double *work) {
    const learnt_rule rule = job->rule;
    const int rows = learnt_rows(&rule), numbers = (int)memory_rows(&rule, m) * learnt_width(rule.K), beliefs = learnt_beliefs(n, &rule);
    double *const before_x = work, *const p = before_x + rows * (n * n + n), *const memory = p + beliefs;
    double *const x = memory + numbers, *const P = x + n, *const weights = P + n * n;
    double *const outlying = weights + m, *const spare = outlying + m;
    learnt_state *const s = &job->state;
    const learnt_state before = {before_x, before_x + rows * n, p, memory};
    for (npy_intp k = job->first; k < job->last; k++) {
        const npy_intp row = (k + 1) / job->every - 1;
        const int kept_step = (k + 1) % job->every == 0;
        int fine = 1;
        double likelihood = 0;
        real_copy(rows * n, s->x, before.x), real_copy(rows * n * n, s->P, before.P);
        real_copy(beliefs, s->p, before.p), real_copy(numbers, s->memory, before.memory);
        real_copy(n, job->x, x), real_copy(n * n, job->P, P);
        for (int half = 0; half < 2 && fine; half++) {
            const int corrects = (half == 0) == job->update_first;
            if (!(job->which & (corrects ? 2 : 1))) continue;
            if (corrects)
                fine = learnt_correct(n, m, &rule, s, job->z.data + k * job->z.by_step,
                                      job->readings.data + k * job->readings.by_step,
                                      job->H.data + k * job->H.by_step, job->R.data + k * job->R.by_step,
                                      job->M.data ? job->M.data + k * job->M.by_step : NULL, weights, outlying,
                                       &likelihood, spare) >= 0;
            else
                learnt_predict(n, &rule, s, job->F.data + k * job->F.by_step, job->Q.data + k * job->Q.by_step,
                               job->control.data ? job->control.data + k * job->control.by_step : NULL, job->alpha_sq,
                               spare);
            fine = fine && learnt_merge(n, &rule, s, job->x, job->P, spare);
            if (fine && kept_step) {
                if (corrects) series_keep(n, (int)job->width, row, job->x, job->P, job->means, job->covariances);
                else series_keep(n, (int)job->width, row, job->x, job->P, job->means_p, job->covariances_p);
            }
        }
        if (!fine) {
            real_copy(rows * n, before.x, s->x), real_copy(rows * n * n, before.P, s->P);
            real_copy(beliefs, before.p, s->p), real_copy(numbers, before.memory, s->memory);
            real_copy(n, x, job->x), real_copy(n * n, P, job->P);
            return k;
        }
        *job->log_likelihood += likelihood;
        if (kept_step && job->which & 2) {
            if (job->weights) real_copy(m, weights, job->weights + row * m);
            if (job->outlying) real_copy(m, outlying, job->outlying + row * m);
            for (int i = 0; job->scale && i < n; i++) {
                double slow = 0, total = 0;
                for (int c = 0; c < rule.q; c++) slow += s->p[c * n + i], total += s->p[c * n + i] * rule.process[c];
                if (learnt_gives(&rule)) total *= learnt_given(n, &rule, s, LEARNT_FACTOR)[i];
                job->scale[row * n + i] = total / slow;
            }
        }
    }
    return job->last;
}

static npy_intp run_sized(learnt_job *job, double *work) {
#define STATES(states) \
    case states: return run(states, job->m, job, work)
    switch (job->n) {
        STATES(1);
        STATES(2);
        STATES(3);
        STATES(4);
        STATES(5);
        STATES(6);
        STATES(7);
        STATES(8);
    }
#undef STATES
    return run(job->n, job->m, job, work);
}

static PyObject *learnt_steps(PyObject *self, PyObject *arguments) {
    PyObject *rule, *standing, *z, *readings, *matrices, *rooms, *state[6], *model[6], *out[8];
    Py_ssize_t first, last, every, width;
    learnt_job job = {0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOOO(nnndpni)", &rule, &standing, &z, &readings, &matrices, &rooms, &first, &last, &every,
                          &job.alpha_sq, &job.update_first, &width, &job.which))
        return NULL;
    if (!take_rule(&job.rule, rule) || !take_objects(standing, 6, state) || !take_objects(matrices, 6, model) ||
        !take_objects(rooms, 8, out) || !is_array(z, 3) || !is_array(state[0], 2))
        return wrong();
    const npy_intp all = PyArray_DIM((PyArrayObject *)z, 1), m = PyArray_DIM((PyArrayObject *)z, 2);
    const npy_intp n = PyArray_DIM((PyArrayObject *)state[0], 1), states[2] = {n, n}, one[1] = {1};
    if (n < 1 || m < 1 || n > 1000 || m > 1000 || every < 1 || first < 0 || last < first || last > all) return wrong();
    if (width != 0 && width != n && width != n * n) return wrong();
    const npy_intp rows = all / every;
    if (!take_models(&job.state, &job.rule, n, m, state[0], state[1], state[2], state[3]) ||
        !(job.x = writable(state[4], 1, states)) || !(job.P = writable(state[5], 2, states)) ||
        !take_matrices(&job.z, z, 1, all, m, 0) || !take_matrices(&job.readings, readings, 1, all, m, 0) || !take_matrices(&job.F, model[0], 1, all, n, n) ||
        !take_matrices(&job.Q, model[1], 1, all, n, n) || !take_matrices(&job.H, model[2], 1, all, m, n) ||
        !take_matrices(&job.R, model[3], 1, all, m, m) ||
        (model[4] != Py_None && !take_matrices(&job.control, model[4], 1, all, n, 0)) ||
        (model[5] != Py_None && !take_matrices(&job.M, model[5], 1, all, n, m)) ||
        !take_room(&job.means, out[0], 1, rows, n) || !take_room(&job.covariances, out[1], 1, rows, width) ||
        !take_room(&job.means_p, out[2], 1, rows, n) || !take_room(&job.covariances_p, out[3], 1, rows, width) ||
        !take_room(&job.weights, out[4], 1, rows, m) || !take_room(&job.outlying, out[5], 1, rows, m) ||
        !take_room(&job.scale, out[6], 1, rows, n) || !(job.log_likelihood = writable(out[7], 1, one)))
        return wrong();
    job.z.by_step = job.readings.by_step = m;
    job.n = (int)n, job.m = (int)m, job.first = first, job.last = last, job.every = every, job.width = width;
    const int models = learnt_models(&job.rule), K = job.rule.K;
    const size_t step = correct_work(&job.rule, n, m) + learnt_predict_work(job.n, models);
    const size_t saved = (size_t)((models + 2) * (n * n + n) + (models + 5) * n + m * learnt_width(K) + 2 * m);
    double *const work = PyMem_Malloc((step + saved) * sizeof(double));
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

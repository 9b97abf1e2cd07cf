/* Hypotheses about readings, each a filter of the state and one number more: robust_filterpy.fusion._faults in C. */
#include "glue.h"

/* What sets one apart since its onset: slack is a factor of Q, spread the variance of b then, the rest of a sensor. */
typedef struct {
    double component, onset, slack, sees, offset, drift, noise, spread;
} hypothesis;
#define HYPOTHESIS_NUMBERS ((npy_intp)(sizeof(hypothesis) / sizeof(double)))

typedef struct {
    const double *F, *Q, *control, *seconds, *z, *H, *r, *scales, *shares, *worth;
    npy_intp first, last, m;
    int n, classes;
} stretch;

/* Correct by one number under a mixture of classes; return its log-density. */
SIZED double corrected(const int D, const int classes, const double z, const double *RESTRICT h, const double r,
                       const double *RESTRICT scales, const double *RESTRICT shares, double *RESTRICT x,
                       double *RESTRICT P, double *RESTRICT C, double *RESTRICT inverses) {
    double y = z - real_dot(D, h, x), seen = 0, least = INFINITY, total = 0, a = 0, b = 0;
    for (int i = 0; i < D; i++) seen += h[i] * (C[i] = real_dot(D, P + i * D, h));
    for (int k = 0; k < classes; k++) {
        inverses[k] = 1 / (seen + r * scales[k]);
        if (shares[k] > 0) least = real_min(least, inverses[k]);
    }
    if (r > 0 && y * y * least > LEARNT_REACH * LEARNT_REACH) y = real_copysign(LEARNT_REACH / sqrt(least), y);
    const double peak = -0.5 * y * y * least;
    for (int k = 0; k < classes; k++) {
        const double inverse = inverses[k], pull = y * inverse;
        const double p = shares[k] * sqrt(inverse) * exp(-0.5 * y * pull - peak);
        total += p;
        a += p * pull;
        b += p * (inverse - pull * pull);
    }
    a /= total;
    b = b / total + a * a;
    for (int i = 0; i < D; i++) {
        const double pulled = b * C[i];
        x[i] += a * C[i];
        for (int j = 0; j < D; j++) P[i * D + j] -= pulled * C[j];
    }
    return peak + log(total) - 0.5 * log(2 * 3.14159265358979323846);
}

/* Take one hypothesis through some stamps; its state is x, and b the last number. */
SIZED void through(const int n, const stretch *const s, const hypothesis *const one, double *RESTRICT x,
                   double *RESTRICT P, double *const sum, double *const work) {
    const int D = n + 1;
    double *RESTRICT const before = work, *RESTRICT const after = before + n * n, *RESTRICT const Q = after + n * n;
    double *RESTRICT const h = Q + n * n, *RESTRICT const ahead = h + D, *RESTRICT const scratch = ahead + n;
    for (npy_intp k = s->first; k < s->last; k++) {
        const double *const H = s->H + k * s->m * n, *const F = s->F + k * n * n;
        const double since = s->seconds[k] - s->seconds[(npy_intp)one->onset];
        const int on = one->onset <= (double)k;
        for (int i = 0; i < n; i++) real_copy(n, P + i * D, before + i * n);
        for (int i = 0; i < n * n; i++) Q[i] = (on ? one->slack : 1) * s->Q[k * n * n + i];
        (void)predict(n, x, before, F, Q, s->control + k * n, 1, ahead, after, scratch);
        real_copy(n, ahead, x);
        for (int i = 0; i < n; i++) {
            real_copy(n, after + i * n, P + i * D);
            P[i * D + n] = real_dot(n, F + i * n, P + n * D);
        }
        for (int i = 0; i < n; i++) P[n * D + i] = P[i * D + n];
        if (one->onset == (double)k) {
            P[n * D + n] = one->spread;
            x[n] = one->sees == 0 ? real_dot(n, H + (npy_intp)one->component * n, x) : 0;
        }
        for (npy_intp c = 0; c < s->m; c++) {
            const double z = s->z[k * s->m + c];
            const int mine = on && one->component == (double)c;
            if (isnan(z)) continue;
            const double *const shares = mine ? (const double *)(one + 1) : s->shares + c * s->classes;
            for (int i = 0; i < n; i++) h[i] = (mine ? one->sees : 1) * H[c * n + i];
            h[n] = mine ? one->offset + one->drift * since : 0;
            const double r = s->r[c] * (mine ? one->noise : 1);
            *sum += s->worth[c] * corrected(D, s->classes, z, h, r, s->scales, shares, x, P, scratch, scratch + D);
        }
    }
}

/* With the loops of the usual sizes. */
static void through_any(const int n, const stretch *const s, const hypothesis *const one, double *x, double *P,
                        double *const sum, double *const work) {
    if (n == 2) through(2, s, one, x, P, sum, work);
    else if (n == 4) through(4, s, one, x, P, sum, work);
    else through(n, s, one, x, P, sum, work);
}

static PyObject *advance_hypotheses(PyObject *self, PyObject *arguments) {
    npy_intp lengths[AXES] = UNKNOWN_AXES;
    PyObject *moving, *given;
    stretch s = {0};
    double *rows, *means, *covariances, *logs;
    int fine;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOnn", &moving, &given, &s.first, &s.last)) return NULL;
    fine = take_arrays(given, "knn knn kn k km kmn m c mc m", lengths,
                       (void *[]){&s.F, &s.Q, &s.control, &s.seconds, &s.z, &s.H, &s.r, &s.scales, &s.shares, &s.worth});
    const npy_intp D = AXIS('d') = AXIS('n') + 1, width = AXIS('w') = HYPOTHESIS_NUMBERS + AXIS('c');
    fine = fine && take_arrays(moving, "hw !hd !hdd !h", lengths, (void *[]){&rows, &means, &covariances, &logs}) &&
           0 <= s.first && s.first <= s.last && s.last <= AXIS('k');
    s.m = AXIS('m'), s.n = (int)AXIS('n'), s.classes = (int)AXIS('c');
    for (npy_intp i = 0; fine && i < AXIS('h'); i++) {
        const hypothesis *const one = (const hypothesis *)(rows + i * width);
        fine = one->component >= -1 && one->component < (double)s.m && one->onset >= 0 &&
               one->onset < (double)AXIS('k') && (one->component >= 0 || one->sees != 0);
    }
    if (!fine) return refuse_arrays("advance_hypotheses", "fusion._faults");
    double *const work = PyMem_Malloc(((size_t)(3 * D * D + 3 * D + s.classes) + predict_work(D)) * sizeof(double));
    if (!work) return PyErr_NoMemory();
    for (npy_intp i = 0; i < AXIS('h'); i++)
        through_any(s.n, &s, (const hypothesis *)(rows + i * width), means + i * D, covariances + i * D * D, logs + i, work);
    PyMem_Free(work);
    Py_RETURN_NONE;
}

/* Solve L L' out = d, L a Cholesky factor; in place where out is d. */
static void solve(const npy_intp m, const double *const L, const double *const d, double *const out) {
    for (npy_intp i = 0; i < m; i++) {
        double rest = d[i];
        for (npy_intp k = 0; k < i; k++) rest -= L[i * m + k] * out[k];
        out[i] = rest / L[i * m + i];
    }
    for (npy_intp i = m - 1; i >= 0; i--) {
        for (npy_intp k = i + 1; k < m; k++) out[i] -= L[k * m + i] * out[k];
        out[i] /= L[i * m + i];
    }
}

/* What m readings say of biases and drifts since o onsets of each of s components: robust_filterpy.fusion._watch in C. */
static PyObject *weigh_lasting(PyObject *self, PyObject *arguments) {
    npy_intp lengths[AXES] = UNKNOWN_AXES;
    PyObject *moving, *given;
    const double *F, *H, *PH, *S, *y, *roots, *begins, *variances, *widths;
    const npy_intp *here;
    double seconds, *response, *evidence, *ages, *best;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOd", &moving, &given, &seconds)) return NULL;
    AXIS('e') = 2;
    int fine = take_arrays(given, "nn mn nm mm m m #m m s o", lengths,
                           (void *[]){&F, &H, &PH, &S, &y, &roots, &here, &begins, &variances, &widths}) &&
               take_arrays(moving, "!nc !ec !seo !s", lengths, (void *[]){&response, &evidence, &ages, &best});
    const npy_intp n = AXIS('n'), m = AXIS('m'), c = AXIS('c'), o = AXIS('o');
    for (npy_intp i = 0; fine && i < m; i++) fine = here[i] >= 0 && here[i] < AXIS('s');
    if (!fine || c != 2 * AXIS('s') * o) return refuse_arrays("weigh_lasting", "fusion._watch");
    double *const L = PyMem_Malloc((size_t)(m * m + n + 2 * m) * sizeof(double));
    if (!L) return PyErr_NoMemory();
    double *const ahead = L + m * m, *const d = ahead + n, *const said = d + m;
    fine = update_is_positive((int)m, S, 0, L);
    for (npy_intp at = 0; fine && at < c; at++) {
        const npy_intp owner = at / (2 * o), onset = at % o;
        double *const score = evidence + at, *const information = score + c, *const age = ages + at;
        const int drifts = at / o % 2 != 0;
        if (drifts) *age += seconds;
        for (npy_intp i = 0; i < n; i++) {
            ahead[i] = 0;
            for (npy_intp k = 0; k < n; k++) ahead[i] += F[i * n + k] * response[k * c + at];
        }
        for (npy_intp i = 0; i < m; i++)
            said[i] = d[i] = (here[i] == owner && roots[i] > 0 ? *age : 0) - real_dot((int)n, H + i * n, ahead);
        solve(m, L, said, said);
        for (npy_intp i = 0; i < n; i++) response[i * c + at] = ahead[i] + real_dot((int)m, PH + i * m, said);
        for (npy_intp i = 0; i < m; i++) said[i] = roots[i] * d[i];
        solve(m, L, said, said);
        for (npy_intp i = 0; i < m; i++) *score += y[i] * roots[i] * said[i], *information += d[i] * roots[i] * said[i];
        for (npy_intp i = 0; i < m; i++)
            if (here[i] == owner && (begins[i] == (double)onset || begins[i] < -1)) {
                if (drifts) *age = 0;
                for (npy_intp k = 0; k < n; k++) response[k * c + at] = 0;
                *score = *information = 0;
            }
        const double precision = (*age * *age + 1e-300) / variances[owner], whole = *information + precision;
        best[owner] = fmax(best[owner], 0.5 * (*score * *score / whole + log(precision / whole)) + widths[onset]);
    }
    PyMem_Free(L);
    return PyBool_FromLong(fine);
}

PyMethodDef hypothesis_functions[] = {
    {"weigh_lasting", weigh_lasting, METH_VARARGS, "Weigh lasting faults; see robust_filterpy.fusion._watch."},
    {"advance_hypotheses", advance_hypotheses, METH_VARARGS,
     "Take hypotheses through some stamps; see robust_filterpy.fusion._faults."},
    {NULL, NULL, 0, NULL}};

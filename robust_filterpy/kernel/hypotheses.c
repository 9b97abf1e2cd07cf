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
    const double y = z - real_dot(D, h, x);
    double seen = 0, peak = -INFINITY, total = 0, a = 0, b = 0;
    for (int i = 0; i < D; i++) seen += h[i] * (C[i] = real_dot(D, P + i * D, h));
    for (int k = 0; k < classes; k++) {
        inverses[k] = 1 / (seen + r * scales[k]);
        if (shares[k] > 0) peak = real_max(peak, -0.5 * y * y * inverses[k]);
    }
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
    PyObject *numbers, *x, *P, *sums, *given, *parts[10];
    Py_ssize_t first, last;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOOnn", &numbers, &x, &P, &sums, &given, &first, &last)) return NULL;
    if (take_objects(given, 10, parts) && is_array(parts[5], 3) && is_array(parts[7], 1) && is_array(x, 2)) {
        PyArrayObject *const H = (PyArrayObject *)parts[5];
        const npy_intp K = PyArray_DIM(H, 0), m = PyArray_DIM(H, 1), n = PyArray_DIM(H, 2), D = n + 1;
        const npy_intp N = PyArray_DIM((PyArrayObject *)x, 0), classes = PyArray_DIM((PyArrayObject *)parts[7], 0);
        const npy_intp lengths[10][3] = {{K, n, n}, {K, n, n}, {K, n}, {K}, {K, m}, {K, m, n}, {m}, {classes},
                                         {m, classes}, {m}};
        const int axes[10] = {3, 3, 2, 1, 2, 3, 1, 1, 2, 1};
        const double *found[10], *const rows = matrix_of(numbers, N, HYPOTHESIS_NUMBERS + classes);
        double *const means = writable(x, 2, (npy_intp[]){N, D});
        double *const covariances = writable(P, 3, (npy_intp[]){N, D, D});
        double *const logs = writable(sums, 1, &N);
        int fine = rows && means && covariances && logs && 0 <= first && first <= last && last <= K;
        for (int i = 0; i < 10; i++) fine = (found[i] = writable(parts[i], axes[i], lengths[i])) != NULL && fine;
        for (npy_intp i = 0; fine && i < N; i++) {
            const hypothesis *const one = (const hypothesis *)(rows + i * (HYPOTHESIS_NUMBERS + classes));
            fine = one->component >= -1 && one->component < (double)m && one->onset >= 0 && one->onset < (double)K &&
                   (one->component >= 0 || one->sees != 0);
        }
        if (fine) {
            const stretch s = {found[0], found[1], found[2], found[3], found[4], found[5], found[6], found[7], found[8],
                               found[9], first, last, m, (int)n, (int)classes};
            const size_t needed = (size_t)(3 * D * D + 3 * D + classes) + predict_work(D);
            double *const work = PyMem_Malloc(needed * sizeof(double));
            if (!work) return PyErr_NoMemory();
            for (npy_intp i = 0; i < N; i++)
                through_any((int)n, &s, (const hypothesis *)(rows + i * (HYPOTHESIS_NUMBERS + classes)), means + i * D,
                            covariances + i * D * D, logs + i, work);
            PyMem_Free(work);
            Py_RETURN_NONE;
        }
    }
    PyErr_SetString(PyExc_ValueError, "advance_hypotheses: expected C-contiguous arrays of float64 of matching shapes, "
                                      "as robust_filterpy.fusion._faults makes them");
    return NULL;
}

PyMethodDef hypothesis_functions[] = {
    {"advance_hypotheses", advance_hypotheses, METH_VARARGS,
     "Take hypotheses through some stamps; see robust_filterpy.fusion._faults."},
    {NULL, NULL, 0, NULL}};

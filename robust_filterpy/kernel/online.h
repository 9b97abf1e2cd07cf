/* What the steps of one filter share, whatever judges its measurements: attributes read, checked and set. */
#ifndef ROBUST_FILTERPY_ONLINE_H
#define ROBUST_FILTERPY_ONLINE_H

#include "glue.h"

/* x, (n,) or (n, 1), and P, symmetric. */
typedef struct {
    const double *x, *P;
    npy_intp n;
    int ndim; /* of x */
} filter_state;

/* What judges a filter's measurements: psi, or a mixture of what their noise may have been. */
typedef struct {
    int mixes;
    correction_rule bounded;
    learnt_rule mixture;
    PyObject *make; /* under a mixture: what makes a record */
} judge;
int take_judge(held *h, PyObject *filter, judge *by); /* 1, 0 if the kernel does not know it, or -1 with an exception */

int hold_all(held *h, PyObject *filter, const enum attribute *which, int count); /* 1, or -1 with an exception */
int take_filter(PyObject *dim_x, PyObject *x, PyObject *P, filter_state *s);
int set_state(held *h, PyObject *filter, PyObject *x, PyObject *P, enum attribute x_too, enum attribute P_too);
int take_control(PyObject *B, PyObject *u, npy_intp n, double **control);
int take_measurement(PyObject *object, npy_intp m, double *z);

/* Sensors by their places in z, or, of an H that is passed, by its rows: robust_filterpy.filters.states in C. */
#define ROWS_MOST 32 /* rows that are remembered */
#define ROWS_NOW 16  /* sensors at once */
typedef struct {
    npy_intp m, width;           /* m: 0 where places tell */
    npy_intp place[ROWS_NOW];
    PyObject *key[ROWS_NOW];     /* bytes of its row, NULL where the place tells */
    PyObject *places, *rows;     /* memories: an array, a dictionary */
    const double *begin;         /* (width) memory of a new sensor; NULL: zeros */
} sensor_rows;

/* What a measurement is taken up by, checked. */
typedef struct {
    npy_intp m;
    const double *H, *R, *M; /* M may be NULL */
    PyObject *memory;        /* of these sensors, as the filter has it or read by rows; NULL where nothing is learned */
    const double *learned;   /* its numbers, where it is bounded by psi */
    sensor_rows rows;        /* width and begin are given, width 0 where nothing is learned by rows */
} sensors;
/* given: R, H and M, or None for the filter's and for none; a slice for H: those rows of the filter's; own: dim_z, inv, R, H, memory, other sensors, the last two where
   something is learned. 1, 0, or -1 with an exception. */
int take_sensors(held *h, PyObject *const given[3], PyObject *const *own, npy_intp n, sensors *s);
/* Plain, own where given is None; NULL with an exception. */
PyObject *given_or(held *h, PyObject *given, PyObject *own);
int take_cross(sensors *s, npy_intp n, PyObject *M); /* M, or None; whether it is that */
int take_memory(const correction_rule *rule, sensors *s, PyObject *memory); /* of psi; whether it is that */

/* What moves a state. */
typedef struct {
    const double *F, *Q;
    PyObject *B;
    double alpha_sq;
} motion;
/* given: B, F and Q, or None for the filter's; own: its F, Q, alpha_sq, B. 1, 0, or -1 with an exception. */
int take_motion(held *h, PyObject *const given[3], PyObject *const own[4], npy_intp n, motion *found);

/* Write z, and z less its prediction or, where that is None, the innovation; given: these three. Whether all is ordinary. */
int take_difference(PyObject *const given[3], npy_intp m, double *z, double *y);

/* Give a filter what a measurement has left of it but x and P; memory: NULL where nothing is learned. 1, or -1. */
int set_measured(held *h, PyObject *filter, PyObject *z, PyObject *record, const sensor_rows *rows, PyObject *memory);

/* A function of the module for one step of a filter: call it with h and arguments, if there are so many. */
#define STEP(name, wanted, call, expected) \
    static PyObject *name(PyObject *self, PyObject *const *arguments, Py_ssize_t count) { \
        held h = {.count = 0}; \
        (void)self; \
        if (count == (wanted)) return answer(&h, call); \
        PyErr_SetString(PyExc_TypeError, expected); \
        return NULL; \
    }
int take_rule(learnt_rule *rule, PyObject *object); /* from the array of robust_filterpy.kernel.series.mixture_rule */
size_t correct_work(const learnt_rule *rule, npy_intp n, npy_intp m); /* of learnt_correct under this rule */
npy_intp memory_rows(const learnt_rule *rule, npy_intp m);             /* of m sensors */

#endif

/* What the steps of one filter share, whatever judges its measurements: attributes read, checked and set. */
#ifndef ROBUST_FILTERPY_ONLINE_H
#define ROBUST_FILTERPY_ONLINE_H

#include "glue.h"
#include "learnt.h"

typedef struct {
    const double *x, *P;
    npy_intp n;
    int ndim; /* of x */
} filter_state;

int hold_all(held *h, PyObject *filter, const enum attribute *which, int count); /* 1, or -1 with an exception */
npy_intp whole_number(PyObject *object);
int take_filter(PyObject *dim_x, PyObject *x, PyObject *P, filter_state *s);
int set_state(held *h, PyObject *filter, PyObject *x, PyObject *P, enum attribute x_too, enum attribute P_too);
int take_control(PyObject *B, PyObject *u, npy_intp n, double **control);
int take_measurement(PyObject *object, npy_intp m, double *z);
PyObject *given_or(held *h, PyObject *given, PyObject *own); /* plain; own where given is None; NULL with an exception */

/* Sensors by their places in z, or, of an H that is passed, by its rows: robust_filterpy.filters.states in C. */
#define ROWS_MOST 32 /* rows that are remembered */
#define ROWS_NOW 16  /* sensors at once */
typedef struct {
    npy_intp m, width;
    npy_intp place[ROWS_NOW];
    PyObject *key[ROWS_NOW]; /* bytes of its row, NULL where the place tells */
    PyObject *places, *rows;     /* memories: an array, a dictionary */
    const double *begin;         /* (width) memory of a new sensor; NULL: zeros */
} sensor_rows;
int take_rows(held *h, sensor_rows *c, const double *H, PyObject *own, npy_intp n); /* 1, 0, or -1 with an exception */
int read_rows(const sensor_rows *c, double *memory);
int set_rows(held *h, PyObject *filter, const sensor_rows *c, const double *memory); /* whether that went well */
int take_rule(learnt_rule *rule, PyObject *object); /* from the array of robust_filterpy.kernel.learnt.rule */
size_t correct_work(const learnt_rule *rule, npy_intp n, npy_intp m); /* of learnt_correct under this rule */
npy_intp memory_rows(const learnt_rule *rule, npy_intp m);             /* of m sensors */

#endif

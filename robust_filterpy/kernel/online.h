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
int take_rule(learnt_rule *rule, PyObject *object); /* from the array of robust_filterpy.kernel.learnt.rule */

#endif

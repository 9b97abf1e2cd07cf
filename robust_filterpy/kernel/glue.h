/* What the functions of the extension share: arrays taken and made, attributes read and set.

   A function of the extension returns True where it did the work, False where the definition is to do it (nothing has
   changed then), and NULL with an exception that Python code raised on the way. */
#ifndef ROBUST_FILTERPY_GLUE_H
#define ROBUST_FILTERPY_GLUE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NPY_NO_DEPRECATED_API NPY_1_23_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL robust_filterpy_numpy
#ifndef ROBUST_FILTERPY_MODULE
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

#include "series.h"

/* Attributes by name; the same list makes the enumeration and the interned strings. */
#define ATTRIBUTES(X) \
    X(x) X(P) X(F) X(Q) X(H) X(R) X(B) X(z) X(dim_x) X(dim_z) X(inv) X(x_prior) X(P_prior) X(x_post) X(P_post) \
    X(_alpha_sq) X(rule) X(_memory) X(_other_sensors) X(_last) X(_y) X(_S) X(_SI) X(_K) X(_log_likelihood) X(_likelihood) X(_mahalanobis) \
    X(_policy) X(_kept)
enum attribute {
#define ATTRIBUTE(name) AT_##name,
    ATTRIBUTES(ATTRIBUTE)
#undef ATTRIBUTE
    ATTRIBUTE_COUNT
};
extern PyObject *attribute_names[ATTRIBUTE_COUNT];
extern PyObject *numpy_inverse; /* numpy.linalg.inv, filterpy's default for inv */

/* References held during a call: no array can go away while it is worked on. */
#define HELD_MOST 128
typedef struct {
    PyObject *objects[HELD_MOST];
    int count, failed; /* failed: one of them is not there, with an exception */
} held;

PyObject *hold(held *h, PyObject *object);                           /* takes the reference over */
PyObject *hold_attribute(held *h, PyObject *owner, enum attribute which);
PyObject *answer(held *h, int outcome);                              /* 1 True, 0 False, -1 NULL; lets go of all */
int set_attribute(PyObject *owner, enum attribute which, PyObject *value);

/* An exact ndarray of integers, of smaller floats or in another order as one of float64 in C order, which is held; anything
   else as it is. NULL with an exception. */
PyObject *as_plain(held *h, PyObject *object);
/* A number that no code of the user's has a part in: of Python, of numpy, an array without axes; whether it is one. */
int number_of(PyObject *object, double *found);
/* A matrix (n, n), or of a number that times the identity, which is held; NULL if it is neither, or with an exception. */
const double *covariance_of(held *h, PyObject *object, npy_intp n);
int is_array(PyObject *object, int ndim);                            /* an exact ndarray with so many axes */

/* The numbers of an exact ndarray of float64, C-contiguous, with these dimensions; NULL if it is anything else. */
const double *matrix_of(PyObject *object, npy_intp rows, npy_intp columns);
const double *vector_of(PyObject *object, npy_intp length);          /* also (length, 1) */
/* Arrays of a tuple by their axes, a word for each, as "!snn ?.skm": letters, whose lengths stand in `lengths`, 'a' first,
   where one that is not yet known, below 0, becomes that of the array. '!': it is written into; '?': it may be None,
   and its place then stays as it is; '#': it has integers as long as a pointer, '%': ints. A place is a pointer to
   the numbers or, of '.', a series_matrices, whose first two axes may have the length 1 and any strides. Whether all
   is so; objects behind the last word are left aside. */
#define AXES 26
int take_arrays(PyObject *tuple, const char *words, npy_intp lengths[AXES], void *const *places);
#define AXIS(letter) lengths[(letter) - 'a']
#define UNKNOWN_AXES \
    { -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1 }
PyObject *refuse_arrays(const char *function, const char *module); /* an error that names who makes them; NULL */
/* A new array, with these numbers or, where that is NULL, any, which is held; NULL with an exception. */
PyObject *array_of(held *h, const double *numbers, int ndim, npy_intp first, npy_intp second, npy_intp third);
double *numbers_of(PyObject *array);

/* Whether a matrix is what the definition takes for one, without a second thought. */
int is_symmetric(const double *a, npy_intp n);
int is_covariance(const double *a, npy_intp n, double *work);        /* positive semidefinite; work: n n */
int all_finite(const double *a, npy_intp count);

/* The options of a filter from the array that carries them (see robust_filterpy.kernel.series.rule): 1 if they are that. */
int rule_of(PyObject *object, correction_rule *rule);
/* How that array begins: psi with its parameters, E[psi']. */
typedef struct {
    double psi, a, b, c, scaling, information, expected, normalizer, patience;
} rule_numbers;
#define RULE_NUMBERS ((npy_intp)(sizeof(rule_numbers) / sizeof(double)))
int rule_of_numbers(const double *numbers, correction_rule *rule);
/* That of a mixture, as robust_filterpy.kernel.series.mixture_rule makes it; workspace of learnt_correct under it, and rows
   of the memory of m sensors. */
int take_rule(learnt_rule *rule, PyObject *object);
size_t correct_work(const learnt_rule *rule, npy_intp n, npy_intp m);
npy_intp memory_rows(const learnt_rule *rule, npy_intp m);
/* psi(e) and its slope, or rho(e), by the methods of a `Choices`; NaN once one has raised. */
double call_choices(void *choices, double e, double *slope);
/* The outcome of a step whose psi may have been Python's: -1 where that has raised, 0 where the definition is to ask it. */
int called_outcome(int outcome);

/* The groups of functions that make the module: a new one is named here and in the list of module.c. */
extern PyMethodDef hypothesis_functions[], series_functions[], smoother_functions[], step_functions[], tracker_functions[];

/* Workspace of a call: on the stack up to here, else from the heap, and then to be freed. */
#define STACK_WORK 2048
double *work_of(double *stack, size_t count);
void work_done(const double *stack, double *work);

#endif

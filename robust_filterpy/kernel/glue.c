/* What glue.h declares. */
#include "glue.h"

PyObject *hold(held *h, PyObject *object) {
    if (object) h->objects[h->count++] = object;
    else h->failed = 1;
    return object;
}

PyObject *hold_attribute(held *h, PyObject *owner, enum attribute which) {
    return hold(h, PyObject_GetAttr(owner, attribute_names[which]));
}

PyObject *answer(held *h, int outcome) {
    while (h->count) Py_DECREF(h->objects[--h->count]);
    if (outcome < 0) return NULL;
    return outcome > 1 ? PyLong_FromLong(outcome) : PyBool_FromLong(outcome);
}

int set_attribute(PyObject *owner, enum attribute which, PyObject *value) {
    return PyObject_SetAttr(owner, attribute_names[which], value);
}

int take_objects(PyObject *tuple, int count, PyObject **found) {
    if (!PyTuple_Check(tuple) || PyTuple_Size(tuple) != count) return 0;
    for (int i = 0; i < count; i++) found[i] = PyTuple_GetItem(tuple, i);
    return 1;
}

int is_array(PyObject *object, int ndim) {
    return PyArray_CheckExact(object) && PyArray_NDIM((PyArrayObject *)object) == ndim;
}

/* Whether an object is an exact ndarray of float64 in C order with so many axes; read only, if that serves. */
static int is_plain(PyObject *object, int ndim, int writable) {
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!is_array(object, ndim) || PyArray_TYPE(array) != NPY_DOUBLE) return 0;
    return writable ? PyArray_ISCARRAY(array) : PyArray_ISCARRAY_RO(array);
}

PyObject *as_plain(held *h, PyObject *object) {
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!PyArray_CheckExact(object)) return object;
    const int type = PyArray_TYPE(array), small = type == NPY_HALF || type == NPY_FLOAT;
    if (type != NPY_DOUBLE && !small && !PyTypeNum_ISINTEGER(type)) return object;
    if (type == NPY_DOUBLE && PyArray_ISCARRAY_RO(array)) return object;
    /* Of other bytes than the machine's, and of integers, this is what arithmetic with a float64 makes. */
    return hold(h, PyArray_FromAny(object, PyArray_DescrFromType(NPY_DOUBLE), 0, 0, NPY_ARRAY_CARRAY_RO, NULL));
}

int number_of(PyObject *object, double *found) {
    if (PyFloat_Check(object)) {
        *found = PyFloat_AsDouble(object);
        return 1;
    }
    if (is_array(object, 0) && PyArray_TYPE((PyArrayObject *)object) == NPY_DOUBLE &&
        PyArray_ISCARRAY_RO((PyArrayObject *)object)) {
        *found = *(double *)PyArray_DATA((PyArrayObject *)object);
        return 1;
    }
    /* numpy counts durations among the integers. */
    if ((PyArray_IsScalar(object, Integer) && !PyArray_IsScalar(object, Timedelta)) || PyArray_IsScalar(object, Float) ||
        PyArray_IsScalar(object, Half)) {
        PyArray_Descr *const as = PyArray_DescrFromType(NPY_DOUBLE);
        const int fine = PyArray_CastScalarToCtype(object, found, as) == 0;
        Py_DECREF(as);
        if (!fine) PyErr_Clear();
        return fine;
    }
    if (!PyLong_CheckExact(object)) return 0;
    *found = PyLong_AsDouble(object);
    if (*found != -1 || !PyErr_Occurred()) return 1;
    /* Larger than a float can be. */
    PyErr_Clear();
    return 0;
}

const double *covariance_of(held *h, PyObject *object, npy_intp n) {
    const double *const whole = matrix_of(object, n, n);
    double variance, *found;
    PyObject *made;
    if (whole || n < 1 || !number_of(object, &variance)) return whole;
    made = array_of(h, NULL, 2, n, n, 0);
    if (!made) return NULL;
    found = numbers_of(made);
    for (npy_intp i = 0; i < n * n; i++) found[i] = i % (n + 1) ? 0 : variance;
    return found;
}

double *numbers_of(PyObject *array) { return (double *)PyArray_DATA((PyArrayObject *)array); }

/* The numbers, if all axes are so long. */
static double *sized(PyObject *object, int ndim, const npy_intp *shape, int writable) {
    if (!is_plain(object, ndim, writable)) return NULL;
    for (int i = 0; i < ndim; i++)
        if (PyArray_DIM((PyArrayObject *)object, i) != shape[i]) return NULL;
    return numbers_of(object);
}

const double *matrix_of(PyObject *object, npy_intp rows, npy_intp columns) {
    return sized(object, 2, (npy_intp[]){rows, columns}, 0);
}

const double *vector_of(PyObject *object, npy_intp length) {
    const npy_intp shape[2] = {length, 1};
    return sized(object, is_array(object, 2) ? 2 : 1, shape, 0);
}

double *writable(PyObject *object, int ndim, const npy_intp *shape) { return sized(object, ndim, shape, 1); }

int take_matrices(series_matrices *found, PyObject *object, npy_intp series, npy_intp steps, npy_intp rows,
                  npy_intp columns) {
    const npy_intp one = (npy_intp)sizeof(double), shape[2] = {rows, columns};
    const int ndim = rows < 0 ? 2 : columns ? 4 : 3;
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!is_array(object, ndim) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISBEHAVED_RO(array)) return 0;
    npy_intp apart = one, axes[2];
    for (int i = ndim - 1; i > 1; apart *= shape[i - 2], i--)
        if (PyArray_DIM(array, i) != shape[i - 2] || (shape[i - 2] > 1 && PyArray_STRIDE(array, i) != apart)) return 0;
    for (int i = 0; i < 2; i++) {
        axes[i] = PyArray_DIM(array, i) > 1 ? PyArray_STRIDE(array, i) : 0;
        if (PyArray_DIM(array, i) != 1 && (i ? PyArray_DIM(array, 1) < steps : PyArray_DIM(array, 0) != series)) return 0;
        if (axes[i] % one) return 0;
    }
    *found = (series_matrices){numbers_of(object), axes[0] / one, axes[1] / one};
    return 1;
}

npy_intp *integers(PyObject *object, const npy_intp rows, const npy_intp columns) {
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!is_array(object, columns < 0 ? 1 : 2) || PyArray_TYPE(array) != NPY_INTP || !PyArray_ISCARRAY(array) || (rows >= 0 && PyArray_DIM(array, 0) != rows) ||
        (columns >= 0 && PyArray_DIM(array, 1) != columns))
        return NULL;
    return PyArray_DATA(array);
}

int take_room(double **found, PyObject *object, npy_intp series, npy_intp rows, npy_intp width) {
    const npy_intp shape[3] = {series, rows, width};
    *found = NULL;
    return object == Py_None || (*found = writable(object, 3, shape)) != NULL;
}

PyObject *array_of(held *h, const double *numbers, int ndim, npy_intp first, npy_intp second, npy_intp third) {
    npy_intp shape[3] = {first, second, third};
    PyObject *const found = hold(h, PyArray_SimpleNew(ndim, shape, NPY_DOUBLE));
    if (found && numbers) memcpy(numbers_of(found), numbers, (size_t)PyArray_NBYTES((PyArrayObject *)found));
    return found;
}

int is_symmetric(const double *a, npy_intp n) {
    for (npy_intp i = 0; i < n; i++)
        for (npy_intp j = 0; j < i; j++) {
            const double above = a[j * n + i], below = a[i * n + j];
            if (above != below && !(fabs(above - below) <= 1e-13 * (fabs(above) + fabs(below)))) return 0;
        }
    return 1;
}

int is_covariance(const double *a, npy_intp n, double *work) {
    return is_symmetric(a, n) && update_is_positive((int)n, a, -1, work);
}

int all_finite(const double *a, npy_intp count) {
    double check = 0;
    /* Not the sum: x - x is 0 where x is a number. */
    for (npy_intp i = 0; i < count; i++) check += a[i] - a[i];
    return check == 0;
}

int rule_of_numbers(const double *numbers, correction_rule *rule) {
    const rule_numbers *const of = (const rule_numbers *)numbers;
    /* Also of NaN no integer can be made. */
    if (!(of->psi >= PSI_LINEAR && of->psi <= PSI_STUDENT_T && of->scaling >= SCALING_LEARNT &&
          of->scaling <= SCALING_BOUNDED && of->information >= INFORMATION_REALIZED && of->information <= INFORMATION_WEIGHT &&
          of->patience >= 0 && of->patience <= INT_MAX))
        return 0;
    *rule = (correction_rule){{(int)of->psi, of->a, of->b, of->c, NULL, NULL}, (int)of->scaling, (int)of->information,
                              of->expected, of->normalizer, NULL, (int)of->patience};
    return 1;
}

int rule_of(PyObject *object, correction_rule *rule) {
    const double *const each = vector_of(object, RULE_NUMBERS);
    const double *const joint = each ? NULL : vector_of(object, RULE_NUMBERS + JOINT_MOST);
    if ((!each && !joint) || !rule_of_numbers(each ? each : joint, rule)) return 0;
    if (joint) rule->joint = joint + RULE_NUMBERS;
    /* What joint.h can do. */
    return !joint || (rule->scaling <= SCALING_INNOVATION && rule->information != INFORMATION_EXPECTED);
}

double call_choices(void *context, double e, double *slope) {
    PyObject *const found = PyErr_Occurred() ? NULL : PyObject_CallMethod(context, slope ? "psi_of" : "rho_of", "d", e);
    double bounded = NAN;
    if (slope) *slope = NAN;
    if (found && !(slope ? PyArg_ParseTuple(found, "dd", &bounded, slope) : number_of(found, &bounded))) bounded = NAN;
    Py_XDECREF(found);
    return bounded;
}

int called_outcome(int outcome) {
    if (!PyErr_Occurred()) return outcome;
    if (!PyErr_ExceptionMatches(PyExc_FloatingPointError)) return -1;
    /* The definition asks again without numpy's errors. */
    PyErr_Clear();
    return 0;
}

double *work_of(double *stack, size_t count) {
    if (count <= STACK_WORK) return stack;
    double *const found = PyMem_Malloc(count * sizeof(double));
    if (!found) PyErr_NoMemory();
    return found;
}

void work_done(const double *stack, double *work) {
    if (work && work != stack) PyMem_Free(work);
}

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

int is_array(PyObject *object, int ndim) {
    return PyArray_CheckExact(object) && PyArray_NDIM((PyArrayObject *)object) == ndim;
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

/* The numbers of an exact ndarray of float64 in C order, with these axes. */
static const double *plain_of(PyObject *object, int ndim, npy_intp first, npy_intp second) {
    PyArrayObject *const array = (PyArrayObject *)object;
    if (!is_array(object, ndim) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISCARRAY_RO(array)) return NULL;
    if ((ndim > 0 && PyArray_DIM(array, 0) != first) || (ndim > 1 && PyArray_DIM(array, 1) != second)) return NULL;
    return numbers_of(object);
}

const double *matrix_of(PyObject *object, npy_intp rows, npy_intp columns) {
    return plain_of(object, 2, rows, columns);
}

const double *vector_of(PyObject *object, npy_intp length) {
    return plain_of(object, is_array(object, 1) ? 1 : 2, length, 1);
}

int number_of(PyObject *object, double *found) {
    if (PyFloat_Check(object)) {
        *found = PyFloat_AsDouble(object);
        return 1;
    }
    const double *const single = plain_of(object, 0, 0, 0);
    if (single) {
        *found = *single;
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

int take_arrays(PyObject *tuple, const char *words, npy_intp lengths[AXES], void *const *places) {
    const npy_intp one = (npy_intp)sizeof(double);
    for (Py_ssize_t at = 0; *words; at++) {
        PyObject *const object = PyTuple_Check(tuple) && at < PyTuple_Size(tuple) ? PyTuple_GetItem(tuple, at) : NULL;
        PyArrayObject *const array = (PyArrayObject *)object;
        int written = 0, optional = 0, strided = 0, type = NPY_DOUBLE;
        for (; *words < 'a'; words++) {
            written |= *words == '!', optional |= *words == '?', strided |= *words == '.';
            if (*words == '#' || *words == '%') type = *words == '#' ? NPY_INTP : NPY_INT;
        }
        const char *const axes = words;
        while (*words >= 'a') words++;
        if (optional && object == Py_None) continue;
        if (!object || !is_array(object, (int)(words - axes)) || PyArray_TYPE(array) != type) return 0;
        if (!PyArray_CHKFLAGS(array, (strided ? NPY_ARRAY_ALIGNED : NPY_ARRAY_CARRAY_RO) |
                                         (written ? NPY_ARRAY_WRITEABLE : 0)) || PyArray_ISBYTESWAPPED(array))
            return 0;
        npy_intp apart[2] = {0, 0}, inner = one;
        for (int i = (int)(words - axes) - 1; i >= 0; i--) {
            const npy_intp length = PyArray_DIM(array, i), stride = length > 1 ? PyArray_STRIDE(array, i) : 0;
            if (AXIS(axes[i]) < 0) AXIS(axes[i]) = length;
            if (length != AXIS(axes[i]) && !(strided && i < 2 && length == 1)) return 0;
            if (strided && (i < 2 ? stride % one : stride && stride != inner)) return 0;
            if (i < 2) apart[i] = stride / one;
            inner *= length;
        }
        void *const data = PyArray_DATA(array);
        if (strided) *(series_matrices *)places[at] = (series_matrices){data, apart[0], apart[1]};
        else memcpy(places[at], &data, sizeof data);
    }
    return 1;
}

PyObject *refuse_arrays(const char *function, const char *module) {
    return PyErr_Format(PyExc_ValueError, "%s: expected C-contiguous arrays of float64 of matching shapes, as "
                                          "robust_filterpy.%s makes them", function, module);
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

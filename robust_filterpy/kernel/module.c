/* The extension module: its functions are in one file for each group, and here are put together. */
#define ROBUST_FILTERPY_MODULE
#include "glue.h"

PyObject *attribute_names[ATTRIBUTE_COUNT];
PyObject *numpy_inverse;

static PyMethodDef *const groups[] = {hypothesis_functions, series_functions, smoother_functions, step_functions,
                                     tracker_functions};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_extension", "The kernel: see robust_filterpy.kernel.",
                                        -1, NULL, NULL, NULL, NULL, NULL};

static int intern_names(void) {
    static const char *const names[] = {
#define ATTRIBUTE(name) #name,
        ATTRIBUTES(ATTRIBUTE)
#undef ATTRIBUTE
    };
    for (int i = 0; i < ATTRIBUTE_COUNT; i++) {
        attribute_names[i] = PyUnicode_InternFromString(names[i]);
        if (!attribute_names[i]) return -1;
    }
    return 0;
}

static int find_inverse(void) {
    PyObject *const room = PyImport_ImportModule("numpy.linalg");
    if (!room) return -1;
    numpy_inverse = PyObject_GetAttrString(room, "inv");
    Py_DECREF(room);
    return numpy_inverse ? 0 : -1;
}

PyMODINIT_FUNC PyInit__extension(void) {
    PyObject *module;
    import_array();
    if (intern_names() < 0 || find_inverse() < 0) return NULL;
    module = PyModule_Create(&definition);
    for (size_t i = 0; module && i < sizeof groups / sizeof *groups; i++)
        if (PyModule_AddFunctions(module, groups[i]) < 0) Py_CLEAR(module);
    if (module && PyModule_AddIntConstant(module, "built_from", ROBUST_FILTERPY_BUILT_FROM) < 0) Py_CLEAR(module);
    return module;
}

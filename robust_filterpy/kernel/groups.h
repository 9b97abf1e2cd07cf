/* The groups of functions that make the module: a new one is named here and in the list of module.c. */
#ifndef ROBUST_FILTERPY_GROUPS_H
#define ROBUST_FILTERPY_GROUPS_H

#include "glue.h"

extern PyMethodDef series_functions[];
extern PyMethodDef smoother_functions[];
extern PyMethodDef step_functions[];
extern PyMethodDef tracker_functions[];

#endif

/*
 * $title
 *
 * Written by robust_filterpy $version; export again rather than edit. To step the filter:
 *
 *     #include "$name.h"
 *
 *     ${name}_state state = ${name}_start;
 *     ...
 *     ${name}_predict(&${name}_default, &state$example_motion$example_u);
 *     ${name}_update(&${name}_default, &state$example_sensor, z, NULL);
 *
 * $remark
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_STATES $n
#define ${NAME}_SENSORS $m
$inputs_define

typedef $real ${name}_real;

/* What a call found; whatever is not ${NAME}_OK has changed nothing. */
typedef enum {
    ${NAME}_OK = 0,
    ${NAME}_BAD_ARGUMENT = 1, /* a null pointer, an input that is not finite, a measurement of $largest or more */
    ${NAME}_SINGULAR = 2,     /* S = H P H' + R has no inverse, or a sensor is told by the others to the last digit */
    ${NAME}_INDEFINITE = 3,   /* scaling "unit" would make P indefinite, or singular */
    ${NAME}_NOT_FINITE = 4    /* x or P would overflow, or P lose a variance in rounding$or_functions */
} ${name}_status;

$functions

/* The model; matrices are flat, row by row. */
typedef struct {
    ${name}_real F[$n * $n]; /* x(k+1) = F x(k) + B u(k) + w(k) */
$control_field
    ${name}_real Q[$n * $n]; /* covariance of w */
$sensor_field
    ${name}_real R[$m * $m]; /* covariance of v */
$alpha_field
$influence_fields
$expected_field
} ${name}_model;

/* What moves. */
typedef struct {
    ${name}_real x[$n];
    ${name}_real P[$n * $n]; /* covariance of x, symmetric */
$memory_field
$copies_fields
} ${name}_state;

/* What an update found of each component. */
typedef struct {
    ${name}_real y[$m];      /* innovation $innovation, 0 where missing */
$shown_fields
} ${name}_shown;

extern const ${name}_model ${name}_default;
extern const ${name}_state ${name}_start;

$predict_comment
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state$motion_parameter$predict_parameter);

/* Correct the state by a measurement z; what it found goes into `shown`, unless that is NULL. */
${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state$sensor_parameter, const ${name}_real z[$m],
                              ${name}_shown *shown);

#ifdef __cplusplus
}
#endif

#endif

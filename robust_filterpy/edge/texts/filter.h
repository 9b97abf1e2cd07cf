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
#define ${NAME}_STATES $n
#define ${NAME}_SENSORS $m
$?inputs #define ${NAME}_INPUTS $inputs

typedef $real ${name}_real;

/* What a call found; whatever is not ${NAME}_OK has changed nothing. */
typedef enum {
    ${NAME}_OK = 0,
    ${NAME}_BAD_ARGUMENT = 1, /* a null pointer, an input that is not finite, a measurement of $largest or more */
    ${NAME}_SINGULAR = 2,     /* S = H P H' + R has no inverse, or a sensor follows from the others to the last digit */
    ${NAME}_INDEFINITE = 3,   /* scaling "unit" would make P indefinite, or singular */
$!extended     ${NAME}_NOT_FINITE = 4    /* x or P would overflow, or P lose a variance in rounding */
$?extended     ${NAME}_NOT_FINITE = 4    /* x or P would overflow, or P lose a variance in rounding;
$?extended                                  or one of your functions wrote what is not */
} ${name}_status;

$?extended $include functions.h

/* The model; matrices are flat, row by row. */
typedef struct {
    ${name}_real F[$n * $n]; /* x(k+1) = F x(k) + B u(k) + w(k) */
$?inputs     ${name}_real B[${NAME}_STATES * $inputs];
    ${name}_real Q[$n * $n]; /* covariance of w */
$!extended     ${name}_real H[$m * $n]; /* z(k) = H x(k) + v(k) */
    ${name}_real R[$m * $m]; /* covariance of v */
$?fades     ${name}_real alpha_sq; /* P is multiplied by it at each prediction */
$influence_fields
$?expected     ${name}_real expected; /* E[psi'], which belongs to the psi above */
} ${name}_model;

/* What moves. */
typedef struct {
    ${name}_real x[$n];
    ${name}_real P[$n * $n]; /* covariance of x, symmetric */
$?learns     ${name}_real memory[$m * $width]; /* of each sensor's typical innovations */
$?models     /* The models that x and P are merged from; who writes x or P writes them all. */
$?models     ${name}_real means[$models * $n];
$?models     ${name}_real covariances[$models * $n * $n];
$?models     ${name}_real belief[$parts * $n]; /* for each state: how likely each model, a jump; part */
$?mixes     ${name}_real memory[$m * $width]; /* of each sensor; the first is the factor of its R */
} ${name}_state;

/* What an update found of each component. */
typedef struct {
    ${name}_real y[$m];      /* innovation $innovation, 0 where missing */
$!mixes     ${name}_real e[$m];      /* the same, standardized */
$!mixes     ${name}_real weight[$m]; /* psi(e)/e: 1 is full trust; NaN where missing */
$?mixes     ${name}_real outlying[$m]; /* probability that it was an outlier, 0 where missing */
$?mixes     ${name}_real weight[$m];   /* 1 is full trust; NaN where missing */
} ${name}_shown;

$!extended $!inputs /* Predict the next state. */
$!extended $?inputs /* Predict the next state, with the control input u, or without where u is NULL. */
$?extended $!inputs /* Predict the next state by f; $or by F, where motion is NULL. */
$?extended $?inputs /* Predict the next state by f; $or by F, where motion is NULL, and then with the control input u, unless that is NULL. */
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state$motion_parameter$predict_parameter);

/* Correct the state by a measurement z; what it found goes into `shown`, unless that is NULL. */
${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state$sensor_parameter, const ${name}_real z[$m],
                              ${name}_shown *shown);

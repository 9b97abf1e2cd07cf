/*
 * $title
 *
 * Written by robust_filterpy $version; export again rather than edit. To track the parameters
 *
 *     theta = [$names]
 *
 * of y(k) = phi(k)' theta + v(k), sample by sample:
 *
 *     #include "$name.h"
 *
 *     ${name}_state state = ${name}_start;
 *     ...
 *     ${name}_update(&${name}_default, &state, y, u, NULL);
 *
 * NaN in y is a sample that is missing. For another threshold at run time change a copy of ${name}_default.
 */
#define ${NAME}_PARAMETERS $n
#define ${NAME}_INPUTS $inputs

typedef $real ${name}_real;

/* What a call found; whatever is not ${NAME}_OK has changed nothing. */
typedef enum {
    ${NAME}_OK = 0,
    ${NAME}_BAD_ARGUMENT = 1, /* a null pointer, an infinite output, an input that is not finite or too large */
    ${NAME}_SINGULAR = 2,     /* the variance of the innovation is not positive */
    ${NAME}_INDEFINITE = 3,   /* scaling "unit" would make P indefinite */
    ${NAME}_NOT_FINITE = 4    /* theta, P or the regressor would overflow */
} ${name}_status;

/* The model; matrices are flat, row by row. */
typedef struct {
$?has_F     ${name}_real F[$has_F]; /* theta(k+1) = F theta(k) + w(k) */
$?has_Q     ${name}_real Q[$has_Q]; /* covariance of a step of theta */
$?has_alpha_sq     ${name}_real alpha_sq; /* 1/forgetting: P is multiplied by it at each sample */
$?has_windup     ${name}_real windup; /* trace from which on P grows no more */
$?has_R_memory     ${name}_real R_memory; /* number of samples that R remembers */
$?has_R_mean     ${name}_real R_mean; /* mean of min(e^2, 4) where R is right */
$?has_R_rounding     ${name}_real R_rounding; /* steps of the sensor; R is what they make at least */
$!follows     ${name}_real R; /* variance of the ordinary noise */
$?has_centre     ${name}_real centre; /* taken off y, so that the constant is small */
$influence_fields
$?expected     ${name}_real expected; /* E[psi'], which belongs to the psi above */
} ${name}_model;

/* What moves; past signals newest first. */
typedef struct {
$?has_theta     ${name}_real theta[$has_theta]; /* the parameters */
$?has_P     ${name}_real P[$has_P]; /* their covariance, symmetric */
$?follows     ${name}_real R; /* variance of the ordinary noise */
$?has_R_samples     ${name}_real R_samples; /* how many samples R stands on */
$?has_readings     ${name}_real readings[$has_readings]; /* of the steps of y */
$?has_outputs     ${name}_real outputs[$has_outputs]; /* outputs, then disturbances, as they stand in phi, with their minus sign */
$?has_measured     ${name}_real measured[$has_measured]; /* the same, as they were measured */
$?has_inputs     ${name}_real inputs[$has_inputs]; /* inputs */
$?has_residuals     ${name}_real residuals[$has_residuals]; /* residuals */
$?has_undisturbed     ${name}_real undisturbed[$has_undisturbed]; /* what the inputs alone did, with its minus sign */
$?has_prefiltered     ${name}_real prefiltered[$has_prefiltered]; /* past phi through 1/F */
$?has_gradients     ${name}_real gradients[$has_gradients]; /* derivatives of past predictions */
    int32_t enabled; /* 0 freezes theta and P, while predictions go on */
} ${name}_state;

/* What a sample showed. */
typedef struct {
    ${name}_real prediction; /* phi' theta before the sample */
    ${name}_real residual;   /* y - prediction; NaN where missing */
    ${name}_real weight;     /* psi(e)/e: 1 is full trust; NaN where missing */
    int32_t guard;           /* h > 0: the step was halved h times; -1: it was not taken */
} ${name}_sample;

/* Take one sample: y(k), and u(k) of $inputs inputs; what it showed goes into `sample`, unless that is NULL. */
${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, ${name}_real y,
                              const ${name}_real u[$inputs_or_one], ${name}_sample *sample);

#define N ${NAME}_STATES
#define M ${NAME}_SENSORS
#define CLASSES $K

/* Factors of Q that are weighed, factors of R, and a sensor's memory at first. */
static const real process[$q] = {
$process
};
static const real scales[CLASSES] = {
$scales
};
static const real begin[learnt_width(CLASSES)] = {
$begin
};
static const learnt_rule rule = {
    $q, CLASSES, process, scales, begin,
$numbers, $adapts, NULL, 0, 0, NULL
};

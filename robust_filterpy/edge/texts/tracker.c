
#define N ${NAME}_PARAMETERS

/* Where everything stands in phi. */
$?start static const int start[] = {$start};
$?used static const int used[] = {$used};
$?source static const int source[] = {$source};
static const tracker_layout layout = {$layout};

/* What the kernel says of a sample that it declines. */
static const ${name}_status refusals[] = {${NAME}_NOT_FINITE, ${NAME}_SINGULAR, ${NAME}_INDEFINITE};

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, ${name}_real y,
                              const ${name}_real u[$inputs_or_one], ${name}_sample *sample)
{
    correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0, NULL, 0};
    tracker_rule how = {{{0, 0, 0, 0, NULL, NULL}, 0, 0, 1, 0, NULL, 0},
                         $filtered, $guard, $cleans, 0, $judges, 1, NULL, NULL, 1, 0};
    tracker_state next = {0};
    tracker_sample found = {0};
    real work[tracker_work(N)];
    tracker_scale scale;
    if (model == NULL || state == NULL || ($inputs > 0 && u == NULL) || real_abs(y) > REAL_MAX)
        return ${NAME}_BAD_ARGUMENT;
    for (int i = 0; i < $inputs; i++)
        if (!(real_abs(u[i]) <= TRACKER_LARGEST)) return ${NAME}_BAD_ARGUMENT;
$include rule.c
    how.correction = rule;
    how.learns = state->enabled;
    how.Q = model->Q;
$?moves     how.F = model->F;
$?fades     how.alpha_sq = model->alpha_sq;
$?fades     how.windup = model->windup;
$fields
$?has_readings     next.readings = (tracker_readings *)state->readings;
$!follows     scale = (tracker_scale){model->R, 0, 1, 0, 0};
$?follows     scale = (tracker_scale){state->R, state->R_samples, model->R_mean, model->R_memory, model->R_rounding};
    next.scale = &scale;
    y = ((y == y) ? tracker_bounded(y) : y)$minus_centre;
    if (!tracker_step(&layout, N, &how, &next, y, u, (real)NAN, &found, work)) return refusals[found.refused];
$?follows     state->R = scale.R;
$?follows     state->R_samples = scale.samples;
    if (sample != NULL) {
        sample->prediction = found.prediction$plus_centre;
        sample->residual = found.residual;
        sample->weight = found.weight;
        sample->guard = found.guard;
    }
    return ${NAME}_OK;
}

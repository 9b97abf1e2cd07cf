$include classes.c
#define MODELS $models

static learnt_state models_of(${name}_state *const state)
{
    const learnt_state s = {state->means, state->covariances, state->belief, state->memory};
    return s;
}

${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state$predict_parameter)
{
    ${name}_state next;
    learnt_state s;
    real work[learnt_predict_work(N, MODELS)];
$?inputs     real control[N] = {0};
    if ((model == NULL) || (state == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$?inputs $include control.c
    next = *state;
    s = models_of(&next);
    if (!learnt_has_parts(N, &rule, &s)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    learnt_predict(N, &rule, &s, model->F, model->Q, $control_given, $alpha_sq, work);
    if (!learnt_merge(N, &rule, &s, next.x, next.P, work)) {
        return ${NAME}_NOT_FINITE;
    }
    *state = next;
    return ${NAME}_OK;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, const ${name}_real z[$m],
                              ${name}_shown *shown)
{
    ${name}_state next;
    learnt_state s;
    real work[learnt_correct_work(N, M, MODELS, CLASSES)], weights[M], outlying[M], likelihood = 0;
    if ((model == NULL) || (state == NULL) || (z == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    for (int i = 0; i < M; i++) {
        if ((z[i] == z[i]) && !(real_abs(z[i]) < REAL_ORDINARY)) {
            return ${NAME}_BAD_ARGUMENT;
        }
    }
    next = *state;
    s = models_of(&next);
    if (!learnt_has_parts(N, &rule, &s)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    if (learnt_correct(N, M, &rule, &s, z, z, model->H, model->R, NULL, weights, outlying, &likelihood, work) < 0) {
        return ${NAME}_SINGULAR;
    }
    if (!learnt_merge(N, &rule, &s, next.x, next.P, work)) {
        return ${NAME}_NOT_FINITE;
    }
    for (int i = 0; (i < M) && (shown != NULL); i++) {
        shown->y[i] = (z[i] == z[i]) ? z[i] - real_dot(N, &model->H[i * N], state->x) : 0;
        shown->outlying[i] = outlying[i];
        shown->weight[i] = weights[i];
    }
    *state = next;
    return ${NAME}_OK;
}

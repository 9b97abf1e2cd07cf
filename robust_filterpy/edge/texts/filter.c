$!mixes $include refusal.c
$?mixes $include classes.c
$?models #define MODELS $models

$?models static learnt_state models_of(${name}_state *const state)
$?models {
$?models     return (learnt_state){state->means, state->covariances, state->belief, state->memory};
$?models }

${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state$motion_parameter$predict_parameter)
{
    ${name}_state next;
$!models     real work[predict_work(N)];
$?models     real work[learnt_predict_work(N, MODELS)];
$?models     learnt_state s;
$?extended     real moved[N] = {0}, F[N * N] = {0};
$?inputs     real control[N] = {0};
    if (model == NULL || state == NULL) return ${NAME}_BAD_ARGUMENT;
$?moves     /* This filter's predict_x is its own: f alone knows the motion. */
$?moves     if (motion == NULL) return ${NAME}_BAD_ARGUMENT;
$?extended     if (motion != NULL && (motion->f == NULL || motion->jacobian == NULL$control_too))
$?extended         return ${NAME}_BAD_ARGUMENT;
$?inputs     for (int k = 0; k < $inputs && u != NULL; k++)
$?inputs         if (!real_is_finite(u[k])) return ${NAME}_BAD_ARGUMENT;
$?inputs     for (int i = 0; i < N && u != NULL; i++) control[i] = real_dot($inputs, &model->B[i * $inputs], u);
    next = *state;
$?extended     if (motion != NULL) {
$?extended         motion->f(state->x, moved, motion->context);
$?extended         motion->jacobian(state->x, F, motion->context);
$?extended     }
$?models     s = models_of(&next);
$?models     if (!learnt_has_parts(N, &rule, &s)) return ${NAME}_BAD_ARGUMENT;
$?models     learnt_predict(N, &rule, &s, model->F, model->Q, $control_given, $alpha_sq, work);
$?models     if (!learnt_merge(N, &rule, &s, next.x, next.P, work)) return ${NAME}_NOT_FINITE;
$!models     if (!predict(N, state->x, state->P, $matrix, model->Q, $control_given, $alpha_sq,
$!models                  next.x, next.P, work))
$!models         return ${NAME}_NOT_FINITE;
$?extended     for (int i = 0; i < N && motion != NULL; i++) next.x[i] = moved[i];
$?extended     for (int i = 0; i < N; i++)
$?extended         if (!real_is_finite(next.x[i])) return ${NAME}_NOT_FINITE;
    *state = next;
    return ${NAME}_OK;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state$sensor_parameter, const ${name}_real z[$m],
                              ${name}_shown *shown)
{
    ${name}_state next;
$?mixes     learnt_state s;
$?mixes     real work[learnt_correct_work(N, M, $hypotheses, CLASSES)] = {0};
$?mixes     real weights[M], outlying[M], likelihood = 0;
$?joint     static const real normalizers[JOINT_MOST] = {0}; /* of a likelihood nobody asks for */
$!mixes     correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0,
$!mixes                             $normalizers, $patience};
$!mixes     correction c;
$!mixes     real work[update_work(N, M)] = {0};
$?extended     real at[M] = {0}, filled[M], y[M], H[M * N] = {0}, check = 0;
$?extended $?mixes     real belief[3 * N] = {0};
    if (model == NULL || state == NULL || z == NULL$blind)
        return ${NAME}_BAD_ARGUMENT;
    for (int i = 0; i < M; i++)
        if (z[i] == z[i] && !(real_abs(z[i]) < REAL_ORDINARY)) return ${NAME}_BAD_ARGUMENT;
$!mixes $include rule.c
    next = *state;
$?extended $include sensor.c
$!extended $?mixes     s = models_of(&next);
$!extended $?mixes     if (!learnt_has_parts(N, &rule, &s)) return ${NAME}_BAD_ARGUMENT;
$?mixes     if (learnt_correct(N, M, &rule, &s, $compared, model->R, NULL, weights, outlying, &likelihood, work) < 0)
$?mixes         return ${NAME}_SINGULAR;
$!mixes     correction_begin(N, M, 0, &c, work);
$!mixes     if (!update(N, M, &rule, $compared, model->R, NULL, $memory,
$!mixes                 next.x, next.P, &c, NULL, work))
$!mixes         return refusal(&c, next.x, next.P);
$!extended $?mixes     if (!learnt_merge(N, &rule, &s, next.x, next.P, work)) return ${NAME}_NOT_FINITE;
$?extended     for (int i = 0; i < N; i++) next.x[i] = state->x[i] + next.x[i];
$?extended $?mixes $include symmetric.c
    for (int i = 0; i < M && shown != NULL; i++) {
        shown->y[i] = z[i] == z[i] ? $innovation_shown : 0;
$!mixes         shown->e[i] = c.e[i];
$!mixes         shown->weight[i] = c.weights[i];
$?mixes         shown->outlying[i] = outlying[i];
$?mixes         shown->weight[i] = weights[i];
    }
    *state = next;
    return ${NAME}_OK;
}

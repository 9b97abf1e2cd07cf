$!mixes $include refusal.c
$?mixes $include classes.c
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state,
                               const ${name}_motion *motion$predict_parameter)
{
    ${name}_state next;
    real work[predict_work(N)], moved[N] = {0}, F[N * N] = {0}, check = 0;
$?inputs     real control[N] = {0};
    if ((model == NULL) || (state == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$?moves     /* This filter's predict_x is its own: f alone knows the motion. */
$?moves     if (motion == NULL) {
$?moves         return ${NAME}_BAD_ARGUMENT;
$?moves     }
    if ((motion != NULL) && ((motion->f == NULL) || (motion->jacobian == NULL)$control_too)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$?inputs $include control.c
    next = *state;
    if (motion != NULL) {
        motion->f(state->x, moved, motion->context);
        motion->jacobian(state->x, F, motion->context);
    }
    if (!predict(N, state->x, state->P, (motion != NULL) ? F : model->F, model->Q, $control_given, $alpha_sq,
                 next.x, next.P, work)) {
        return ${NAME}_NOT_FINITE;
    }
    for (int i = 0; (i < N) && (motion != NULL); i++) {
        next.x[i] = moved[i];
        check += real_abs(moved[i]);
    }
    if (!real_is_finite(check)) {
        return ${NAME}_NOT_FINITE;
    }
    *state = next;
    return ${NAME}_OK;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, const ${name}_sensor *sensor,
                              const ${name}_real z[$m], ${name}_shown *shown)
{
    ${name}_state next;
$?mixes     learnt_state s;
$?mixes     real work[learnt_correct_work(N, M, 1, CLASSES)] = {0};
$?mixes     real weights[M], outlying[M], belief[3 * N] = {0}, likelihood = 0;
$?joint     static const real normalizers[JOINT_MOST] = {0}; /* of a likelihood nobody asks for */
$!mixes     correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0, $normalizers};
$!mixes     correction c;
$!mixes     real work[update_work(N, M)] = {0};
$!mixes     int seen = 0;
    real at[M] = {0}, filled[M], y[M], H[M * N] = {0}, check = 0;
    if ((model == NULL) || (state == NULL) || (z == NULL) || (sensor == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    if ((sensor->h == NULL) || (sensor->jacobian == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    for (int i = 0; i < M; i++) {
        if ((z[i] == z[i]) && !(real_abs(z[i]) < REAL_ORDINARY)) {
            return ${NAME}_BAD_ARGUMENT;
        }
    }
$!mixes $include rule.c
    sensor->h(state->x, at, sensor->context);
    sensor->jacobian(state->x, H, sensor->context);
    /* What is missing is as predicted where the residual looks at it. */
    for (int i = 0; i < M; i++) {
        filled[i] = (z[i] == z[i]) ? z[i] : at[i];
        y[i] = filled[i] - at[i];
    }
    if (sensor->residual != NULL) {
        sensor->residual(filled, at, y, sensor->context);
    }
    for (int i = 0; i < M; i++) {
        check += real_abs(at[i]) + real_abs(y[i]);
        for (int k = 0; k < N; k++) {
            check += real_abs(H[i * N + k]);
        }
        y[i] = (z[i] == z[i]) ? y[i] : z[i];
    }
    if (!real_is_finite(check)) {
        return ${NAME}_NOT_FINITE;
    }
    next = *state;
$!mixes $include bounded.c
$?mixes $include mixed.c
    *state = next;
    return ${NAME}_OK;
}

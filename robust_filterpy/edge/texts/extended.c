$refusal
$classes
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state,
                               const ${name}_motion *motion$predict_parameter)
{
    ${name}_state next;
    real work[predict_work(N)], moved[N] = {0}, F[N * N] = {0}, check = 0;
$control
    if ((model == NULL) || (state == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$motion_needed
    if ((motion != NULL) && ((motion->f == NULL) || (motion->jacobian == NULL)$control_too)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$control_sum
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
$correction_needs
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
$rule
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
$correction
    *state = next;
    return ${NAME}_OK;
}

$include refusal.c
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state$predict_parameter)
{
    ${name}_state next;
    real work[predict_work(N)];
$?inputs     real control[N] = {0};
    if ((model == NULL) || (state == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
$?inputs $include control.c
    next = *state;
    if (!predict(N, state->x, state->P, model->F, model->Q, $control_given, $alpha_sq,
                 next.x, next.P, work)) {
        return ${NAME}_NOT_FINITE;
    }
    *state = next;
    return ${NAME}_OK;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, const ${name}_real z[$m],
                              ${name}_shown *shown)
{
    ${name}_state next;
$?joint     static const real normalizers[JOINT_MOST] = {0}; /* of a likelihood nobody asks for */
    correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0, $normalizers};
    correction c;
    real work[update_work(N, M)] = {0};
    if ((model == NULL) || (state == NULL) || (z == NULL)) {
        return ${NAME}_BAD_ARGUMENT;
    }
    for (int i = 0; i < M; i++) {
        if ((z[i] == z[i]) && !(real_abs(z[i]) < REAL_ORDINARY)) {
            return ${NAME}_BAD_ARGUMENT;
        }
    }
$include rule.c
    next = *state;
    correction_begin(N, M, 0, &c, work);
    if (!update(N, M, &rule, z, z, model->H, model->R, NULL, $memory,
                next.x, next.P, &c, NULL, work)) {
        return refusal(&c, next.x, next.P);
    }
    for (int i = 0; (i < M) && (shown != NULL); i++) {
        shown->y[i] = (z[i] == z[i]) ? z[i] - real_dot(N, &model->H[i * N], state->x) : 0;
        shown->e[i] = c.e[i];
        shown->weight[i] = c.weights[i];
    }
    *state = next;
    return ${NAME}_OK;
}

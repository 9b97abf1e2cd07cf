//? control
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state, const ${name}_real u[$inputs])
//.
//? !control
${name}_status ${name}_predict(const ${name}_model *model, ${name}_state *state)
//.
{
    Status status = ${NAME}_BAD_ARGUMENT;
    if ((model != NULL) && (state != NULL)) {
//? control
        int32_t usable = 1;
        for (int32_t i = 0; (i < U) && (u != NULL); i++) {
            usable = isfinite(u[i]) ? usable : 0;
        }
        if (usable != 0) {
            status = advance(model, u, state->x, state->P);
        }
//.
//? !control
        status = advance(model, state->x, state->P);
//.
    }
    return status;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, const ${name}_real z[$m],
                              ${name}_shown *shown)
{
    Status status = ${NAME}_BAD_ARGUMENT;
    if ((model != NULL) && (state != NULL) && (z != NULL)) {
        Correction found;
        real y[M];
        int32_t usable = 1;
        int32_t measured = 0;
        for (int32_t i = 0; i < M; i++) {
            y[i] = z[i];
            for (int32_t k = 0; k < N; k++) {
                y[i] -= model->H[i * N + k] * state->x[k];
            }
            usable = isinf(z[i]) ? 0 : usable;
            measured = isnan(z[i]) ? measured : 1;
            found.e[i] = REAL(0.0);
            found.weight[i] = REAL(NAN);
        }
        for (int32_t i = 0; i < M; i++) {
            /* An overflow must not pass for a component that is missing. */
            status = (isfinite(z[i]) && !isfinite(y[i])) ? ${NAME}_NOT_FINITE : status;
        }
        if ((usable != 0) && (status != ${NAME}_NOT_FINITE)) {
            /* y of what is missing is 0 from here on. */
            status = (measured != 0) ? correct(model, model->H, model->R, y, state->x, state->P, &found) : ${NAME}_OK;
            for (int32_t i = 0; (i < M) && (status == ${NAME}_OK) && (shown != NULL); i++) {
                shown->y[i] = isnan(z[i]) ? REAL(0.0) : y[i];
                shown->e[i] = found.e[i];
                shown->weight[i] = found.weight[i];
            }
        }
    }
    return status;
}

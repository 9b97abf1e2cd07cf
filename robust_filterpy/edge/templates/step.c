//? inputs
/* Remember the inputs of this sample. */
static void remember(real inputs[LENGTH], const real u[$inputs_or_one])
{
    for (int32_t i = LENGTH - 1; i > 0; i--) {
        inputs[i] = inputs[i - 1];
    }
//? !reads_u
    (void)u;
//.
$newest_inputs
}

//.
/* One sample: predict, look again at outputs that were replaced, correct, restrain, follow R, remember. */
static Status step(const Model *model, State *state, real y, const real u[$inputs_or_one], Sample *sample)
{
    const int32_t known = isnan(y) ? 0 : 1;
    Status status = ${NAME}_OK;
    real phi[N];
    real gradient[N];
    real predicted;
//? told
    const real r = model->R;
//.
//? followed
    const real r = state->R;
//.
//? guarded
    real old[N];
    for (int32_t i = 0; i < N; i++) {
        old[i] = state->theta[i];
    }
//.
//? !inputs
    (void)u;
//.
//? inputs
    remember(state->inputs, u);
//.
    regressor(state, phi);
//? fading
    if ((state->enabled != 0) && (trace(state->P) <= model->windup)) {
//.
//? !fading
    if (state->enabled != 0) {
//.
        status = drift(model, state);
    }
    predicted = dot(phi, state->theta);
    sample->prediction = predicted;
    sample->residual = y - predicted;
    sample->weight = REAL(NAN);
    sample->guard = 0;
//? cleaned
    if (known != 0) {
        /* Where the outputs as measured explain this one and those put in their place do not, they were right. */
        real other[N];
        real explained;
        for (int32_t i = 0; i < N; i++) {
            other[i] = phi[i];
        }
        for (int32_t i = 0; i < NA; i++) {
            other[OUTPUTS + i] = state->measured[i];
        }
        explained = dot(other, state->theta);
        if ((FABS(y - predicted) > CLEANED_FROM * SQRT(variance(phi, state->P, r)))
            && (FABS(y - explained) < FABS(y - predicted))) {
            predicted = explained;
            for (int32_t i = 0; i < NA; i++) {
                phi[OUTPUTS + i] = state->measured[i];
                state->outputs[i] = state->measured[i];
            }
        }
    }
//.
    for (int32_t i = 0; i < N; i++) {
        gradient[i] = phi[i];
    }
//? filtered
//? prefiltered
    real chi[N] = {REAL(0.0)};
    for (int32_t i = THROUGH; i < THROUGH_END; i++) {
        chi[i] = phi[i];
    }
//.
//? !prefiltered
    real *const chi = NULL;
//.
//? unguarded
    if (are_stable(state->theta) != 0) {
        differentiate(state, gradient, chi);
    }
//.
//? !unguarded
    differentiate(state, gradient, chi);
//.
//? prefiltered
    push_row(state->prefiltered, ROWS, chi);
//.
//? gradients
    push_row(state->gradients, NC, gradient);
//.
//.
//? cleaned
    real believed = (known != 0) ? y : bounded(predicted);
//.
//? outputs|residuals !cleaned
    const real believed = (known != 0) ? y : bounded(predicted);
//.
    if ((state->enabled != 0) && (known != 0) && (status == ${NAME}_OK)) {
//? cleaned|followed
        const real S = variance(gradient, state->P, r);
//.
//? cleaned
        believed = (FABS(y - predicted) > CLEANED_FROM * SQRT(S)) ? bounded(predicted) : y;
//.
        status = learn(model, state, gradient, y - predicted, r, &sample->weight);
//? followed
        if (status == ${NAME}_OK) {
            follow(model, state, y - predicted, S);
        }
//.
    }
//? guarded
    if (state->enabled != 0) {
        sample->guard = restrain(state->theta, old);
    }
//.
//? undisturbed|whitened
    real alone = REAL(0.0);
    for (int32_t i = THROUGH; i < THROUGH_END; i++) {
        alone += phi[i] * state->theta[i];
    }
    alone = bounded(alone);
//.
//? undisturbed
    push(state->undisturbed, NF, -alone);
//.
//? outputs whitened
    push(state->outputs, NA, alone - believed);
//.
//? outputs !whitened
    push(state->outputs, NA, -believed);
//.
//? cleaned whitened
    push(state->measured, NA, alone - ((known != 0) ? y : bounded(predicted)));
//.
//? cleaned !whitened
    push(state->measured, NA, (known != 0) ? -y : -bounded(predicted));
//.
//? residuals
    const real after = dot(phi, state->theta);
    push(state->residuals, NC, (known != 0) ? bounded(believed - after) : REAL(0.0));
//.
    return status;
}

${name}_status ${name}_update(const ${name}_model *model, ${name}_state *state, ${name}_real y,
                              const ${name}_real u[$inputs_or_one], ${name}_sample *sample)
{
    Status status = ${NAME}_BAD_ARGUMENT;
//? external
    if ((model != NULL) && (state != NULL) && (u != NULL) && (!isinf(y))) {
        int32_t usable = 1;
        for (int32_t i = 0; i < $inputs; i++) {
            usable = (FABS(u[i]) <= LARGEST) ? usable : 0;
        }
//.
//? !external
    if ((model != NULL) && (state != NULL) && (!isinf(y))) {
        const int32_t usable = 1;
//.
        if (usable != 0) {
            /* A copy, so that a sample which is refused changes nothing. */
            State next = *state;
            Sample found;
//? offset
            const real output = isnan(y) ? y : bounded(y) - model->centre;
//.
//? !offset
            const real output = isnan(y) ? y : bounded(y);
//.
            status = step(model, &next, output, u, &found);
            if (status == ${NAME}_OK) {
//? offset
                found.prediction += model->centre;
//.
                *state = next;
                if (sample != NULL) {
                    *sample = found;
                }
            }
        }
    }
    return status;
}

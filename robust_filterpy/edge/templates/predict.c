/* x = F x + B u and P = alpha^2 F P F' + Q; they change only if the result is ${NAME}_OK. */
static Status advance(const Model *model, real x[N], real P[N * N])
{
    real x_next[N];
    real P_next[N * N];
    Status status = ${NAME}_NOT_FINITE;
    for (int32_t i = 0; i < N; i++) {
        real row[N];
        x_next[i] = REAL(0.0);
        for (int32_t j = 0; j < N; j++) {
            x_next[i] += model->F[i * N + j] * x[j];
            row[j] = REAL(0.0);
            for (int32_t k = 0; k < N; k++) {
                row[j] += model->F[i * N + k] * P[k * N + j];
            }
        }
        for (int32_t j = 0; j <= i; j++) {
            real total = REAL(0.0);
            for (int32_t k = 0; k < N; k++) {
                total += row[k] * model->F[j * N + k];
            }
//? fading
            total = model->alpha_sq * total + model->Q[i * N + j];
//.
//? !fading
            total += model->Q[i * N + j];
//.
            P_next[i * N + j] = total;
            P_next[j * N + i] = total;
        }
    }
    if (all_finite(x_next, P_next) != 0) {
        for (int32_t i = 0; i < N; i++) {
            x[i] = x_next[i];
        }
        for (int32_t i = 0; i < N * N; i++) {
            P[i] = P_next[i];
        }
        status = ${NAME}_OK;
    }
    return status;
}

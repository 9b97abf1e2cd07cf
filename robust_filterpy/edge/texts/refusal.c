typedef ${name}_status Status;

#define N ${NAME}_STATES
#define M ${NAME}_SENSORS

/* Why a correction was not made, from what it has left behind. */
static Status refusal(const correction *const c, const real *const x, const real *const P)
{
    real check = 0;
    for (int i = 0; i < M; i++)
        if (!(real_abs(c->y[i]) < REAL_ORDINARY && real_abs(c->S[i * M + i]) < REAL_ORDINARY))
            return ${NAME}_NOT_FINITE;
    for (int i = 0; i < M; i++) {
        const int overdone = $scaling == SCALING_UNIT && c->S[i * M + i] < 0 && c->first[i] > 0;
        /* A sensor that was judged already is not left. */
        if (c->left[i] != 0 && !(c->S[i * M + i] > REAL_PIVOT * c->first[i]))
            return overdone ? ${NAME}_INDEFINITE : ${NAME}_SINGULAR;
    }
    for (int i = 0; i < N; i++) check += real_abs(x[i]) + real_abs(P[i * N + i]);
    return $scaling == SCALING_UNIT && real_is_finite(check) ? ${NAME}_INDEFINITE : ${NAME}_NOT_FINITE;
}

    sensor->h(state->x, at, sensor->context);
    sensor->jacobian(state->x, H, sensor->context);
    /* What is missing is as predicted where the residual looks at it. */
    for (int i = 0; i < M; i++) filled[i] = z[i] == z[i] ? z[i] : at[i];
    for (int i = 0; i < M; i++) y[i] = filled[i] - at[i];
    if (sensor->residual != NULL) sensor->residual(filled, at, y, sensor->context);
    for (int i = 0; i < M; i++) check += real_abs(at[i]) + real_abs(y[i]);
    for (int i = 0; i < M * N; i++) check += real_abs(H[i]);
    if (!real_is_finite(check)) return ${NAME}_NOT_FINITE;
    for (int i = 0; i < M; i++) y[i] = z[i] == z[i] ? y[i] : z[i];
    /* x is a state at 0 that differs from the present one. */
    for (int i = 0; i < N; i++) next.x[i] = 0;
$?mixes     for (int i = 0; i < N; i++) belief[i] = 1;
$?mixes     s = (learnt_state){next.x, next.P, belief, next.memory};

    check = 0;
    for (int i = 0; i < N; i++)
        for (int k = 0; k <= i; k++)
            next.P[i * N + k] = next.P[k * N + i] = REAL(0.5) * (next.P[i * N + k] + next.P[k * N + i]);
    for (int i = 0; i < N; i++) check += real_abs(next.x[i]);
    for (int i = 0; i < N * N; i++) check += real_abs(next.P[i]);
    if (!real_is_finite(check)) return ${NAME}_NOT_FINITE;

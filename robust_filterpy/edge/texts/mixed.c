    s = (learnt_state){next.x, next.P, belief, next.memory};
    for (int i = 0; i < N; i++) {
        belief[i] = 1;
        next.x[i] = 0;
    }
    if (learnt_correct(N, M, &rule, &s, y, z, H, model->R, NULL, weights, outlying, &likelihood, work) < 0) {
        return ${NAME}_SINGULAR;
    }
    check = 0;
    for (int i = 0; i < N; i++) {
        next.x[i] = state->x[i] + next.x[i];
        check += real_abs(next.x[i]);
        for (int k = 0; k <= i; k++) {
            next.P[i * N + k] = next.P[k * N + i] = REAL(0.5) * (next.P[i * N + k] + next.P[k * N + i]);
            check += real_abs(next.P[i * N + k]);
        }
    }
    if (!real_is_finite(check)) {
        return ${NAME}_NOT_FINITE;
    }
    for (int i = 0; (i < M) && (shown != NULL); i++) {
        shown->y[i] = (z[i] == z[i]) ? y[i] : 0;
        shown->outlying[i] = outlying[i];
        shown->weight[i] = weights[i];
    }

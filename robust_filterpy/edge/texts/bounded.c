    for (int i = 0; i < M; i++) {
        seen += (z[i] == z[i]) ? 1 : 0;
    }
    correction_begin(N, M, 1, &c, work);
    if (seen > 0) {
        for (int i = 0; i < N; i++) {
            next.x[i] = 0;
        }
        if (!update(N, M, &rule, z, y, H, model->R, NULL, $memory,
                    next.x, next.P, &c, NULL, work)) {
            return refusal(&c, next.x, next.P);
        }
        for (int i = 0; i < N; i++) {
            next.x[i] = state->x[i] + next.x[i];
        }
    }
    for (int i = 0; (i < M) && (shown != NULL); i++) {
        shown->y[i] = (z[i] == z[i]) ? y[i] : 0;
        shown->e[i] = (seen > 0) ? c.e[i] : 0;
        shown->weight[i] = (seen > 0) ? c.weights[i] : (real)NAN;
    }

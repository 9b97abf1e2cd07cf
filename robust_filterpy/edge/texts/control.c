    for (int k = 0; (k < $inputs) && (u != NULL); k++) {
        if (!real_is_finite(u[k])) {
            return ${NAME}_BAD_ARGUMENT;
        }
    }
    for (int i = 0; (i < N) && (u != NULL); i++) {
        control[i] = real_dot($inputs, &model->B[i * $inputs], u);
    }

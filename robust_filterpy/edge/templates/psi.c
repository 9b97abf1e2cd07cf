/* Influence function: psi and psi' of one standardized innovation. */
static void influence(const Model *model, real e, real *psi, real *slope)
{
//? linear
    (void)model;
    *psi = e;
    *slope = REAL(1.0);
//.
//? huber
    const real k = model->threshold;
    if (e > k) {
        *psi = k;
        *slope = REAL(0.0);
    } else if (e < -k) {
        *psi = -k;
        *slope = REAL(0.0);
    } else {
        *psi = e;
        *slope = REAL(1.0);
    }
//.
//? hampel
    const real r = FABS(e);
    real size;
    if (r <= model->a) {
        size = r;
        *slope = REAL(1.0);
    } else if (r <= model->b) {
        size = model->a;
        *slope = REAL(0.0);
    } else if (r <= model->c) {
        size = model->a * (model->c - r) / (model->c - model->b);
        *slope = -model->a / (model->c - model->b);
    } else {
        size = REAL(0.0);
        *slope = REAL(0.0);
    }
    *psi = (e < REAL(0.0)) ? -size : size;
//.
//? tukey
    *psi = REAL(0.0);
    *slope = REAL(0.0);
    if (FABS(e) <= model->threshold) {
        const real ratio = e / model->threshold;
        const real rest = REAL(1.0) - ratio * ratio;
        *psi = e * rest * rest;
        *slope = rest * (REAL(1.0) - REAL(5.0) * ratio * ratio);
    }
//.
//? student_t
    const real h = HYPOT(REAL(1.0), e / SQRT(model->df + REAL(1.0)));
    const real weight = (REAL(1.0) / h) * (REAL(1.0) / h);
    *psi = e / h / h;
    *slope = weight * (REAL(2.0) * weight - REAL(1.0));
//.
}

//? !expected
/* A number brought between 0 and 1. */
static real clipped(real value)
{
    return (value < REAL(0.0)) ? REAL(0.0) : ((value > REAL(1.0)) ? REAL(1.0) : value);
}

//.
/* Information d that one component has for the covariance. */
static real information(const Model *model, real e, real psi, real slope)
{
//? realized
    (void)model;
    (void)e;
    (void)psi;
    return clipped(slope);
//.
//? expected
    (void)e;
    (void)psi;
    (void)slope;
    return model->expected[0];
//.
//? weight
    (void)model;
    (void)slope;
    return (e != REAL(0.0)) ? clipped(psi / e) : REAL(1.0);
//.
}

/* psi(e), psi'(e) and D, for each component alone. */
static void bound_components(const Model *model, const real e[M], real psi[M], real slope[M], real D[M * M])
{
    for (int32_t i = 0; i < M; i++) {
        influence(model, e[i], &psi[i], &slope[i]);
        for (int32_t j = 0; j < M; j++) {
            D[i * M + j] = REAL(0.0);
        }
        D[i * M + i] = information(model, e[i], psi[i], slope[i]);
    }
}
//? joint

/* Length of the visible components, and in `direction` what each has of it; their number in `count`. */
static real length_of(const real e[M], const int32_t visible[M], real direction[M], int32_t *count)
{
    real peak = REAL(0.0);
    real square = REAL(0.0);
    real length = REAL(0.0);
    *count = 0;
    for (int32_t i = 0; i < M; i++) {
        direction[i] = REAL(0.0);
        if (visible[i] != 0) {
            *count += 1;
            peak = (FABS(e[i]) > peak) ? FABS(e[i]) : peak;
        }
    }
    if (peak > REAL(0.0)) {
        /* Of shares of the largest, since the square of the largest may overflow. */
        for (int32_t i = 0; i < M; i++) {
            direction[i] = (visible[i] != 0) ? e[i] / peak : REAL(0.0);
            square += direction[i] * direction[i];
        }
        length = peak * SQRT(square);
        length = (length > BIGGEST) ? BIGGEST : length;
        for (int32_t i = 0; i < M; i++) {
            direction[i] /= SQRT(square);
        }
    }
    return length;
}

/* The same for the visible components together: psi of their length, and D its Jacobian, its mean or its weight. */
static void bound_length(const Model *model, const real e[M], const int32_t visible[M], real psi[M], real slope[M],
                         real D[M * M])
{
    real direction[M];
    int32_t count = 0;
    const real length = length_of(e, visible, direction, &count);
    real along = REAL(0.0);
    real rise = REAL(0.0);
    influence(model, length, &along, &rise);
//? expected
    const real across = model->expected[count];
//.
//? !expected
    const real across = (length > REAL(0.0)) ? clipped(along / length) : REAL(1.0);
//.
//? realized
    const real radial = (length > REAL(0.0)) ? clipped(rise) : across;
//.
//? !realized
    const real radial = across;
//.
    for (int32_t i = 0; i < M; i++) {
        if (visible[i] != 0) {
            psi[i] = along * direction[i];
            slope[i] = rise;
            for (int32_t j = 0; j < M; j++) {
                if (visible[j] != 0) {
                    D[i * M + j] = (radial - across) * direction[i] * direction[j] + ((i == j) ? across : REAL(0.0));
                }
            }
        }
    }
}
//.

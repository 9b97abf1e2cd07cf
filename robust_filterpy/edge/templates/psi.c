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
    return model->expected;
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

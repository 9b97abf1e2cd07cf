/* T with T S T' = I: Z^(-1/2) diag(S)^(-1/2), Z being the correlation matrix of S; return whether S is regular. */
static int32_t whiten(const real S[M * M], real T[M * M])
{
    int32_t regular = 0;
    if ((S[0] > REAL(0.0)) && (S[0] <= BIGGEST)) {
        T[0] = REAL(1.0) / SQRT(S[0]);
        regular = 1;
    }
    return regular;
}

//? innovation
/* T of scaling "innovation": T S T' = I. Return whether S is regular. */
static int32_t standardize(const real S[M * M], real T[M * M])
{
    return whiten(S, T);
}
//.
//? unit
/* T = I of scaling "unit", and I - S. Return whether S is regular. */
static int32_t standardize(const real S[M * M], real T[M * M], real defect[M * M])
{
    const int32_t regular = whiten(S, T);
    for (int32_t i = 0; i < M * M; i++) {
        T[i] = (i % (M + 1) == 0) ? REAL(1.0) : REAL(0.0);
        defect[i] = T[i] - S[i];
    }
    return regular;
}
//.
//? bounded
/* T of scaling "bounded": 1/sqrt(S) with S floored at 1, and 1 - T S T'. Return whether S is regular. */
static int32_t standardize(const real S[M * M], real T[M * M], real defect[M * M])
{
    const int32_t regular = whiten(S, T);
    T[0] = (S[0] < REAL(1.0)) ? REAL(1.0) : T[0];
    defect[0] = (S[0] < REAL(1.0)) ? REAL(1.0) - S[0] : REAL(0.0);
    return regular;
}
//.

/* Largest size of an entry. */
static real largest(const real values[M])
{
    real peak = REAL(0.0);
    for (int32_t i = 0; i < M; i++) {
        peak = (FABS(values[i]) > peak) ? FABS(values[i]) : peak;
    }
    return peak;
}

/* A number brought between -BIGGEST and BIGGEST. */
static real representable(real value)
{
    return (value > BIGGEST) ? BIGGEST : ((value < -BIGGEST) ? -BIGGEST : value);
}

/* e = T y, finite even where the product overflows. */
static void standardized(const real T[M * M], const real y[M], real e[M])
{
    const real peak = largest(y);
    real unit[M];
    real scaled[M];
    for (int32_t j = 0; j < M; j++) {
        /* Columns of T are scaled by the units of the sensors: divided by them first, no product overflows alone. */
        unit[j] = REAL(0.0);
        for (int32_t i = 0; i < M; i++) {
            unit[j] = (FABS(T[i * M + j]) > unit[j]) ? FABS(T[i * M + j]) : unit[j];
        }
        scaled[j] = (peak < SAFE) ? y[j] : unit[j] * (y[j] / peak);
    }
    const real top = (largest(scaled) > REAL(0.0)) ? largest(scaled) : REAL(1.0);
    for (int32_t i = 0; i < M; i++) {
        e[i] = REAL(0.0);
        for (int32_t j = 0; j < M; j++) {
            if (peak < SAFE) {
                e[i] += T[i * M + j] * y[j];
            } else {
                e[i] += T[i * M + j] / ((unit[j] > REAL(0.0)) ? unit[j] : REAL(1.0)) * (scaled[j] / top);
            }
        }
        e[i] = (peak < SAFE) ? representable(e[i]) : representable(representable(e[i] * top) * peak);
    }
}

//? !bounded|alone
/* T with T S T' = I: Z^(-1/2) diag(S)^(-1/2), Z being the correlation matrix of S; return whether S is regular. */
static int32_t whiten(const real S[M * M], real T[M * M])
{
    int32_t regular = 0;
//? alone
    if ((S[0] > REAL(0.0)) && (S[0] <= BIGGEST)) {
        T[0] = REAL(1.0) / SQRT(S[0]);
        regular = 1;
    }
//.
//? pair
    if ((S[0] > REAL(0.0)) && (S[0] <= BIGGEST) && (S[3] > REAL(0.0)) && (S[3] <= BIGGEST)) {
        const real first = SQRT(S[0]);
        const real second = SQRT(S[3]);
        const real correlation = S[1] / first / second;
        if (REAL(1.0) - FABS(correlation) > REAL(2.0) * EPSILON) {
            const real p = REAL(1.0) / SQRT(REAL(1.0) + correlation);
            const real q = REAL(1.0) / SQRT(REAL(1.0) - correlation);
            T[0] = REAL(0.5) * (p + q) / first;
            T[1] = REAL(0.5) * (p - q) / second;
            T[2] = REAL(0.5) * (p - q) / first;
            T[3] = REAL(0.5) * (p + q) / second;
            regular = 1;
        }
    }
//.
//? many
    real unit[M];
    real Z[M * M];
    real V[M * M];
    int32_t positive = 1;
    for (int32_t i = 0; i < M; i++) {
        const real variance = S[i * M + i];
        positive = ((positive != 0) && (variance > REAL(0.0)) && (variance <= BIGGEST)) ? 1 : 0;
        unit[i] = (positive != 0) ? SQRT(variance) : REAL(1.0);
    }
    for (int32_t i = 0; i < M * M; i++) {
        Z[i] = S[i] / unit[i % M] / unit[i / M];
    }
    if ((positive != 0) && (diagonalize(Z, V) != 0)) {
        real least = Z[0];
        real most = Z[0];
        for (int32_t i = 1; i < M; i++) {
            least = (Z[i * M + i] < least) ? Z[i * M + i] : least;
            most = (Z[i * M + i] > most) ? Z[i * M + i] : most;
        }
        regular = (least > REAL(M) * EPSILON * most) ? 1 : 0;
    }
    if (regular != 0) {
        for (int32_t i = 0; i < M; i++) {
            for (int32_t j = 0; j < M; j++) {
                real total = REAL(0.0);
                for (int32_t k = 0; k < M; k++) {
                    total += V[i * M + k] / SQRT(Z[k * M + k]) * V[j * M + k];
                }
                T[i * M + j] = total / unit[j];
            }
        }
    }
//.
    return regular;
}

//.
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
//? bounded alone
/* T of scaling "bounded": 1/sqrt(S) with S floored at 1, and 1 - T S T'. Return whether S is regular. */
static int32_t standardize(const real S[M * M], real T[M * M], real defect[M * M])
{
    const int32_t regular = whiten(S, T);
    T[0] = (S[0] < REAL(1.0)) ? REAL(1.0) : T[0];
    defect[0] = (S[0] < REAL(1.0)) ? REAL(1.0) - S[0] : REAL(0.0);
    return regular;
}
//.
//? bounded !alone
/* T of scaling "bounded": S^(-1/2) with the eigenvalues of S floored at 1, and I - T S T'. */
static int32_t standardize(const real S[M * M], real T[M * M], real defect[M * M])
{
    real A[M * M];
    real V[M * M];
    int32_t diagonal = 1;
    int32_t regular = 0;
    for (int32_t i = 0; i < M * M; i++) {
        A[i] = S[i];
        diagonal = ((i % (M + 1) != 0) && (S[i] != REAL(0.0))) ? 0 : diagonal;
    }
    if (diagonalize(A, V) != 0) {
        real least = A[0];
        real most = A[0];
        for (int32_t i = 1; i < M; i++) {
            least = (A[i * M + i] < least) ? A[i * M + i] : least;
            most = (A[i * M + i] > most) ? A[i * M + i] : most;
        }
        /* A diagonal S is exact, however different the units of the sensors are. */
        regular = ((least > ((diagonal != 0) ? REAL(0.0) : REAL(M) * EPSILON * most)) && (most <= BIGGEST)) ? 1 : 0;
        for (int32_t i = 0; (i < M) && (regular != 0); i++) {
            for (int32_t j = 0; j < M; j++) {
                real root = REAL(0.0);
                real rest = REAL(0.0);
                for (int32_t k = 0; k < M; k++) {
                    const real value = A[k * M + k];
                    root += V[i * M + k] / SQRT((value > REAL(1.0)) ? value : REAL(1.0)) * V[j * M + k];
                    rest += V[i * M + k] * ((value < REAL(1.0)) ? REAL(1.0) - value : REAL(0.0)) * V[j * M + k];
                }
                /* Exactly I where it is I: rounding must not mix the sensors. */
                T[i * M + j] = (most > REAL(1.0)) ? root : ((i == j) ? REAL(1.0) : REAL(0.0));
                defect[i * M + j] = rest;
            }
        }
    }
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

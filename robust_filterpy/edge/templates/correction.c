/* What a correction shows of each component of the measurement. */
typedef struct {
    real e[M];      /* standardized innovation T y, 0 where missing */
    real weight[M]; /* psi(e)/e: 1 is full trust; NaN where missing */
} Correction;

/* C' = H P, row by row, and S = H P H' + R; a missing component becomes one that tells nothing. */
static void moments(const real P[N * N], const real H[M * N], const real R[M * M], const int32_t observed[M],
                    real C[M * N], real S[M * M])
{
    for (int32_t i = 0; i < M; i++) {
        for (int32_t j = 0; j < N; j++) {
            C[i * N + j] = REAL(0.0);
            for (int32_t k = 0; (k < N) && (observed[i] != 0); k++) {
                C[i * N + j] += H[i * N + k] * P[k * N + j];
            }
        }
    }
    for (int32_t i = 0; i < M; i++) {
        for (int32_t j = 0; j <= i; j++) {
            real total = (i == j) ? REAL(1.0) : REAL(0.0);
            if ((observed[i] != 0) && (observed[j] != 0)) {
                total = R[i * M + j];
                for (int32_t k = 0; k < N; k++) {
                    total += C[i * N + k] * H[j * N + k];
                }
            }
            S[i * M + j] = total;
            S[j * M + i] = total;
        }
    }
}

/*
 * P+ = (I - K H) P (I - K H)' + K R K' + G (D - D^2 + D (I - T S T') D) G' with G = C T' and K = G D T: Joseph's form,
 * which stays positive semidefinite in rounding, and what psi leaves unused of the measurement.
 */
static void posterior(const real P[N * N], const real H[M * N], const real R[M * M], const real G[N * M],
//? innovation
                      const real T[M * M], const real D[M * M], real P_next[N * N])
//.
//? !innovation
                      const real T[M * M], const real D[M * M], const real defect[M * M], real P_next[N * N])
//.
{
    real DT[M * M];
    real unused[M * M];
    real K[N * M];
    real I_KH[N * N];
    for (int32_t i = 0; i < M; i++) {
        for (int32_t j = 0; j < M; j++) {
            real through = REAL(0.0);
            real square = REAL(0.0);
            for (int32_t k = 0; k < M; k++) {
                through += D[i * M + k] * T[k * M + j];
//? innovation
                square += D[i * M + k] * D[k * M + j];
//.
//? !innovation
                real inner = -D[k * M + j];
                for (int32_t l = 0; l < M; l++) {
                    inner += defect[k * M + l] * D[l * M + j];
                }
                square -= D[i * M + k] * inner;
//.
            }
            DT[i * M + j] = through;
            unused[i * M + j] = D[i * M + j] - square;
        }
    }
    for (int32_t i = 0; i < N; i++) {
        for (int32_t j = 0; j < M; j++) {
            K[i * M + j] = REAL(0.0);
            for (int32_t k = 0; k < M; k++) {
                K[i * M + j] += G[i * M + k] * DT[k * M + j];
            }
        }
        for (int32_t j = 0; j < N; j++) {
            real total = (i == j) ? REAL(1.0) : REAL(0.0);
            for (int32_t k = 0; k < M; k++) {
                total -= K[i * M + k] * H[k * N + j];
            }
            I_KH[i * N + j] = total;
        }
    }
    for (int32_t i = 0; i < N; i++) {
        real row[N];
        real noise[M];
        real rest[M];
        for (int32_t j = 0; j < N; j++) {
            row[j] = REAL(0.0);
            for (int32_t k = 0; k < N; k++) {
                row[j] += I_KH[i * N + k] * P[k * N + j];
            }
        }
        for (int32_t j = 0; j < M; j++) {
            noise[j] = REAL(0.0);
            rest[j] = REAL(0.0);
            for (int32_t k = 0; k < M; k++) {
                noise[j] += K[i * M + k] * R[k * M + j];
                rest[j] += G[i * M + k] * unused[k * M + j];
            }
        }
        for (int32_t j = 0; j <= i; j++) {
            real total = REAL(0.0);
            for (int32_t k = 0; k < N; k++) {
                total += row[k] * I_KH[j * N + k];
            }
            for (int32_t k = 0; k < M; k++) {
                total += noise[k] * K[j * M + k] + rest[k] * G[j * M + k];
            }
            P_next[i * N + j] = total;
            P_next[j * N + i] = total;
        }
    }
}

/* Whether x and P are finite: what is not finite anywhere in P shows on its diagonal. */
static int32_t all_finite(const real x[N], const real P[N * N])
{
    int32_t finite = 1;
    for (int32_t i = 0; i < N; i++) {
        finite = ((finite != 0) && isfinite(x[i]) && isfinite(P[i * N + i])) ? 1 : 0;
    }
    return finite;
}
//? unit

/* Whether no eigenvalue of P is below -1e-13 of its largest entry, to rounding 0: by Cholesky's factorization. */
static int32_t is_covariance(const real P[N * N])
{
    real L[N * N];
    real bottom = REAL(0.0);
    int32_t positive = 1;
    for (int32_t i = 0; i < N * N; i++) {
        bottom = (FABS(P[i]) > bottom) ? FABS(P[i]) : bottom;
    }
    bottom *= REAL(450.0) * EPSILON;
    for (int32_t i = 0; (i < N) && (positive != 0); i++) {
        for (int32_t j = 0; j <= i; j++) {
            real total = P[i * N + j] + ((i == j) ? bottom : REAL(0.0));
            for (int32_t k = 0; k < j; k++) {
                total -= L[i * N + k] * L[j * N + k];
            }
            if (i != j) {
                L[i * N + j] = total / L[j * N + j];
            } else if (total > REAL(0.0)) {
                L[i * N + i] = SQRT(total);
            } else {
                positive = 0;
            }
        }
    }
    return positive;
}
//.

/* Correct x and P by an innovation y, NaN where missing; they change only if the result is ${NAME}_OK. */
static Status correct(const Model *model, const real H[M * N], const real R[M * M], real y[M], real x[N], real P[N * N],
                      Correction *shown)
{
    int32_t observed[M];
    real C[M * N];
    real S[M * M];
    real T[M * M];
    real D[M * M];
    real psi[M];
    real slope[M];
    real G[N * M];
    real x_next[N];
    real P_next[N * N];
    Status status = ${NAME}_OK;
//? !innovation
    real defect[M * M];
//.
    for (int32_t i = 0; i < M; i++) {
        observed[i] = isnan(y[i]) ? 0 : 1;
        y[i] = (observed[i] != 0) ? y[i] : REAL(0.0);
    }
    moments(P, H, R, observed, C, S);
//? innovation
    if (standardize(S, T) == 0) {
//.
//? !innovation
    if (standardize(S, T, defect) == 0) {
//.
        status = ${NAME}_SINGULAR;
    } else {
        standardized(T, y, shown->e);
        bound_components(model, shown->e, psi, slope, D);
        for (int32_t k = 0; k < N; k++) {
            x_next[k] = x[k];
            for (int32_t i = 0; i < M; i++) {
                G[k * M + i] = REAL(0.0);
                for (int32_t j = 0; j < M; j++) {
                    G[k * M + i] += C[j * N + k] * T[i * M + j];
                }
                x_next[k] += G[k * M + i] * psi[i];
            }
        }
//? innovation
        posterior(P, H, R, G, T, D, P_next);
//.
//? !innovation
        posterior(P, H, R, G, T, D, defect, P_next);
//.
        if (all_finite(x_next, P_next) == 0) {
            status = ${NAME}_NOT_FINITE;
        }
//? unit
        else if (is_covariance(P_next) == 0) {
            status = ${NAME}_INDEFINITE;
        }
//.
        else {
            for (int32_t i = 0; i < N; i++) {
                x[i] = x_next[i];
            }
            for (int32_t i = 0; i < N * N; i++) {
                P[i] = P_next[i];
            }
            for (int32_t i = 0; i < M; i++) {
                const real e = shown->e[i];
                shown->weight[i] = (observed[i] == 0) ? REAL(NAN) : ((e != REAL(0.0)) ? psi[i] / e : REAL(1.0));
            }
        }
    }
    return status;
}

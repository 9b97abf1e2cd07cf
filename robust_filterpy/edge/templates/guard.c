/* Whether z^n + c_1 z^(n-1) + .. + c_n has all its roots inside the unit circle, by Schur's and Cohn's recursion. */
static int32_t is_stable(const real coefficients[], int32_t order)
{
    real c[$longest] = {REAL(0.0)};
    real shorter[$longest];
    int32_t stable = 1;
    for (int32_t i = 0; i < order; i++) {
        c[i] = coefficients[i];
    }
    for (int32_t last = order - 1; (last >= 0) && (stable != 0); last--) {
        const real k = c[last];
        /* False for NaN as well. */
        stable = ((k > REAL(-1.0)) && (k < REAL(1.0))) ? 1 : 0;
        for (int32_t i = 0; (i < last) && (stable != 0); i++) {
            shorter[i] = (c[i] - k * c[last - 1 - i]) / (REAL(1.0) - k * k);
        }
        for (int32_t i = 0; (i < last) && (stable != 0); i++) {
            c[i] = shorter[i];
        }
    }
    return stable;
}

/* Whether the polynomials of theta that feed back are stable. */
static int32_t are_stable(const real theta[N])
{
    return $stable_calls;
}
//? guarded

/* Bring theta as far towards its new value as stability lets it; return how often its step was halved, -1 for all. */
static int32_t restrain(real theta[N], const real old[N])
{
    real candidate[N];
    int32_t event = 0;
    int32_t stable = are_stable(theta);
//? halve
    real share = REAL(1.0);
    for (int32_t halvings = 1; (halvings <= 30) && (stable == 0); halvings++) {
        share *= REAL(0.5);
        for (int32_t i = 0; i < N; i++) {
            candidate[i] = old[i] + share * (theta[i] - old[i]);
        }
        stable = are_stable(candidate);
        event = halvings;
    }
//.
    if (stable == 0) {
        event = -1;
        for (int32_t i = 0; i < N; i++) {
            candidate[i] = old[i];
        }
    }
    for (int32_t i = 0; (i < N) && (event != 0); i++) {
        theta[i] = candidate[i];
    }
    return event;
}
//.

//? outputs
#define NA $na /* past outputs or disturbances in phi */
#define OUTPUTS $outputs_at /* where they begin */
//.
//? residuals
#define NC $nc /* past residuals in phi */
#define RESIDUALS $c_at /* where they begin */
//.
//? inputs
#define LENGTH $length /* inputs that are remembered */
#define LAGS $lags    /* those of them that stand in phi */
//.
//? undisturbed
#define NF $nf /* past outputs of B/F alone in phi */
#define UNDISTURBED $f_at /* where they begin */
//.
//? undisturbed|whitened
#define THROUGH $through_at /* where in phi stands what goes through B/F */
#define THROUGH_END $through_end /* and where it ends */
//.
//? prefiltered
#define ROWS $rows /* past phi through 1/F that are remembered */
//.
//? double
#define LARGEST 1e100       /* size of a signal, whose square must not overflow */
#define SHARP REAL(1e6)     /* phi'phi tr(P)/R from which on rounding is mended */
#define SHARPEST REAL(1e13) /* and from which on a sample is down-weighted */
//? followed
#define UNTOLD REAL(1e290)  /* variance of an innovation that tells nothing of R */
#define LEAST_R REAL(1e-290)
#define EXP exp
//.
//.
//? single
#define LARGEST 1e12F      /* size of a signal, whose square must not overflow */
#define SHARP REAL(1e2)    /* phi'phi tr(P)/R from which on rounding is mended */
#define SHARPEST REAL(1e6) /* and from which on a sample is down-weighted */
//? followed
#define UNTOLD REAL(1e35)  /* variance of an innovation that tells nothing of R */
#define LEAST_R REAL(1e-35)
#define EXP expf
//.
//.
//? cleaned
#define CLEANED_FROM REAL(3.0) /* standard deviations from which on an output is replaced in phi */
//.
//? inputs

/* Places of the inputs of phi among those remembered. */
static const int32_t lagged[LAGS] = {$picks};
//.
//? guarded|unguarded

$guard_code
//.

/* A signal, at most LARGEST in size; NaN, which is inf - inf here, becomes 0. */
static real bounded(real value)
{
    const real size = (value > LARGEST) ? LARGEST : ((value < -LARGEST) ? -LARGEST : value);
    return isnan(value) ? REAL(0.0) : size;
}

/* Sum of products of two vectors of N. */
static real dot(const real a[N], const real b[N])
{
    real total = REAL(0.0);
    for (int32_t i = 0; i < N; i++) {
        total += a[i] * b[i];
    }
    return total;
}

/* Trace of P. */
static real trace(const real P[N * N])
{
    real total = REAL(0.0);
    for (int32_t i = 0; i < N; i++) {
        total += P[i * N + i];
    }
    return total;
}

//? cleaned|followed

/* Variance of an innovation, phi' P phi + r. */
static real variance(const real phi[N], const real P[N * N], real r)
{
    real total = REAL(0.0);
    for (int32_t i = 0; i < N; i++) {
        total += phi[i] * dot(&P[i * N], phi);
    }
    return total + r;
}
//.
//? outputs|residuals|undisturbed

/* Put a value in front of `length` past ones, and drop the oldest. */
static void push(real past[], int32_t length, real newest)
{
    for (int32_t i = length - 1; i > 0; i--) {
        past[i] = past[i - 1];
    }
    past[0] = newest;
}
//.

/* phi: what is remembered, in the order of theta. */
static void regressor(const State *state, real phi[N])
{
//? outputs
    for (int32_t i = 0; i < NA; i++) {
        phi[OUTPUTS + i] = state->outputs[i];
    }
//.
//? inputs
    for (int32_t i = 0; i < LAGS; i++) {
        phi[$inputs_at + i] = state->inputs[lagged[i]];
    }
//.
//? residuals
    for (int32_t i = 0; i < NC; i++) {
        phi[RESIDUALS + i] = state->residuals[i];
    }
//.
//? undisturbed
    for (int32_t i = 0; i < NF; i++) {
        phi[UNDISTURBED + i] = state->undisturbed[i];
    }
//.
}

/* theta = F theta and P = alpha^2 F P F' + Q; return whether they are finite. */
//? random_walk
static Status drift(const Model *model, State *state)
{
    for (int32_t i = 0; i < N * N; i++) {
//? fading
        state->P[i] = model->alpha_sq * state->P[i] + model->Q[i];
//.
//? !fading
        state->P[i] += model->Q[i];
//.
    }
    return (all_finite(state->theta, state->P) != 0) ? ${NAME}_OK : ${NAME}_NOT_FINITE;
}
//.
//? !random_walk
static Status drift(const Model *model, State *state)
{
    return advance(model, state->theta, state->P);
}
//.
//? several

/* The nearest covariance, where P has lost its sign in rounding. */
static void repair(real P[N * N])
{
    real A[N * N];
    real V[N * N];
    real least;
    real bottom;
    for (int32_t i = 0; i < N * N; i++) {
        A[i] = P[i];
    }
    /* Where the sweeps were not enough, the rest is rounding. */
    (void)diagonalize(A, V);
    least = A[0];
    bottom = A[0];
    for (int32_t i = 1; i < N; i++) {
        least = (A[i * N + i] < least) ? A[i * N + i] : least;
        bottom = (A[i * N + i] > bottom) ? A[i * N + i] : bottom;
    }
    bottom *= EPSILON;
    for (int32_t i = 0; (i < N) && (least < -bottom); i++) {
        for (int32_t j = 0; j < N; j++) {
            real total = REAL(0.0);
            for (int32_t k = 0; k < N; k++) {
                total += V[i * N + k] * ((A[k * N + k] > bottom) ? A[k * N + k] : bottom) * V[j * N + k];
            }
            P[i * N + j] = total;
        }
    }
}
//.
//? !several

/* A variance cannot be below 0. */
static void repair(real P[N * N])
{
    P[0] = (P[0] > REAL(0.0)) ? P[0] : REAL(0.0);
}
//.
//? filtered

/* Numbers that can be squared. */
static void bound(real row[N])
{
    if (!(dot(row, row) < LARGEST * LARGEST)) {
        for (int32_t i = 0; i < N; i++) {
            row[i] = bounded(row[i]);
        }
    }
}

/* Put a row in front of `count` past ones, and drop the oldest. */
static void push_row(real past[], int32_t count, const real newest[N])
{
    for (int32_t i = count * N - 1; i >= N; i--) {
        past[i] = past[i - N];
    }
    for (int32_t i = 0; i < N; i++) {
        past[i] = newest[i];
    }
}

/* Derivative of the prediction: chi = phi/F for what goes through B/F, C gradient = D chi for that, = phi for the rest. */
static void differentiate(const State *state, real gradient[N], real chi[N])
{
//? undisturbed
    for (int32_t i = THROUGH; i < THROUGH_END; i++) {
        for (int32_t k = 0; k < NF; k++) {
            gradient[i] -= state->theta[UNDISTURBED + k] * state->prefiltered[k * N + i];
        }
    }
    bound(gradient);
//.
//? prefiltered
    for (int32_t i = THROUGH; i < THROUGH_END; i++) {
        chi[i] = gradient[i];
    }
//.
//? !prefiltered
    (void)chi;
//.
//? whitened
    for (int32_t i = THROUGH; i < THROUGH_END; i++) {
        for (int32_t k = 0; k < NA; k++) {
            gradient[i] += state->theta[OUTPUTS + k] * state->prefiltered[k * N + i];
        }
    }
//.
//? gradients
    for (int32_t i = 0; i < N; i++) {
        for (int32_t k = 0; k < NC; k++) {
            gradient[i] -= state->theta[RESIDUALS + k] * state->gradients[k * N + i];
        }
    }
//.
    bound(gradient);
}
//.

/* Correct theta along the gradient by an innovation. */
static Status learn(const Model *model, State *state, const real gradient[N], real innovation, real r, real *weight)
{
    const real square = dot(gradient, gradient);
    const real spread = trace(state->P);
    real H[N];
    real y[M];
    real factor = REAL(1.0);
    Correction found;
    Status status;
    if (square * spread > SHARPEST * r) {
        factor = SQRT(SHARPEST / square) * SQRT(r / spread);
    }
    for (int32_t i = 0; i < N; i++) {
        H[i] = factor * gradient[i];
    }
    y[0] = factor * innovation;
    status = correct(model, H, &r, y, state->theta, state->P, &found);
    if (status == ${NAME}_OK) {
        *weight = found.weight[0];
        if (square * spread > SHARP * r) {
            repair(state->P);
        }
    }
    return status;
}
//? followed

/* Let R follow the size of the innovations, whose variance is S. */
static void follow(const Model *model, State *state, real innovation, real S)
{
    const real r = state->R;
    const real samples = state->R_samples;
    /* A sample whose regressor overflows tells nothing of R. */
    if (S < UNTOLD) {
        const real share = r / S;
        const real early = REAL(5.0) / (samples + REAL(1.0));
        const real first = (early < REAL(1.0)) ? early : REAL(1.0);
        const real late = REAL(1.5) / model->R_memory;
        const real gain = share * ((late > first) ? late : first);
        const real square = innovation * innovation / S;
        const real surprise = ((square < REAL(4.0)) ? square : REAL(4.0)) / model->R_mean - REAL(1.0);
        const real next = r * EXP(gain * surprise);
        state->R = (next > LEAST_R) ? next : LEAST_R;
        state->R_samples += share;
    }
    /* What was learnt with an R far too small is known less well by as much. */
    for (int32_t i = 0; (i < N * N) && (samples < REAL(20.0)) && (state->R > r); i++) {
        state->P[i] *= state->R / r;
    }
}
//.

/* Three filters of a vehicle, position and velocity, on the same readings: Kalman's, the default, learnt noise.

   The kernel's own headers with the numbers of numbers.h, which build.py writes. */
#include "learnt.h"
#include "numbers.h"

enum { n = 2, m = 1, STEPS = 1000, WORK = 20000 };

double live_z[STEPS], live_position[STEPS];
static double work[WORK];

/* Write the position after each of so many readings, R as told; return how many were taken. */
static int fixed(const int steps, const double told, const int scaling, const double threshold) {
    const double R[m * m] = {told};
    double x[n] = {0}, P[n * n], next[n], Pn[n * n];
    double *const spare = work + n * (n + 1) + predict_work(n);
    spread_memory memory[m] = {{0}};
    correction c;
    correction_rule rule = {{PSI_HUBER, threshold, 0, 0}, scaling, INFORMATION_REALIZED, 1, 0, NULL, 0};
    real_copy(n * n, START, P);
    correction_begin(n, m, 0, &c, spare);
    for (int k = 0; k < steps; k++) {
        if (!predict(n, x, P, F, Q, NULL, 1, next, Pn, work)) return k;
        if (!update(n, m, &rule, live_z + k, live_z + k, H, R, NULL, memory, next, Pn, &c, NULL, spare)) return k;
        real_copy(n, next, x), real_copy(n * n, Pn, P);
        live_position[k] = x[0];
    }
    return steps;
}

int live_kalman(const int steps, const double told) { return fixed(steps, told, SCALING_INNOVATION, INFINITY); }

int live_default(const int steps, const double told, const double threshold) {
    return fixed(steps, told, SCALING_LEARNT, threshold);
}

/* A constant of the file: the compiler leaves out what it does not ask for. */
static const learnt_rule RULE = {LEARNT_Q, LEARNT_K, PROCESS, SCALES, BEGIN, LEARNT_STAY, LEARNT_JUMP,
                                  LEARNT_MEMORY, LEARNT_R_MEMORY, 1, NULL, 0, 0, NULL};

int live_learnt(const int steps, const double told) {
    const double R[m * m] = {told};
    enum { MODELS = LEARNT_Q + 1, WIDTH = learnt_width(LEARNT_K) };
    double means[(MODELS + 1) * n], covariances[(MODELS + 1) * n * n], belief[(MODELS + 5) * n], memory[WIDTH];
    double x[n] = {0}, P[n * n], weight, outlying, likelihood = 0;
    learnt_state s = {means, covariances, belief, memory};
    for (int i = 0; i <= MODELS; i++) {
        real_copy(n, x, means + i * n), real_copy(n * n, START, covariances + i * n * n);
    }
    real_copy((MODELS + 5) * n, BELIEF, belief);
    real_copy(WIDTH, BEGIN, memory);
    for (int k = 0; k < steps; k++) {
        learnt_predict(n, &RULE, &s, F, Q, NULL, 1, work);
        const double *const z = live_z + k;
        if (learnt_correct(n, m, &RULE, &s, z, z, H, R, NULL, &weight, &outlying, &likelihood, work) < 0) return k;
        if (!learnt_merge(n, &RULE, &s, x, P, work)) return k;
        live_position[k] = x[0];
    }
    return steps;
}

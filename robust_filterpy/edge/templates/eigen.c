#define SIZE $size

/* Rotate rows or columns i and j of a matrix: their entries are `step` apart. */
static void rotate(real A[SIZE * SIZE], int32_t i, int32_t j, int32_t step, real c, real s)
{
    for (int32_t k = 0; k < SIZE; k++) {
        const real a = A[i + k * step];
        const real b = A[j + k * step];
        A[i + k * step] = c * a - s * b;
        A[j + k * step] = s * a + c * b;
    }
}

/*
 * Bring a symmetric A to diagonal form by Jacobi's rotations, with its eigenvectors in the columns of V; return
 * whether 30 sweeps were enough, which they are but for what is not finite.
 */
static int32_t diagonalize(real A[SIZE * SIZE], real V[SIZE * SIZE])
{
    int32_t rotated = 1;
    for (int32_t i = 0; i < SIZE * SIZE; i++) {
        V[i] = (i % (SIZE + 1) == 0) ? REAL(1.0) : REAL(0.0);
    }
    for (int32_t sweep = 0; (sweep < 30) && (rotated != 0); sweep++) {
        rotated = 0;
        for (int32_t i = 0; i < SIZE; i++) {
            for (int32_t j = 0; j < i; j++) {
                const real off = A[i * SIZE + j];
                const real bound = SQRT(FABS(A[i * SIZE + i])) * SQRT(FABS(A[j * SIZE + j]));
                if (!(FABS(off) <= REAL(0.05) * EPSILON * bound)) {
                    /* tan of the angle that annihilates A_ij, of the two the smaller. */
                    const real half = REAL(0.5) * (A[j * SIZE + j] - A[i * SIZE + i]) / off;
                    const real root = (FABS(half) < SAFE) ? SQRT(half * half + REAL(1.0)) : FABS(half);
                    const real size = REAL(1.0) / (FABS(half) + root);
                    const real t = (half >= REAL(0.0)) ? size : -size;
                    const real c = REAL(1.0) / SQRT(t * t + REAL(1.0));
                    rotate(A, i, j, SIZE, c, t * c);
                    rotate(A, i * SIZE, j * SIZE, 1, c, t * c);
                    rotate(V, i, j, SIZE, c, t * c);
                    A[i * SIZE + j] = REAL(0.0);
                    A[j * SIZE + i] = REAL(0.0);
                    rotated = 1;
                }
            }
        }
    }
    return (rotated == 0) ? 1 : 0;
}

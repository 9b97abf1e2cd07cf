/* psi, psi' and rho of one number: robust_filterpy.influence.functions in C. */
#ifndef ROBUST_FILTERPY_PSI_H
#define ROBUST_FILTERPY_PSI_H

#include "real.h"

enum psi_kind { PSI_LINEAR, PSI_HUBER, PSI_HAMPEL, PSI_TUKEY, PSI_STUDENT_T, PSI_CALLED };

typedef struct {
    int kind;     /* enum psi_kind */
    real a, b, c; /* its parameters */
    /* PSI_CALLED: somebody else's, psi(e) and its slope, or rho(e) where slope is NULL. */
    real (*call)(void *context, real e, real *slope);
    void *context;
} psi_function;

/* Write psi(e), and psi'(e) into slope. */
SIZED real psi_of(const psi_function *const f, const real e, real *const slope) {
    const real r = real_abs(e), a = f->a;
    real inner;
    switch (f->kind) {
    case PSI_HUBER:
        *slope = r <= a ? REAL(1.0) : REAL(0.0);
        return e > a ? a : e < -a ? -a : e;
    case PSI_HAMPEL:
        *slope = r <= a ? REAL(1.0) : REAL(0.0);
        if (r <= a) return e;
        if (r <= f->b) return real_copysign(a, e);
        if (r > f->c) return REAL(0.0);
        *slope = -a / (f->c - f->b);
        return real_copysign(a * (f->c - r) / (f->c - f->b), e);
    case PSI_TUKEY:
        *slope = REAL(0.0);
        if (r > a) return REAL(0.0);
        inner = (e / a) * (e / a);
        *slope = (1 - inner) * (1 - 5 * inner);
        return e * (1 - inner) * (1 - inner);
    case PSI_STUDENT_T:
        inner = real_hypot(1, e / real_sqrt(a + 1));
        *slope = 1 / inner / inner;
        *slope = *slope * (2 * *slope - 1);
        return e / inner / inner;
    case PSI_CALLED:
        return f->call(f->context, e, slope);
    default:
        *slope = REAL(1.0);
        return e;
    }
}

/* rho(e), whose derivative psi is. */
SIZED real psi_rho(const psi_function *const f, const real e) {
    const real r = real_abs(e), a = f->a;
    real inner;
    switch (f->kind) {
    case PSI_HUBER:
        return r <= a ? REAL(0.5) * r * r : a * r - REAL(0.5) * a * a;
    case PSI_HAMPEL:
        if (r <= a) return REAL(0.5) * r * r;
        if (r <= f->b) return a * r - REAL(0.5) * a * a;
        inner = REAL(0.5) * a * (f->b - a + f->c);
        return r <= f->c ? inner - REAL(0.5) * a * (f->c - r) * (f->c - r) / (f->c - f->b) : inner;
    case PSI_TUKEY:
        inner = 1 - (e / a) * (e / a);
        return r > a ? a * a / 6 : a * a / 6 * (1 - inner * inner * inner);
    case PSI_STUDENT_T:
        return (a + 1) * real_log(real_hypot(1, e / real_sqrt(a + 1)));
    case PSI_CALLED:
        return f->call(f->context, e, NULL);
    default:
        return REAL(0.5) * e * e;
    }
}

#endif

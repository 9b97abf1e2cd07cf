/* Whether a sensor is stuck, it repeats its last reading to the last bit, though it seldom does and its noise is white:
   robust_filterpy.correction.repeats in C. */
#ifndef ROBUST_FILTERPY_REPEATS_H
#define ROBUST_FILTERPY_REPEATS_H

#include "real.h"

#define REPEATS_RARE REAL(0.1)     /* a share of repeats that is no habit of the sensor */
#define REPEATS_RAREST REAL(1e-3)  /* a share of repeats that is as rare as none */
#define REPEATS_CHANGES REAL(50.0) /* changes and repeats that are remembered */
#define REPEATS_QUANTILE REAL(1.0364333894937898) /* .7 of a normal |x| is below it */

typedef struct {
    real left;   /* what the last correction left of the reading */
    real change; /* the last one that was not foreseen, */
    real scale;  /* the scale of their differences, */
    real count;  /* how many there were */
    real last;   /* the last reading */
    real seldom; /* one over the share of readings that repeat, with a minus sign if the last repeated the one before */
} repeats_memory;

/* Note a reading, and how often its sensor repeats itself. */
INLINE void repeats_note_reading(const real z, repeats_memory *const memory) {
    const real again = z == memory->last, count = memory->count;
    real share = 1 / real_max(real_abs(memory->seldom), 1);
    share = real_max(share + (again - share) / real_min(count + 1, REPEATS_CHANGES), REPEATS_RAREST);
    if (count > 0) memory->seldom = (again > 0 ? -1 : 1) / share;
    memory->last = z;
}

/* Let an innovation y, less what was left of the reading before, move the scale of changes. */
INLINE void repeats_note_change(const real y, repeats_memory *const memory) {
    const real before = memory->change, count = memory->count, scale = memory->scale;
    real size, pace;
    memory->count += 1;
    /* What repeats the reading before tells nothing of the noise. */
    if (memory->seldom < 0) return;
    memory->change = count > 0 ? y - memory->left : 0;
    if (count < 2) return;
    size = real_abs(memory->change - before) / REPEATS_QUANTILE;
    pace = 2 * real_max(1 / (count - 1), 1 / REPEATS_CHANGES);
    /* Up or down by a pace, but never beyond what was seen. */
    if (!(scale > 0)) memory->scale = size;
    else if (size > scale) memory->scale = real_min(size, scale * real_exp(REAL(0.7) * pace));
    else memory->scale = real_max(size, scale * real_exp(REAL(-0.3) * pace));
}

/* Whether a reading repeats the last one. White noise makes 6 r; what changes less is none. */
INLINE int repeats_again(const real z, const real r, const repeats_memory *const memory) {
    return z == memory->last && memory->scale * memory->scale >= r &&
           REPEATS_RARE * real_abs(memory->seldom) >= 1;
}

#endif

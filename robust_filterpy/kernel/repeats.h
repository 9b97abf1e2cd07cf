/* Whether a sensor is stuck, it repeats its last reading to the last bit, though it seldom does and its noise is white:
   robust_filterpy.correction.repeats in C. What is known of its readings is a row of numbers. */
#ifndef ROBUST_FILTERPY_REPEATS_H
#define ROBUST_FILTERPY_REPEATS_H

#include "real.h"

#define REPEATS_RARE REAL(10.0)    /* readings to one that repeats, where that is no habit of the sensor */
#define REPEATS_RAREST REAL(1e-3)  /* a share of repeats that is as rare as none */
#define REPEATS_CHANGES REAL(50.0) /* changes and repeats that are remembered */
#define REPEATS_QUANTILE REAL(1.0364333894937898) /* .7 of a normal |x| is below it */

/* What is left of the reading, the last change, the scale of their differences, how many; the last reading, and one
   over the share of readings that repeat, with a minus sign if the last reading repeated the one before. */
enum repeats_row {
    REPEATS_LEFT, REPEATS_CHANGE, REPEATS_SCALE, REPEATS_COUNT, REPEATS_LAST, REPEATS_SELDOM, REPEATS_WIDTH
};

/* Note a reading, and how often its sensor repeats itself. */
INLINE void repeats_note_reading(const real z, real *RESTRICT row) {
    const real again = z == row[REPEATS_LAST], count = row[REPEATS_COUNT];
    real share = 1 / real_max(real_abs(row[REPEATS_SELDOM]), 1);
    share = real_max(share + (again - share) / real_min(count + 1, REPEATS_CHANGES), REPEATS_RAREST);
    if (count > 0) row[REPEATS_SELDOM] = (again > 0 ? -1 : 1) / share;
    row[REPEATS_LAST] = z;
}

/* Let an innovation y, less what was left of the reading before, move the scale of changes. */
INLINE void repeats_note_change(const real y, real *RESTRICT row) {
    const real before = row[REPEATS_CHANGE], count = row[REPEATS_COUNT], scale = row[REPEATS_SCALE];
    real size, pace;
    row[REPEATS_CHANGE] = count > 0 ? y - row[REPEATS_LEFT] : 0;
    row[REPEATS_COUNT] += 1;
    if (count < 2) return;
    size = real_abs(row[REPEATS_CHANGE] - before) / REPEATS_QUANTILE;
    pace = 2 * real_max(1 / (count - 1), 1 / REPEATS_CHANGES);
    /* Up or down by a pace, but never beyond what was seen. */
    if (count < 3) row[REPEATS_SCALE] = size;
    else if (size > scale) row[REPEATS_SCALE] = real_min(size, scale * real_exp(REAL(0.7) * pace));
    else row[REPEATS_SCALE] = real_max(size, scale * real_exp(REAL(-0.3) * pace));
}

/* Whether a reading repeats the last one. White noise makes 6 r; what changes less is none. */
INLINE int repeats_again(const real z, const real r, const real *RESTRICT row) {
    return z == row[REPEATS_LAST] && row[REPEATS_SCALE] * row[REPEATS_SCALE] >= r &&
           real_abs(row[REPEATS_SELDOM]) >= REPEATS_RARE;
}

#endif

/* Whether a sensor is stuck, it repeats its last reading to the last bit, though its noise is white and in fine steps:
   robust_filterpy.correction.repeats in C. What is known of its readings is a row of numbers. */
#ifndef ROBUST_FILTERPY_REPEATS_H
#define ROBUST_FILTERPY_REPEATS_H

#include "real.h"

#define REPEATS_FINE REAL(10.0)    /* steps of a sensor in one of its noise, beyond which none repeats by chance */
#define REPEATS_CHANGES REAL(50.0) /* changes that are remembered */
#define REPEATS_QUANTILE REAL(1.0364333894937898) /* .7 of a normal |x| is below it */

/* What is left of the reading, the last change, the scale of their differences, how many; the last reading, and one
   over the least change, with a minus sign if the last reading repeated the one before. */
enum repeats_row {
    REPEATS_LEFT, REPEATS_CHANGE, REPEATS_SCALE, REPEATS_COUNT, REPEATS_LAST, REPEATS_STEP, REPEATS_WIDTH
};

/* Note a reading, r being the variance of its noise, and how fine the steps of its sensor are. One that goes on after
   it has repeated itself reads in coarse steps, or only now and then. A single small change is chance: it halves the
   steps that were known at most. */
INLINE void repeats_note_reading(const real z, const real r, real *RESTRICT row) {
    const real change = real_abs(z - row[REPEATS_LAST]), fine = real_max(row[REPEATS_STEP], 0);
    const real most = 2 * real_max(fine, 1 / real_sqrt(r));
    if (row[REPEATS_COUNT] > 0)
        row[REPEATS_STEP] = change == 0 ? -real_abs(row[REPEATS_STEP]) : real_max(fine, real_min(1 / change, most));
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
           real_abs(row[REPEATS_STEP]) * real_sqrt(r) >= REPEATS_FINE;
}

#endif

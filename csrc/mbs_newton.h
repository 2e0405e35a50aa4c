/* Steps of Newton's method in kernels, and when they have led to a solution. C99, reentrant. */
#ifndef MBS_NEWTON_H
#define MBS_NEWTON_H

#include "mbs_wires.h"

#ifdef MBS_STATES
typedef mbs_flags mbs_answer; /* of each state */
#define MBS_ALL(answer) mbs_are_all(answer)
#define MBS_UNLESS(answer, new_value, old_value) mbs_select(answer, old_value, new_value)

static inline int mbs_are_all(mbs_flags answer)
{
    int state, all = 1;
    for (state = 0; state < MBS_STATES; ++state)
        all &= answer[state] != 0;
    return all;
}
#else
typedef int mbs_answer;
#define MBS_ALL(answer) (answer)
#define MBS_UNLESS(answer, new_value, old_value) (new_value)
#endif

/* How far the method has come: the last step, and which states have their solution. */
typedef struct {
    mbs_real size;
    mbs_answer is_found;
} mbs_progress;

/* Take a step, the `number`th from 0. Returns whether the solution is found: the step was short, and a tenth of the one
 * before. A state with its solution stays there while others go on. */
static inline int mbs_take_step(int number, int n, const mbs_real *step, mbs_real *unknown, mbs_progress *progress)
{
    const mbs_real limit = MBS_SQRT(MBS_EVERY(MBS_EPSILON)), before = progress->size;
    mbs_answer is_short = limit <= limit;
    int i;
    if (number == 0)
        progress->is_found = limit < limit;
    progress->size = MBS_C(0.0);
    for (i = 0; i < n; ++i) {
        const mbs_real moved = unknown[i] + step[i];
        const mbs_real part = MBS_ABS(step[i]) / MBS_LARGER(MBS_ABS(moved), MBS_C(1.0));
        unknown[i] = MBS_UNLESS(progress->is_found, moved, unknown[i]);
        is_short &= part <= limit;
        progress->size = MBS_LARGER(part, progress->size);
    }
    progress->is_found |= number == 0 ? is_short : is_short & (MBS_C(10.0) * progress->size <= before);
    return MBS_ALL(progress->is_found);
}

#endif

/* One step of the recursion: eliminate rows, then free variables. */
#ifndef MBS_STAGES_STEP_H
#define MBS_STAGES_STEP_H

#include "recursion.h"

/* Reduce a step. `quadratic` holds the lower triangle of its cost row by row (overwritten); step->lu holds its rows.
 * Returns 0, or -1 if the cost is not positive definite in the free variables. Works in work[0 .. 1]. */
int mbs_stages_reduce(mbs_stages_step *p, real *quadratic, real *const *work, real zero_pivot, real zero_curvature);

/* Take the right-hand sides: `linear` of the cost, `constant` of the rows (overwritten). */
void mbs_stages_step_back(mbs_stages_step *p, const real *linear, real *constant, real *vector);

/* From x and the multipliers of the rows passed to x, find z = (x, v) and the multipliers of all rows. */
void mbs_stages_step_ahead(const mbs_stages_step *p, const real *x, const real *passed, real *z, real *y,
                           real *vector);

#endif

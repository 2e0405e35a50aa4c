/* Inner variables of a stage are taken out before the recursion, and found after it. */
#ifndef MBS_STAGES_CONDENSE_H
#define MBS_STAGES_CONDENSE_H

#include "recursion.h"

/* Find an order of pivots for kinds of stages that have none. */
void mbs_stages_order_pivots(mbs_stages_recursion *r);

/* Forget all orders, so that a solve does not depend on the solves before it. */
void mbs_stages_forget_orders(mbs_stages_recursion *r);

/* Let pivots of stages from `from` on be large where inner variables grow too much with the others; returns of how many
 * stages that is news. Where no digits are lost, much more growth is borne. */
int mbs_stages_mind_growth(mbs_stages_recursion *r, int from);

/* Write the dense matrices of stages from .. to - 1, by the diagonal that is there. Here and below, other stages may be
 * worked on at the same time, in other memory `m`. */
void mbs_stages_condense(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int from, int to);

/* The place of variable i in the recursion; -1 for an inner one. */
int mbs_stages_outer(const mbs_stages_stage *s, int i);

/* out += curvature z, for the recursion's variables among all variables z of a stage. */
void mbs_stages_apply_curvature(const mbs_stages_stage *s, const real *z, real *out);

/* How variable i changes with the recursion's variables, if it is an inner one; NULL: it is one of these. */
const real *mbs_stages_variation(const mbs_stages_stage *s, int i);

/* The first group of stages that begins at stage k or later; the stage after the group that begins at stage k. */
int mbs_stages_group(const mbs_stages_recursion *r, int k);
int mbs_stages_after_group(const mbs_stages_recursion *r, int k);

/* The inner variables of the group that begins at stage k, for all rows `rc`, by the factors that are there: `constant` of
 * each stage. They are Newton's corrections of these variables where the others stay. */
void mbs_stages_solve_inner(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rc);

/* Right-hand sides of stage k where the inner equations hold with all outer variables 0, by `constant`:
 * gradient += (H + diagonal) z, rows (e, d, g) += J z. */
void mbs_stages_condense_right(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, real *gradient,
                               real *rows);

/* out = VT gradient; `out` has room for the width. */
void mbs_stages_condense_gradient(const mbs_stages_stage *s, const real *gradient, real *out);

/* All variables z from the recursion's, which zeros fill up to the width. */
void mbs_stages_expand(const mbs_stages_stage *s, const real *outer, real *z);

/* Multipliers of the inner equations of a group. First comes the gradient by the inner variables of each stage k of it,
 * where dy holds all other multipliers; `force` takes the part of fixed variables in it (n numbers, overwritten). Then those
 * of the group that begins at stage k follow. */
void mbs_stages_expand_gradient(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rw,
                                const real *z, real *force, const real *dy);
void mbs_stages_expand_multipliers(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, real *dy);

#endif

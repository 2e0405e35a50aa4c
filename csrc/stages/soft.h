/* Dynamics that give: the next state is the prediction and a deviation that has its price. */
#ifndef MBS_STAGES_SOFT_H
#define MBS_STAGES_SOFT_H

#include "blocks.h"

/* The cost of a prediction, from the cost of the state. Rows of P have `width` numbers, the last ones 0. */
typedef struct {
    int n, width;
    real *rows, *sum; /* row i of the cost before deviation i; its diagonal entry and the price of the deviation */
    real *own;         /* entry i of the linear part before deviation i */
    real *P, *p;
    char *fixed;
} mbs_stages_soft;

/* Soften the cost x.P x / 2 by deviations t with the price t.t / (2 give); fixed states have no deviation but the one
 * that brings them to 0. Returns -1 if that is not convex. */
int mbs_stages_soften(mbs_stages_soft *s, const real *P, const real *give, const char *fixed, real zero_curvature);

/* The linear part of the cost. */
void mbs_stages_soften_linear(mbs_stages_soft *s, const real *p, const real *give);

/* From the prediction in x to the state; dy = -t / give. */
void mbs_stages_deviate(const mbs_stages_soft *s, const real *give, real *x, real *dy);

#endif

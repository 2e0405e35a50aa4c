/* Factorise sparse symmetric indefinite systems, for example of an interior-point method: P A PT = L D LT. */
#ifndef MBS_LDL_H
#define MBS_LDL_H

#include "mbs_front.h"
#include "mbs_plan.h"

typedef struct mbs_factors mbs_factors;

/* What a factorisation met. */
typedef struct {
    int failed;   /* memory ran out; nothing below counts */
    int negative; /* eigenvalues */
    int zeros;    /* unknowns without a pivot: 0, or the system is singular */
    int delayed;  /* times that an unknown had to wait, since its front had no pivot for it */
    int front;    /* rows of the largest front */
    long entries; /* of the factors */
} mbs_met;

/* Factors of systems with a common plan, which they hold. Returns NULL if memory runs out. */
mbs_factors *mbs_make_factors(mbs_plan *plan);
const mbs_plan *mbs_plan_of(const mbs_factors *factors);
void mbs_free_factors(mbs_factors *factors);

/* Factorise the system whose entries are `value`. */
mbs_met mbs_factorise(mbs_factors *factors, const double *value, const mbs_pivoting *pivoting);

/* x = A^-1 x, by the last factorisation, which neither failed nor met zeros. */
void mbs_solve(const mbs_factors *factors, double *x);

#endif

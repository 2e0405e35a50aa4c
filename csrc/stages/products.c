/* Steps that one bound would stop early, corrected (Mehrotra: On the implementation of a primal-dual interior point
 * method, 1992; Gondzio: Multiple centrality corrections in a primal-dual method for linear programming, 1996).
 *
 * A whole step makes the products of distances and multipliers mu + dx dz, not mu: its equations leave dx dz out. Where
 * a product is far from mu, the same factors give a correction for the rest. This happens after the barrier parameter
 * was lowered.
 *
 * Early steps, and steps with added curvature, are left alone: their lengths choose among the minima of a problem that
 * is not convex, and longer ones gain nothing. */
#include "solver.h"

#include <string.h>

/* What a product after the whole step lacks to be good. */
static real lack(real product, real mu)
{
    const real least = PRODUCT_LEAST * mu, most = PRODUCT_MOST * mu;
    if (product < least)
        return least - product;
    if (product > most)
        return product - most < most ? most - product : -most;
    return 0;
}

static real lack_below(const mbs_stages *s, const mbs_stages_phase *p, int i)
{
    return s->fixed[i] || !mbs_stages_has(p->lower[i]) ? 0 : lack(p->mu + p->step.x[i] * p->step.zl[i], p->mu);
}

static real lack_above(const mbs_stages *s, const mbs_stages_phase *p, int i)
{
    return s->fixed[i] || !mbs_stages_has(p->upper[i]) ? 0 : lack(p->mu - p->step.x[i] * p->step.zu[i], p->mu);
}

/* Add the step of x, z and y for these products to the one that is there. */
static void find_corrected(mbs_stages *s, mbs_stages_phase *p, mbs_stages_direction *d)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const real below = lack_below(s, p, i), above = lack_above(s, p, i);
        p->slope[i] = 0;
        if (below != 0)
            p->slope[i] -= below / (p->x[i] - p->lower[i]);
        if (above != 0)
            p->slope[i] += above / (p->upper[i] - p->x[i]);
    }
    memset(p->soc_c, 0, (size_t)s->rows * sizeof *p->soc_c);
    mbs_stages_newton_solve(s, p, p->soc_c, d);
    mbs_stages_stationarity(s, p, 1, p->slope);
    for (i = 0; i < p->size; ++i) {
        d->zl[i] = d->zu[i] = 0;
        if (!s->fixed[i] && mbs_stages_has(p->lower[i]))
            d->zl[i] = (lack_below(s, p, i) - p->zl[i] * d->x[i]) / (p->x[i] - p->lower[i]) + p->step.zl[i];
        if (!s->fixed[i] && mbs_stages_has(p->upper[i]))
            d->zu[i] = (lack_above(s, p, i) + p->zu[i] * d->x[i]) / (p->upper[i] - p->x[i]) + p->step.zu[i];
        d->x[i] += p->step.x[i];
    }
    for (i = 0; i < s->rows; ++i)
        d->y[i] += p->step.y[i];
}

void mbs_stages_correct_products(mbs_stages *s, mbs_stages_phase *p)
{
    const real before = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
    if (p->elastic || p->soft > 0 || p->watchdog.active || p->added > 0 || p->mu > CORRECTED_BELOW || before >= CORRECTED_SHORT)
        return;
    find_corrected(s, p, &p->other);
    if (mbs_stages_boundary(s, p, p->x, p->other.x, p->tau) >= before + CORRECTION_GAIN) {
        const mbs_stages_direction step = p->step;
        p->step = p->other;
        p->other = step;
    }
}

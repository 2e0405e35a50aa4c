/* The filter of Fletcher and Leyffer, 2002, as Waechter and Biegler, 2006, use it. */
#include "solver.h"

/* a <= b, up to the rounding of `base`. */
int mbs_stages_below(real a, real b, real base)
{
    return a - b <= 10 * MBS_STAGES_EPSILON * real_abs(base);
}

void mbs_stages_filter_clear(mbs_stages_filter *f)
{
    f->count = 0;
}

static void drop(mbs_stages_filter *f, int i)
{
    --f->count;
    f->theta[i] = f->theta[f->count];
    f->phi[i] = f->phi[f->count];
}

/* Add a pair, and drop the pairs that it implies. A full filter loses the pair with the largest violation. */
void mbs_stages_filter_add(mbs_stages_filter *f, real theta, real phi)
{
    int i, worst = 0;
    for (i = f->count - 1; i >= 0; --i)
        if (f->theta[i] >= theta && f->phi[i] >= phi)
            drop(f, i);
    for (i = 1; i < f->count; ++i)
        worst = f->theta[i] > f->theta[worst] ? i : worst;
    if (f->count == MBS_STAGES_ENTRIES)
        drop(f, worst);
    f->theta[f->count] = theta;
    f->phi[f->count] = phi;
    ++f->count;
}

int mbs_stages_filter_accepts(const mbs_stages_filter *f, real theta, real phi)
{
    int i;
    for (i = 0; i < f->count; ++i)
        if (!mbs_stages_below(theta, f->theta[i], f->theta[i]) && !mbs_stages_below(phi, f->phi[i], f->phi[i]))
            return 0;
    return 1;
}

#include "laws.h"

#include "../../../csrc/stages/filter.c"

static real theta[MBS_STAGES_ENTRIES + 1], phi[MBS_STAGES_ENTRIES + 1];

static int holds(const mbs_stages_filter *f, real a, real b)
{
    int i;
    for (i = 0; i < f->count; ++i)
        if (f->theta[i] == a && f->phi[i] == b)
            return 1;
    return 0;
}

int main(void)
{
    mbs_stages_filter f = {0, theta, phi};
    const real eps = MBS_STAGES_EPSILON;
    int i;
    theta[MBS_STAGES_ENTRIES] = 1e9; /* which no one may read */
    LAW("nothing is as good as nothing", mbs_stages_below(0, 0, 0));
    mbs_stages_filter_add(&f, 2, 2);
    mbs_stages_filter_add(&f, 1, 1);
    LAW("a better pair implies a worse one", f.count == 1 && holds(&f, 1, 1));
    mbs_stages_filter_add(&f, 1, 1);
    LAW("a pair is kept once", f.count == 1);
    mbs_stages_filter_add(&f, 2, 0);
    mbs_stages_filter_add(&f, 0, 2);
    LAW("pairs stay that are better in one way", f.count == 3 && holds(&f, 1, 1) && holds(&f, 2, 0));
    LAW("worse in both ways is refused", !mbs_stages_filter_accepts(&f, 1.5, 1.5));
    LAW("better in one way is accepted", mbs_stages_filter_accepts(&f, 0.5, 1.5));
    LAW("as good is accepted, but for rounding", mbs_stages_filter_accepts(&f, 1 + 5 * eps, 1 + 5 * eps));
    LAW("rounding is a few digits", !mbs_stages_filter_accepts(&f, 1 + 50 * eps, 1 + 50 * eps));
    LAW("rounding is relative", mbs_stages_below(100 + 900 * eps, 100, 100) && !mbs_stages_below(1 + 900 * eps, 1, 1));
    LAW("a size has no sign", mbs_stages_below(1 + 5 * eps, 1, -1));
    mbs_stages_filter_clear(&f);
    LAW("an empty filter accepts all", f.count == 0 && mbs_stages_filter_accepts(&f, 9, 9));
    for (i = 0; i < MBS_STAGES_ENTRIES; ++i)
        mbs_stages_filter_add(&f, (i * 7) % MBS_STAGES_ENTRIES, -(i * 7) % MBS_STAGES_ENTRIES);
    LAW("as many pairs as there is room for", f.count == MBS_STAGES_ENTRIES);
    mbs_stages_filter_add(&f, 3.5, -3.5);
    LAW("a full filter takes the new pair", f.count == MBS_STAGES_ENTRIES && holds(&f, 3.5, -3.5));
    LAW("and loses the largest violation", !holds(&f, MBS_STAGES_ENTRIES - 1, -(MBS_STAGES_ENTRIES - 1)));
    for (i = 0; i < MBS_STAGES_ENTRIES - 1; ++i)
        LAW("and no other", holds(&f, i, -i));
    mbs_stages_filter_clear(&f);
    for (i = 0; i < MBS_STAGES_ENTRIES; ++i)
        mbs_stages_filter_add(&f, MBS_STAGES_ENTRIES - i, i);
    mbs_stages_filter_add(&f, 0.5, MBS_STAGES_ENTRIES);
    LAW("the largest violation may be the oldest", !holds(&f, MBS_STAGES_ENTRIES, 0) && f.count == MBS_STAGES_ENTRIES);
    return broken > 0;
}

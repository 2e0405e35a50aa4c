/* IPOPT's face: see mbs_ipopt.h. */
#include "mbs_ipopt.h"

#include <stdlib.h>
#include <string.h>

#include "mbs_ldl.h"
#include "mbs_partners.h"

#define SINGULAR (-7)
#define NO_MEMORY (-1)
#define DELAYED 0.1 /* share of the unknowns that found no pivot in their fronts from which on the plan is renewed */
#define RENEWALS 2  /* how often */
#define DEAR 200.0  /* nanoseconds that an unknown may take; beyond them another plan is tried, */
#define BETTER 0.75 /* and taken if it takes this share of the time */

/* A system's pattern, and the plan for it, which is made when its values are known. */
typedef struct {
    int n;
    int *start, *row;
    char *weak; /* in any system for which it has been planned */
    int *partner;
    double *work;
    mbs_plan *plan;
    int renewals; /* how often the plan may still be renewed */
    int stale;    /* whether it is to be renewed */
} pattern;

typedef struct {
    mbs_factors *factors;
    int negative;
} factorisation;

void ma97_default_control_d(ipopt_settings *settings)
{
    memset(settings, 0, sizeof *settings);
}

void ma97_free_akeep_d(void **kept)
{
    pattern *p = *kept;
    if (!p)
        return;
    free(p->start);
    free(p->row);
    free(p->weak);
    free(p->partner);
    free(p->work);
    mbs_release_plan(p->plan);
    free(p);
    *kept = 0;
}

void ma97_free_fkeep_d(void **kept)
{
    factorisation *f = *kept;
    if (!f)
        return;
    mbs_free_factors(f->factors);
    free(f);
    *kept = 0;
}

void ma97_finalise_d(void **pattern_kept, void **factors_kept)
{
    ma97_free_fkeep_d(factors_kept);
    ma97_free_akeep_d(pattern_kept);
}

void ma97_analyse_d(int check, int n, const int *start, const int *row, const double *value, void **kept,
                    const ipopt_settings *settings, ipopt_report *report, int *order)
{
    const int base = settings->one_based ? 1 : 0, entries = start[n] - base;
    pattern *p = calloc(1, sizeof *p);
    int k;
    (void)check, (void)value, (void)order;
    ma97_free_akeep_d(kept);
    memset(report, 0, sizeof *report);
    report->flag = NO_MEMORY;
    if (!p)
        return;
    *kept = p;
    p->n = n;
    p->renewals = RENEWALS;
    p->start = malloc(((size_t)n + 1) * sizeof *p->start);
    p->row = malloc(((size_t)entries + 1) * sizeof *p->row);
    p->weak = calloc((size_t)n + 1, 1);
    p->work = malloc((2 * (size_t)n + 1) * sizeof *p->work);
    p->partner = malloc(((size_t)n + 1) * sizeof *p->partner);
    if (!p->start || !p->row || !p->weak || !p->partner || !p->work)
        return;
    for (k = 0; k <= n; ++k)
        p->start[k] = start[k] - base;
    for (k = 0; k < entries; ++k)
        p->row[k] = row[k] - base;
    report->flag = 0;
}

/* Return a plan in which all multipliers have partners, or only multipliers of weak variables; NULL if memory runs out. */
static mbs_plan *make_plan(pattern *p, const double *value, int all)
{
    if (mbs_find_partners(p->n, p->start, p->row, value, p->weak, all, p->partner))
        return 0;
    return mbs_make_plan(p->n, p->start, p->row, p->weak, p->partner);
}

/* Make the plan if there is none, or a better one is due. Returns -1 if memory runs out.
 *
 * With partners multipliers find their pivots, whatever the variables' diagonal entries become, and as a rule fill is
 * less. Without them variables are eliminated first, and sometimes fill is much less. */
static int plan_for(pattern *p, const double *value)
{
    if (p->stale) {
        mbs_release_plan(p->plan);
        p->plan = 0;
        p->stale = 0;
    }
    if (!p->plan) {
        mbs_mark_weak(p->n, p->start, p->row, value, p->weak, p->work);
        p->plan = make_plan(p, value, 1);
        if (p->plan && p->plan->expected > DEAR * p->n) {
            mbs_plan *other = make_plan(p, value, 0);
            if (other && other->expected < BETTER * p->plan->expected) {
                mbs_release_plan(p->plan);
                p->plan = other;
            } else
                mbs_release_plan(other);
        }
    }
    return p->plan ? 0 : -1;
}

/* Return the kept factors, made anew if they belong to another plan; NULL if memory runs out. */
static factorisation *hold_factorisation(mbs_plan *plan, void **kept)
{
    factorisation *f = *kept;
    if (f && f->factors && mbs_plan_of(f->factors) != plan) {
        mbs_free_factors(f->factors);
        f->factors = 0;
    }
    if (!f) {
        f = calloc(1, sizeof *f);
        *kept = f;
    }
    if (f && !f->factors)
        f->factors = mbs_make_factors(plan);
    return f && f->factors ? f : 0;
}

void ma97_factor_d(int type, const int *start, const int *row, const double *value, void **pattern_kept,
                   void **factors_kept, const ipopt_settings *settings, ipopt_report *report, double *scale)
{
    pattern *p = *pattern_kept;
    const mbs_pivoting pivoting = {settings->threshold, settings->zero};
    factorisation *f;
    mbs_met met;
    (void)type, (void)start, (void)row, (void)scale;
    memset(report, 0, sizeof *report);
    report->flag = NO_MEMORY;
    if (plan_for(p, value))
        return;
    f = hold_factorisation(p->plan, factors_kept);
    if (!f)
        return;
    met = mbs_factorise(f->factors, value, &pivoting);
    if (met.failed)
        return;
    if (p->renewals && met.delayed > DELAYED * p->n) {
        --p->renewals;
        p->stale = 1;
    }
    f->negative = met.negative;
    report->flag = met.zeros ? SINGULAR : 0;
    report->negative = met.negative;
    report->rank = p->n - met.zeros;
    report->delayed = met.delayed;
    report->front = met.front;
    report->entries = met.entries;
}

void ma97_solve_d(int job, int count, double *x, int stride, void **pattern_kept, void **factors_kept,
                  const ipopt_settings *settings, ipopt_report *report)
{
    const factorisation *f = *factors_kept;
    int k;
    (void)job, (void)pattern_kept, (void)settings;
    memset(report, 0, sizeof *report);
    report->negative = f->negative;
    for (k = 0; k < count; ++k)
        mbs_solve(f->factors, x + (size_t)k * (size_t)stride);
}

void ma97_factor_solve_d(int type, const int *start, const int *row, const double *value, int count, double *x,
                         int stride, void **pattern_kept, void **factors_kept, const ipopt_settings *settings,
                         ipopt_report *report, double *scale)
{
    ma97_factor_d(type, start, row, value, pattern_kept, factors_kept, settings, report, scale);
    if (report->flag == 0)
        ma97_solve_d(0, count, x, stride, pattern_kept, factors_kept, settings, report);
}

/* Feasibility restoration: minimise the violation, near the point where it began.
 *
 *     minimise  PENALTY sum (p + n) + sqrt(mu) / 2 |weight (w - reference)|^2   such that   c(w) - p + n = 0,
 *     p, n >= 0,
 *
 * in the same stages: p and n belong to one row each (Waechter, Biegler, 2006, section 3.3). Inner rows have none and
 * hold exactly. It ends at the first
 * iterate that the filter of the caller's problem accepts, or at a least violation. */
#include "solver.h"

#include <string.h>

static void copy_main(real *to, const real *from, int n)
{
    memcpy(to, from, (size_t)n * sizeof *to);
}

/* The p and n of least barrier cost for a residual c. */
static void split_residual(real c, real mu, real penalty, real *plus, real *minus)
{
    const real a = (mu - penalty * c) / (2 * penalty), b = mu * c / (2 * penalty);
    const real root = real_sqrt(a * a + b > 0 ? a * a + b : 0);
    *minus = a >= 0 || !(root - a > 0) ? a + root : b / (root - a);
    *plus = c + *minus;
    if (!(*minus > 0))
        *minus = mu / penalty;
    if (!(*plus > 0))
        *plus = mu / penalty;
}

/* Inner rows hold exactly in restoration too, as their variables are condensed by them. */
static void fix_inner_rows(mbs_stages *s)
{
    char *plus = s->fixed + s->variables + s->slacks, *minus = plus + s->rows;
    int k;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        memset(plus + t->e, 1, (size_t)t->inner.n);
        memset(minus + t->e, 1, (size_t)t->inner.n);
    }
}

static void start_elastics(mbs_stages *s, mbs_stages_phase *q)
{
    const int plus = s->variables + s->slacks, minus = plus + s->rows;
    int i;
    fix_inner_rows(s);
    for (i = 0; i < s->rows; ++i)
        if (s->fixed[plus + i])
            q->x[plus + i] = q->x[minus + i] = 0;
        else
            split_residual(s->main.c[i], q->mu, s->options.resto_penalty_parameter, &q->x[plus + i], &q->x[minus + i]);
    for (i = plus; i < q->size; ++i) {
        q->lower[i] = 0;
        q->upper[i] = 2 * MBS_STAGES_INFINITE;
        q->zl[i] = s->fixed[i] ? 0 : q->mu / q->x[i];
        q->zu[i] = 0;
    }
}

static int start(mbs_stages *s)
{
    const mbs_stages_phase *p = &s->main;
    mbs_stages_phase *q = &s->least;
    const int n = s->variables + s->slacks;
    const real worst = mbs_stages_largest(s->rows, p->c), penalty = s->options.resto_penalty_parameter;
    int i;
    q->mu = p->mu > worst ? p->mu : worst;
    copy_main(q->x, p->x, n);
    copy_main(q->lower, p->lower, n);
    copy_main(q->upper, p->upper, n);
    copy_main(s->reference, p->x, s->variables);
    for (i = 0; i < s->variables; ++i)
        s->weight[i] = real_abs(p->x[i]) > 1 ? 1 / real_abs(p->x[i]) : 1;
    for (i = 0; i < n; ++i) {
        q->zl[i] = p->zl[i] < penalty ? p->zl[i] : penalty;
        q->zu[i] = p->zu[i] < penalty ? p->zu[i] : penalty;
    }
    start_elastics(s, q);
    memset(q->y, 0, (size_t)s->rows * sizeof *q->y);
    s->weight_factor = real_sqrt(q->mu);
    if (mbs_stages_phase_values(s, q, q->x, &q->cost, q->c))
        return -1;
    mbs_stages_begin(s, q);
    return 0;
}

/* Violation of the caller's rows: without p and n. */
static real violation(const mbs_stages *s, int row)
{
    const real *plus = s->least.x + s->variables + s->slacks, *minus = plus + s->rows;
    return s->least.c[row] + plus[row] - minus[row];
}

real mbs_stages_worst_violation(const mbs_stages *s)
{
    real worst = 0;
    int i;
    for (i = 0; i < s->rows; ++i)
        worst = real_abs(violation(s, i)) > worst ? real_abs(violation(s, i)) : worst;
    return worst;
}

/* Whether the caller's problem can go on from here. */
int mbs_stages_restored(mbs_stages *s)
{
    const mbs_stages_phase *p = &s->main, *q = &s->least;
    real theta = 0, cost;
    int i;
    for (i = 0; i < s->rows; ++i)
        theta += real_abs(violation(s, i));
    if (!(mbs_stages_worst_violation(s) <= s->options.required_infeasibility_reduction * mbs_stages_largest(s->rows, p->c)))
        return 0;
    if (mbs_stages_phase_values(s, p, q->x, &cost, s->main.trial_c))
        return 0;
    return mbs_stages_filter_accepts(&p->filter, theta, mbs_stages_barrier(s, p, q->x, cost));
}

static void reset_bounds(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const int fixed = s->fixed[i];
        p->zl[i] = !fixed && real_abs(p->lower[i]) < MBS_STAGES_INFINITE ? 1 : 0;
        p->zu[i] = !fixed && real_abs(p->upper[i]) < MBS_STAGES_INFINITE ? 1 : 0;
    }
}

/* Multipliers of bounds follow the way of x, or start anew where they are large. */
static void follow_bounds(mbs_stages *s, mbs_stages_phase *p)
{
    const real large = s->options.bound_mult_reset_threshold;
    real alpha, most;
    int i;
    for (i = 0; i < p->size; ++i)
        p->step.x[i] = s->least.x[i] - p->x[i];
    mbs_stages_bound_steps(s, p, &p->step);
    alpha = mbs_stages_dual_boundary(s, p, &p->step);
    for (i = 0; i < p->size; ++i) {
        p->zl[i] += alpha * p->step.zl[i];
        p->zu[i] += alpha * p->step.zu[i];
    }
    most = mbs_stages_largest(p->size, p->zl);
    if (!(most <= large) || !(mbs_stages_largest(p->size, p->zu) <= large))
        reset_bounds(s, p);
}

/* Go on with the caller's problem at the point of restoration. */
static int resume(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    const int n = s->variables + s->slacks;
    follow_bounds(s, p);
    copy_main(p->x, s->least.x, n);
    copy_main(p->lower, s->least.lower, n);
    copy_main(p->upper, s->least.upper, n);
    memset(p->y, 0, (size_t)s->rows * sizeof *p->y);
    p->tiny = p->rejected = p->acceptable = 0;
    mbs_stages_search_anew(p);
    s->softening = MBS_STAGES_HARD;
    if (mbs_stages_phase_values(s, p, p->x, &p->cost, p->c))
        return MBS_STAGES_CALLBACK_FAILED;
    return MBS_STAGES_RUNNING;
}

static mbs_stages_clash describe(const mbs_stages *s, int k, int row)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    mbs_stages_clash clash;
    clash.stage = k;
    clash.kind = row < t->d ? MBS_STAGES_EQUALITY : row < t->g ? MBS_STAGES_DYNAMICS : MBS_STAGES_INEQUALITY;
    clash.row = row - (row < t->d ? t->e : row < t->g ? t->d : t->g);
    clash.violation = real_abs(s->main.c[row]) / s->row_scale[row];
    return clash;
}

/* Put a clash into its place: the worst come first. */
static void insert(mbs_stages_result *r, mbs_stages_clash clash)
{
    int i = r->clashes < MBS_STAGES_CLASHES ? r->clashes : MBS_STAGES_CLASHES;
    ++r->clashes;
    for (; i > 0 && r->clash[i - 1].violation < clash.violation; --i)
        if (i < MBS_STAGES_CLASHES)
            r->clash[i] = r->clash[i - 1];
    if (i < MBS_STAGES_CLASHES)
        r->clash[i] = clash;
}

/* List the rows whose violation stays: those beyond the tolerance, and not small beside the worst. */
static void find_clashes(mbs_stages *s)
{
    const real worst = mbs_stages_largest(s->rows, s->main.c) / 1000, tolerance = 10 * s->options.tol;
    const real least = worst > tolerance ? worst : tolerance;
    int k, i;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = t->e; i < t->g + t->ng; ++i)
            if (real_abs(s->main.c[i]) > least)
                insert(&s->result, describe(s, k, i));
    }
}

/* Restoration found no point to go on from. */
static int conclude(mbs_stages *s, int status)
{
    const int stays = mbs_stages_largest(s->rows, s->main.c) > 100 * s->options.tol;
    if (status != MBS_STAGES_SOLVED && status != MBS_STAGES_ACCEPTABLE)
        return status;
    if (!stays)
        return MBS_STAGES_OUT_OF_DIGITS;
    find_clashes(s);
    return MBS_STAGES_INFEASIBLE;
}

/* Returns MBS_STAGES_RUNNING where the caller's problem can go on, or a status. */
int mbs_stages_restore(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    int status;
    if (mbs_stages_largest(s->rows, p->c) <= s->options.tol)
        return MBS_STAGES_OUT_OF_DIGITS;
    mbs_stages_filter_add(&p->filter, p->theta, p->phi);
    if (start(s))
        return MBS_STAGES_CALLBACK_FAILED;
    status = mbs_stages_run(s, &s->least);
    if (status != MBS_STAGES_CALLBACK_FAILED) {
        const int after = resume(s);
        if (status == MBS_STAGES_RESTORED)
            return after;
    }
    return conclude(s, status);
}

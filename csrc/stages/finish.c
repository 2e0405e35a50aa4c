/* Termination: what the errors, the clock and the iterate say. */
#include "solver.h"

static int is_late(const mbs_stages *s)
{
    const mbs_stages_problem *p = s->problem;
    return p->clock && s->options.max_wall_time > 0 && p->clock(p->context) - s->began >= s->options.max_wall_time;
}

/* The cost of distances, kappa_d mu, is not in the conditions; it does not vanish where mu stays. */
int mbs_stages_is_solved(const mbs_stages *s, const mbs_stages_errors *e, real tolerance)
{
    const real most = s->options.constr_viol_tol, stays = (real)1.01 * s->options.kappa_d * mbs_stages_least_barrier(s);
    return e->scaled <= (tolerance > stays ? tolerance : stays) && e->violation <= most && e->complementarity / s->cost_scale <= most;
}

static int is_acceptable(mbs_stages *s, mbs_stages_phase *p, const mbs_stages_errors *e)
{
    const int counts = !s->is_sharper && mbs_stages_is_solved(s, e, s->options.acceptable_tol);
    p->acceptable = counts ? p->acceptable + 1 : 0;
    return s->options.acceptable_iter > 0 && p->acceptable >= s->options.acceptable_iter;
}

/* Whether rows alone are above a small tolerance, by amounts that steps lower no more: they are rounding. */
static int is_rounded(mbs_stages *s, mbs_stages_phase *p, const mbs_stages_errors *e)
{
    const real worst = mbs_stages_largest(s->rows, p->c);
    const int close = !p->elastic && e->dual <= s->options.tol && worst <= ROUNDED * s->options.acceptable_tol;
    const int falls = !p->rounding || worst < ROUNDED_GAIN * p->rounded;
    p->rounding = close ? (falls ? 1 : p->rounding + 1) : 0;
    p->rounded = falls ? worst : p->rounded;
    return p->rounding >= MOST_ROUNDED;
}

/* Whether restoration is at a least violation. Elastic variables keep some mu / penalty by themselves; a violation far
 * beyond that stays, however small mu becomes, and a smaller mu would only cost digits. */
static int is_least(mbs_stages *s, mbs_stages_phase *p)
{
    const real worst = mbs_stages_worst_violation(s);
    return p->elastic && p->mu <= LEAST_FROM && worst > LEAST_BEYOND * p->mu &&
           mbs_stages_measure_errors(s, p, p->mu).scaled <= 10 * p->mu + mbs_stages_rounding(p);
}

/* What small changes lower the cost by at most, to first order: its derivatives, with the rows' multipliers, times the
 * ways that bounds leave, which are no longer than the numbers (weak duality). */
static real find_decrease(const mbs_stages *s, const mbs_stages_phase *p)
{
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        const real slope = p->lagrangian[i], size = mbs_stages_bound_size(p->x[i]);
        const real way = slope > 0 ? p->x[i] - p->lower[i] : p->upper[i] - p->x[i];
        if (!s->fixed[i])
            sum += real_abs(slope) * (way < size ? way : size);
    }
    return sum;
}

/* What bounds that give change the cost by, at most: multipliers times ways. */
static real find_leeway(const mbs_stages *s, const mbs_stages_phase *p)
{
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        if (!s->fixed[i] && mbs_stages_has(p->lower[i]))
            sum += p->zl[i] * s->giving * mbs_stages_bound_size(p->lower[i]);
        if (!s->fixed[i] && mbs_stages_has(p->upper[i]))
            sum += p->zu[i] * s->giving * mbs_stages_bound_size(p->upper[i]);
    }
    return sum;
}

/* The part of the cost that a solution decides at least. A loose tolerance asks for less. */
static real sizable(const mbs_stages *s)
{
    return mbs_stages_is_loose(s) ? mbs_stages_larger(real_sqrt(s->options.tol), MBS_STAGES_SIZABLE) : MBS_STAGES_SIZABLE;
}

/* The part that a solve goes on for: in a loop, the next sample comes soon. */
static real worthwhile(const mbs_stages *s)
{
    return mbs_stages_continues(s) ? MBS_STAGES_SIZABLE : MBS_STAGES_DECIDED;
}

/* Whether the cost is known to a part of it, or is 0: to a tolerance, or to the amount that bounds give. A requested barrier
 * decides it, too. After a warm start the part is of the largest cost of the solves that followed each other: a controller
 * that has come to its target has little left to gain. */
static int is_decided(const mbs_stages *s, const mbs_stages_phase *p, real tolerance, real part)
{
    const real cost = real_abs(p->cost);
    if (p->elastic || mbs_stages_least_barrier(s) > 0 || cost <= tolerance * s->cost_scale || cost <= find_leeway(s, p))
        return 1;
    return find_decrease(s, p) <= part * mbs_stages_larger(cost, s->cost_before);
}

/* Whether a solve that goes on has come far enough: what small changes lower the cost by is far below what it decides. */
static int is_far_enough(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_errors *e)
{
    const real cost = mbs_stages_larger(real_abs(p->cost), s->cost_before);
    return s->is_sharper && !p->elastic && mbs_stages_is_solved(s, e, s->asked) &&
           find_decrease(s, p) <= FAR_BELOW * worthwhile(s) * cost;
}

/* Go on with a smaller tolerance where small changes may lower the cost by a sizable part of it; returns whether. A loose
 * tolerance asks for a quick end. */
static int goes_on(mbs_stages *s, const mbs_stages_phase *p)
{
    const real finer = mbs_stages_larger(SHARPER * s->options.tol, MBS_STAGES_FINEST);
    if (s->is_sharper || mbs_stages_is_loose(s) || !(finer < s->options.tol) || is_decided(s, p, finer, worthwhile(s)))
        return 0;
    s->asked = s->options.tol;
    s->options.tol = finer;
    s->is_sharper = 1;
    return 1;
}

/* A status, or MBS_STAGES_RUNNING. Restoration is solved at a least violation above 0, which is a contradiction. */
int mbs_stages_check(mbs_stages *s, mbs_stages_phase *p, const mbs_stages_errors *e)
{
    if (is_least(s, p))
        return MBS_STAGES_SOLVED;
    if (mbs_stages_is_solved(s, e, s->options.tol) && !goes_on(s, p))
        return MBS_STAGES_SOLVED;
    if (is_far_enough(s, p, e) || is_rounded(s, p, e))
        return MBS_STAGES_SOLVED;
    if (is_acceptable(s, p, e))
        return MBS_STAGES_ACCEPTABLE;
    if (s->result.iterations >= s->options.max_iter)
        return MBS_STAGES_ITERATION_LIMIT;
    if (is_late(s))
        return MBS_STAGES_TIME_LIMIT;
    if (!(mbs_stages_largest(s->variables, p->x) < s->options.diverging_iterates_tol))
        return MBS_STAGES_UNBOUNDED;
    return MBS_STAGES_RUNNING;
}

/* A solve without further progress ends acceptably where the conditions hold to the acceptable tolerance; so does one
 * that went on, and one whose cost is not decided. */
int mbs_stages_settle(mbs_stages *s, mbs_stages_phase *p, int status)
{
    mbs_stages_errors e;
    if (status == MBS_STAGES_SOLVED)
        return is_decided(s, p, s->options.tol, sizable(s)) ? MBS_STAGES_SOLVED : MBS_STAGES_ACCEPTABLE;
    if (!(status == MBS_STAGES_OUT_OF_DIGITS || s->is_sharper) || p->elastic || mbs_stages_phase_derivatives(s, p))
        return status;
    mbs_stages_find_lagrangian(s, p);
    e = mbs_stages_measure_errors(s, p, mbs_stages_least_barrier(s));
    return mbs_stages_is_solved(s, &e, s->options.acceptable_tol) ? MBS_STAGES_ACCEPTABLE : status;
}

void mbs_stages_report(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_errors *e)
{
    mbs_stages_progress progress;
    progress.iteration = s->result.iterations;
    progress.restoring = p->elastic;
    progress.cost = p->cost;
    progress.violation = mbs_stages_largest(s->rows, p->c);
    progress.stationarity = e->stationarity;
    progress.barrier = p->mu;
    progress.step = p->alpha;
    progress.curvature = p->added;
    s->problem->watch(s->problem->context, &progress);
}

const char *mbs_stages_explain(mbs_stages_status status)
{
    switch (status) {
    case MBS_STAGES_SOLVED:
        return "The optimality conditions hold to the tolerance.";
    case MBS_STAGES_ACCEPTABLE:
        return "The optimality conditions hold to the acceptable tolerance, or the cost may still fall by a sizable part; "
               "no further progress was made.";
    case MBS_STAGES_INFEASIBLE:
        return "The violation has a local minimum above zero; the rows that clash are listed.";
    case MBS_STAGES_ITERATION_LIMIT:
        return "The limit of iterations was reached.";
    case MBS_STAGES_TIME_LIMIT:
        return "The limit of time was reached.";
    case MBS_STAGES_OUT_OF_DIGITS:
        return "No step makes progress in this precision.";
    case MBS_STAGES_UNBOUNDED:
        return "The variables grow without limit.";
    case MBS_STAGES_CALLBACK_FAILED:
        return "A callback returned no result, or no finite one.";
    case MBS_STAGES_BAD_PROBLEM:
        return "Bounds cross, more are equal than at first, a measurement is not finite, or a scale is not positive.";
    case MBS_STAGES_PREPARED:
        return "A step is ready for feedback.";
    case MBS_STAGES_STEPPED:
        return "A step was made.";
    case MBS_STAGES_NOT_PREPARED:
        return "Feedback needs a preparation that succeeded.";
    case MBS_STAGES_DIVERGED:
        return "The steps have diverged: the plan violates its equations too much for a step. Solve anew.";
    }
    return "This status is unknown.";
}

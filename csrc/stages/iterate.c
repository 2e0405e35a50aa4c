/* The iterations of a barrier problem: errors, barrier parameter, Newton's step, line search. */
#include "solver.h"

#include <string.h>

/* Start the filter, and the limits of the violation, at x. */
void mbs_stages_begin(mbs_stages *s, mbs_stages_phase *p)
{
    const real theta = mbs_stages_sum(s->rows, p->c), size = theta > 1 ? theta : 1;
    p->theta_most = s->options.theta_max_fact * size;
    p->theta_least = s->options.theta_min_fact * size;
    p->tau = mbs_stages_larger(1 - p->mu, s->options.tau_min);
    p->tiny = p->tiny_before = p->rejected = p->resets = p->acceptable = p->rounding = p->failing = 0;
    p->shortened = p->cautious = p->cut = 0;
    p->regular = p->added = p->restraint = p->alpha = 0;
    mbs_stages_search_anew(p);
    mbs_stages_filter_clear(&p->filter);
}

/* Whether a whole step without added curvature brought the rows nearer, as near as the fourth root of the barrier
 * parameter, and left the products of distances and multipliers near it. Then its problem need not be solved to the
 * end. Other errors count only as long as they may choose among minima. */
static int is_followed(mbs_stages *s, mbs_stages_phase *p)
{
    if (p->elastic || p->soft > 0 || p->watchdog.active || p->mu > FOLLOWED_BELOW)
        return 0;
    if (p->added > 0 || p->alpha < FOLLOWED_FROM || (p->theta > p->theta_before && p->theta > s->options.tol))
        return 0;
    if (mbs_stages_largest(s->rows, p->c) > real_sqrt(real_sqrt(p->mu)))
        return 0;
    if (mbs_stages_measure_errors(s, p, 0).complementarity > s->options.barrier_tol_factor * p->mu)
        return 0;
    return p->mu <= FOLLOWED_ANYHOW || mbs_stages_measure_errors(s, p, p->mu).scaled <= FOLLOWED_WITHIN * p->mu;
}

/* Lower the barrier parameter while its problem is solved well enough, and once where a step followed it; superlinearly
 * near the end. */
static int lower_barrier(mbs_stages *s, mbs_stages_phase *p)
{
    const mbs_stages_options *o = &s->options;
    const real allowed = o->barrier_tol_factor;
    const real fixed = p->elastic ? 0 : mbs_stages_least_barrier(s);
    const real products = o->constr_viol_tol * s->cost_scale; /* of distances and multipliers */
    const real tolerance = o->tol < products ? o->tol : products;
    const real zero = tolerance / (allowed + 1), least = fixed > zero ? fixed : zero;
    int force = p->tiny && p->tiny_before;
    const real factor = p->added > 0 || p->elastic ? allowed : CONVEX_FACTOR * allowed;
    const real rounding = mbs_stages_rounding(p);
    int followed = p->mu > least && is_followed(s, p);
    while (force || followed || mbs_stages_measure_errors(s, p, p->mu).scaled <= factor * p->mu + rounding) {
        const real a = o->mu_linear_decrease_factor * p->mu;
        const real b = real_pow(p->mu, o->mu_superlinear_decrease_power), lower = a < b ? a : b;
        if (p->mu <= least)
            return force ? -1 : 0;
        p->mu = lower > least ? lower : least;
        p->tau = mbs_stages_larger(1 - p->mu, s->options.tau_min);
        p->rejected = 0;
        mbs_stages_search_anew(p);
        mbs_stages_filter_clear(&p->filter);
        mbs_stages_reweigh(s, p);
        force = followed = 0;
    }
    return 0;
}

/* Keep z near mu / distance, and the distance from 0. */
static void mend_bound(real *x, real *bound, real *z, real mu, real kappa, real sign)
{
    const real least = MBS_STAGES_APART * mbs_stages_bound_size(*bound);
    real distance = sign * (*x - *bound);
    if (!(distance > MBS_STAGES_EPSILON * mu)) {
        *bound -= sign * least;
        distance = sign * (*x - *bound);
    }
    if (*z > kappa * mu / distance)
        *z = kappa * mu / distance;
    if (*z < mu / (kappa * distance))
        *z = mu / (kappa * distance);
}

void mbs_stages_mend_bounds(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        if (s->fixed[i])
            continue;
        if (real_abs(p->lower[i]) < MBS_STAGES_INFINITE)
            mend_bound(&p->x[i], &p->lower[i], &p->zl[i], p->mu, s->options.kappa_sigma, 1);
        if (real_abs(p->upper[i]) < MBS_STAGES_INFINITE)
            mend_bound(&p->x[i], &p->upper[i], &p->zu[i], p->mu, s->options.kappa_sigma, -1);
    }
}

/* Whether dependent rows keep half of the violation, whatever the step. */
static int contradict(const mbs_stages *s, const mbs_stages_phase *p)
{
    const real worst = mbs_stages_largest(s->rows, p->c);
    return worst > s->options.tol && s->left > worst / 2;
}

static int find_step(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    s->exact = 0;
    if (mbs_stages_newton_factorise(s, p))
        return -1;
    mbs_stages_stationarity(s, p, 1, p->slope);
    mbs_stages_newton_solve(s, p, p->c, &p->step);
    for (i = 0; i < p->size; ++i)
        if (!(real_abs(p->step.x[i]) <= MBS_STAGES_LARGEST))
            return -1;
    if (contradict(s, p))
        return -1;
    mbs_stages_correct_products(s, p);
    return 0;
}

/* Begin a warm start anew, farther from bounds; a status, which is `status` where it needs that no more. */
static int begin_anew(mbs_stages *s, mbs_stages_phase *p, int status)
{
    const int begun = s->farther > 0 ? mbs_stages_start_farther(s, p) : 0;
    return begun > 0 ? MBS_STAGES_RUNNING : begun < 0 ? MBS_STAGES_CALLBACK_FAILED : status;
}

/* No step: restore feasibility, or end. A warm start may be too near to bounds for any step. */
static int leave(mbs_stages *s, mbs_stages_phase *p)
{
    int status;
    if (p->failing)
        return MBS_STAGES_CALLBACK_FAILED;
    if (p->elastic)
        return MBS_STAGES_OUT_OF_DIGITS;
    status = mbs_stages_restore(s);
    return status == MBS_STAGES_OUT_OF_DIGITS ? begin_anew(s, p, status) : status;
}

static int search(mbs_stages *s, mbs_stages_phase *p)
{
    const int gentle = p->soft > 0;
    return mbs_stages_search(s, p) && (gentle || p->failing || mbs_stages_search_softly(s, p)) ? -1 : 0;
}

/* Whether the first step of a warm start is short, or there is none. */
static int is_far(const mbs_stages *s, const mbs_stages_phase *p, int failed)
{
    return failed || mbs_stages_boundary(s, p, p->x, p->step.x, p->tau) < WARM_STEP ||
           mbs_stages_dual_boundary(s, p, &p->step) < WARM_STEP;
}

static int advance(mbs_stages *s, mbs_stages_phase *p)
{
    const int begins = s->result.iterations == 0 && !p->elastic;
    int failed;
    if (lower_barrier(s, p))
        return MBS_STAGES_OUT_OF_DIGITS;
    if (mbs_stages_phase_hessian(s, p))
        return MBS_STAGES_CALLBACK_FAILED;
    p->theta = mbs_stages_sum(s->rows, p->c);
    p->phi = mbs_stages_barrier(s, p, p->x, p->cost);
    failed = find_step(s, p);
    if (begins && s->farther > 0 && is_far(s, p, failed)) {
        const int begun = begin_anew(s, p, MBS_STAGES_SOLVED);
        if (begun != MBS_STAGES_SOLVED)
            return begun;
    }
    if (failed ? mbs_stages_search_without_step(s, p) : search(s, p)) {
        const int status = leave(s, p);
        if (status != MBS_STAGES_RUNNING)
            return status;
    }
    mbs_stages_mend_bounds(s, p);
    ++s->result.iterations;
    s->result.restorations += p->elastic;
    return MBS_STAGES_RUNNING;
}

int mbs_stages_run(mbs_stages *s, mbs_stages_phase *p)
{
    for (;;) {
        mbs_stages_errors errors;
        int status;
        if (mbs_stages_phase_derivatives(s, p))
            return MBS_STAGES_CALLBACK_FAILED;
        mbs_stages_find_lagrangian(s, p);
        errors = mbs_stages_measure_errors(s, p, p->elastic ? 0 : mbs_stages_least_barrier(s));
        if (s->problem->watch)
            mbs_stages_report(s, p, &errors);
        if (p->elastic && mbs_stages_restored(s))
            return MBS_STAGES_RESTORED;
        status = mbs_stages_check(s, p, &errors);
        if (status == MBS_STAGES_RUNNING)
            status = advance(s, p);
        if (status == MBS_STAGES_SOLVED && !p->elastic) {
            p->restraint = 0;
            mbs_stages_polish(s, p);
        }
        if (status != MBS_STAGES_RUNNING)
            return mbs_stages_settle(s, p, status);
    }
}

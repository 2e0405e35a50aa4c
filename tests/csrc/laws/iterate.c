#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/iterate.c"

/* Stand-ins: errors that do not depend on the point, and what Newton's method and the search return. */
static struct {
    mbs_stages_errors errors;
    real least, boundary, dual, step, mu;
    int factorised, searched, soft, restored, corrected, derivatives, hessian, farther, back, after, polished, without;
    int searches, reports, barrier, statuses[3];
} given;

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    (void)s, (void)p;
    given.mu = mu;
    return given.errors;
}

real mbs_stages_least_barrier(const mbs_stages *s)
{
    (void)s;
    return given.least;
}

void mbs_stages_reweigh(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.factorised;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p, (void)out;
    given.barrier = barrier;
}

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s, (void)p, (void)c;
    d->x[0] = given.step;
}

void mbs_stages_correct_products(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    ++given.corrected;
}

int mbs_stages_search(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s;
    ++given.searches;
    p->x[0] += given.searched ? 0 : p->step.x[0];
    return given.searched;
}

int mbs_stages_search_softly(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.soft;
}

int mbs_stages_restore(mbs_stages *s)
{
    (void)s;
    return given.restored;
}

real mbs_stages_boundary(const mbs_stages *s, const mbs_stages_phase *p, const real *x, const real *dx, real tau)
{
    (void)s, (void)p, (void)x, (void)dx, (void)tau;
    return given.boundary;
}

real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d)
{
    (void)s, (void)p, (void)d;
    return given.dual;
}

int mbs_stages_search_without_step(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.without;
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.derivatives;
}

int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.hessian;
}

real mbs_stages_barrier(const mbs_stages *s, const mbs_stages_phase *p, const real *x, real cost)
{
    (void)s, (void)p;
    return x[0] + cost;
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

int mbs_stages_start_farther(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.farther;
}

void mbs_stages_report(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_errors *e)
{
    (void)s, (void)p, (void)e;
    ++given.reports;
}

int mbs_stages_restored(mbs_stages *s)
{
    (void)s;
    return given.back;
}

int mbs_stages_check(mbs_stages *s, mbs_stages_phase *p, const mbs_stages_errors *e)
{
    (void)p, (void)e;
    return given.statuses[s->result.iterations < 2 ? s->result.iterations : 2];
}

void mbs_stages_polish(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    ++given.polished;
}

int mbs_stages_settle(mbs_stages *s, mbs_stages_phase *p, int status)
{
    (void)s, (void)p;
    given.after = status;
    return status + 100;
}

static void watch(void *context, const mbs_stages_progress *progress)
{
    (void)context, (void)progress;
}

static real room[12][2], pairs[2][MBS_STAGES_ENTRIES];
static char fixed[2];
static mbs_stages solver;
static mbs_stages_phase phase;

static void anew(mbs_stages *s, mbs_stages_phase *p)
{
    memset(s, 0, sizeof *s);
    memset(p, 0, sizeof *p);
    memset(room, 0, sizeof room);
    memset(&given, 0, sizeof given);
    memset(fixed, 0, sizeof fixed);
    s->options = mbs_stages_default_options();
    p->options = &s->options;
    p->x = room[0], p->lower = room[1], p->upper = room[2], p->zl = room[3], p->zu = room[4], p->c = room[5];
    p->step.x = room[6], p->slope = room[7];
    p->filter.theta = pairs[0], p->filter.phi = pairs[1];
    s->fixed = fixed, s->rows = 1, p->size = 2;
    s->options.tol = 1.1e-7, s->options.constr_viol_tol = 1e-3, s->cost_scale = 1;
    p->mu = 0.1, p->alpha = 1, p->theta_before = 1, p->theta = 0.5;
    given.boundary = given.dual = given.step = 1;
}

/* What lower_barrier makes of mu, where all errors are `scaled`. */
static real lowered(mbs_stages_phase *p, real scaled)
{
    given.errors.scaled = scaled;
    lower_barrier(&solver, p);
    return p->mu;
}

static void lowering(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    LAW("errors above thirty times mu keep it", lowered(p, 3.01) == 0.1);
    LAW("thirty times do not", lowered(p, CONVEX_FACTOR * 10 * p->mu + mbs_stages_rounding(p)) < 0.1);
    anew(s, p);
    p->rejected = 3, p->filter.count = 7, p->soft = 2;
    LAW("below, mu falls to a fifth", near(lowered(p, 2.99), 0.02));
    LAW("and the filter begins anew", p->filter.count == 0 && p->rejected == 0 && p->soft == 0 && p->tau == 0.99);
    anew(s, p);
    p->added = 1;
    LAW("with added curvature, ten times mu", lowered(p, 1.01) == 0.1);
    LAW("and below it", near(lowered(p, 0.99), 0.02));
    anew(s, p);
    p->elastic = 1;
    LAW("in restoration too", lowered(p, 1.01) == 0.1);
    s->options.resto_penalty_parameter = (real)1e10, p->mu = (real)1e-5; /* rounding is some 2e-4 */
    LAW("where rounding of the penalty is no error", lowered(p, (real)2e-4) < (real)1e-5);
    p->mu = (real)1e-5;
    LAW("but more is", lowered(p, (real)4e-4) == (real)1e-5);
    anew(s, p);
    p->mu = 1e-4;
    LAW("near the end by the power of 3/2", near(lowered(p, 2.9e-3), 1e-6));
    LAW("where numbers may come nearer to bounds", near(p->tau, 1 - (real)1e-6));
    anew(s, p);
    p->mu = 0.0099;
    LAW("a step that follows lowers mu, once", near(lowered(p, 1e9), real_pow((real)0.0099, 1.5)));
    anew(s, p);
    LAW("to the end at once, where there are no errors", near(lowered(p, 0), 1e-8));
    LAW("which is the least one", lowered(p, 0) == p->mu && lower_barrier(s, p) == 0);
    p->tiny = p->tiny_before = 1;
    LAW("two tiny steps there are an end", lower_barrier(s, p) == -1);
    anew(s, p);
    p->tiny = p->tiny_before = 1;
    LAW("elsewhere they lower mu once", near(lowered(p, 1e9), 0.02));
    anew(s, p);
    p->tiny = 1;
    LAW("one tiny step does not", lowered(p, 1e9) == 0.1);
    anew(s, p);
    given.least = 1e-3;
    LAW("no lower than the caller's", lowered(p, 0) == 1e-3);
    anew(s, p);
    p->elastic = 1, given.least = 1e-3;
    LAW("which restoration does not have", near(lowered(p, 0), 1e-8));
    anew(s, p);
    s->cost_scale = 1e-6; /* products of the caller's units below 1e-3 */
    LAW("products have the tolerance of violations", near(lowered(p, 0), 1e-9 / 11));
}

static void following(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    p->mu = 0.02, given.errors.complementarity = 0.19, given.errors.scaled = 1.9, p->c[0] = 0.37;
    LAW("a whole step that brings rows nearer follows", is_followed(s, p));
    p->alpha = 0.79;
    LAW("a shorter one does not", !is_followed(s, p));
    p->alpha = 0.81, p->added = 1;
    LAW("nor one with added curvature", !is_followed(s, p));
    p->added = 0, p->theta_before = 0.4;
    LAW("nor one that leads away from rows", !is_followed(s, p));
    p->theta = 1e-7, p->theta_before = 1e-8;
    LAW("within the tolerance it may", is_followed(s, p));
    p->c[0] = 0.38; /* 0.02^(1/4) is 0.376 */
    LAW("rows are as near as the fourth root of mu", !is_followed(s, p));
    p->c[0] = 0, given.errors.complementarity = 0.21;
    LAW("products are near mu", !is_followed(s, p));
    given.errors.complementarity = 0, given.errors.scaled = 2.1;
    LAW("other errors count while mu is large", !is_followed(s, p));
    p->mu = 0.0099;
    LAW("and no more where it is small", is_followed(s, p));
    p->mu = 0.031, given.errors.scaled = 0;
    LAW("a larger mu is solved for", !is_followed(s, p));
    p->mu = FOLLOWED_BELOW;
    LAW("than this one", is_followed(s, p));
    p->alpha = FOLLOWED_FROM, p->theta = p->theta_before = 0.25, p->c[0] = real_sqrt(real_sqrt(p->mu));
    given.errors.complementarity = s->options.barrier_tol_factor * p->mu, given.errors.scaled = FOLLOWED_WITHIN * p->mu;
    LAW("limits themselves are within", is_followed(s, p));
    p->theta = s->options.tol, p->theta_before = 0;
    LAW("and the tolerance is", is_followed(s, p));
    p->mu = FOLLOWED_ANYHOW, given.errors.scaled = 9, p->c[0] = given.errors.complementarity = 0;
    LAW("from which on other errors do not count", is_followed(s, p) && given.mu == 0);
    p->mu = 0.0099, p->elastic = 1;
    LAW("restoration follows nothing", !is_followed(s, p));
    p->elastic = 0, p->soft = 1;
    LAW("nor do soft steps", !is_followed(s, p));
    p->soft = 0, p->watchdog.active = 1;
    LAW("nor steps that are watched", !is_followed(s, p));
}

static void mending(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    const real apart = MBS_STAGES_APART;
    anew(s, p);
    p->lower[0] = 1, p->upper[0] = 3, p->x[0] = 1.5, p->lower[1] = -1e20, p->upper[1] = 1e20, p->mu = 1e-3;
    p->zl[0] = 1e9, p->zu[0] = 1e-20;
    mbs_stages_mend_bounds(s, p);
    LAW("products fall to a limit beside mu", near(p->zl[0], 1e10 * 1e-3 / 0.5));
    LAW("and rise to one", near(p->zu[0], 1e-3 / (1e10 * 1.5)));
    LAW("bounds apart from numbers stay", p->lower[0] == 1 && p->upper[0] == 3 && p->x[0] == 1.5);
    p->zl[0] = 1e7, p->zu[0] = 7;
    mbs_stages_mend_bounds(s, p);
    LAW("usual multipliers stay", p->zl[0] == 1e7 && p->zu[0] == 7);
    p->zl[0] = 1e-13;
    mbs_stages_mend_bounds(s, p);
    LAW("smaller ones do not", near(p->zl[0], 1e-3 / (1e10 * 0.5)));
    p->x[0] = 1, p->zl[0] = 0;
    mbs_stages_mend_bounds(s, p);
    LAW("a bound that a number reached moves away", near(p->lower[0], 1 - apart) && p->x[0] == 1);
    LAW("and the product counts from there", near(p->zl[0], 1e-3 / (1e10 * (1 - p->lower[0]))));
    p->upper[0] = p->x[0] = 4;
    mbs_stages_mend_bounds(s, p);
    LAW("an upper one by its size", near(p->upper[0] - 4, 4 * apart) && p->x[0] == 4);
    p->upper[0] = 4, p->lower[0] = 0, p->x[0] = MBS_STAGES_EPSILON * p->mu, p->lower[1] = -MBS_STAGES_INFINITE;
    p->upper[1] = MBS_STAGES_INFINITE;
    mbs_stages_mend_bounds(s, p);
    LAW("a number whose distance is rounding reached it", near(p->lower[0], -apart));
    LAW("bounds without end have no multipliers", p->zl[1] == 0 && p->zu[1] == 0);
    p->lower[0] = 0, p->x[0] = 2 * MBS_STAGES_EPSILON * p->mu;
    mbs_stages_mend_bounds(s, p);
    LAW("a number at more did not", p->lower[0] == 0);
    fixed[0] = 1, p->zl[0] = 1e30;
    mbs_stages_mend_bounds(s, p);
    LAW("fixed ones stay", p->zl[0] == 1e30);
}

static void deciding(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    p->c[0] = 1, s->left = 0.51;
    LAW("rows that keep half of the violation contradict", contradict(s, p));
    s->left = 0.5;
    LAW("half of it does not", !contradict(s, p));
    s->left = 0.9e-7, p->c[0] = s->options.tol;
    LAW("nor does a violation within the tolerance", !contradict(s, p));
    s->exact = 5;
    LAW("a step is found", find_step(s, p) == 0 && given.corrected == 1);
    LAW("of the barrier problem, which is solved anew", given.barrier == 1 && s->exact == 0);
    p->c[0] = 1, s->left = 0.75;
    LAW("there is none where rows contradict", find_step(s, p) == -1);
    p->c[0] = 0, p->size = 1, p->step.x[1] = NAN;
    LAW("it has the numbers that there are", find_step(s, p) == 0);
    p->size = 2, p->step.x[1] = 0;
    given.step = MBS_STAGES_LARGEST;
    LAW("it may be large", find_step(s, p) == 0);
    given.step = NAN;
    LAW("no number is no step", find_step(s, p) == -1);
    given.step = INFINITY;
    LAW("nor is an infinite one", find_step(s, p) == -1);
    given.step = 1, given.factorised = 1;
    LAW("nor is there one without factors", find_step(s, p) == -1);
    LAW("a warm start is near where steps are long", !is_far(s, p, 0) && is_far(s, p, 1));
    given.boundary = 0.49;
    LAW("a short step shows that it is far", is_far(s, p, 0));
    given.boundary = 1, given.dual = 0.49;
    LAW("of multipliers too", is_far(s, p, 0));
    given.dual = given.boundary = WARM_STEP;
    LAW("half of a step is long", !is_far(s, p, 0));
    given.restored = 77;
    LAW("without a step there is restoration", leave(s, p) == 77);
    p->elastic = 1;
    LAW("and none of restoration", leave(s, p) == MBS_STAGES_OUT_OF_DIGITS);
    p->failing = 1;
    LAW("a callback that fails is the reason", leave(s, p) == MBS_STAGES_CALLBACK_FAILED);
    anew(s, p);
    LAW("a search that ends well is enough", search(s, p) == 0);
    given.searched = -1, given.soft = 0;
    LAW("else a soft step is", search(s, p) == 0);
    given.soft = -1;
    LAW("without one there is none", search(s, p) == -1);
    given.soft = 0, p->failing = 1;
    LAW("a trial without a result is not softened", search(s, p) == -1);
    p->failing = 0, p->soft = 1;
    LAW("nor is a soft step that failed", search(s, p) == -1);
    anew(s, p);
    p->c[0] = -5, p->regular = p->added = p->restraint = p->cut = p->shortened = p->tiny = p->resets = p->cautious = p->acceptable = 3;
    p->filter.count = 2, p->mu = 0.001;
    mbs_stages_begin(s, p);
    LAW("limits of the violation are beside the first one", p->theta_most == 5e2 && near(p->theta_least, 5e-4));
    LAW("numbers keep a part of distances", near(p->tau, 0.999) && p->filter.count == 0);
    LAW("nothing is remembered", !p->regular && !p->added && !p->shortened && !p->tiny && !p->resets && !p->acceptable);
    p->c[0] = 0.1, p->mu = 0.1;
    mbs_stages_begin(s, p);
    LAW("which counts as 1 at least", p->theta_most == 1e2 && near(p->theta_least, 1e-4) && p->tau == (real)0.99);
    LAW("and a search has all its means", !p->cautious && p->alpha == 0 && p->restraint == 0 && p->cut == 0);
}

static void advancing(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    p->x[0] = 0.25, p->cost = 3, p->c[0] = -2, given.errors.scaled = 1e9;
    LAW("an iteration searches along a step", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 1 && p->x[0] == 1.25);
    LAW("from the violation and barrier function at its point", p->theta == 2 && p->phi == 3.25);
    LAW("and is counted", s->result.iterations == 1 && s->result.restorations == 0);
    p->elastic = 1;
    advance(s, p);
    advance(s, p);
    LAW("apart in restoration", s->result.iterations == 3 && s->result.restorations == 2);
    p->elastic = 0;
    advance(s, p);
    LAW("from which it comes back", s->result.iterations == 4 && s->result.restorations == 2);
    given.searched = given.soft = -1, given.restored = MBS_STAGES_INFEASIBLE;
    LAW("a search that fails leaves", advance(s, p) == MBS_STAGES_INFEASIBLE && s->result.iterations == 4);
    given.restored = MBS_STAGES_RUNNING;
    LAW("and may come back", advance(s, p) == MBS_STAGES_RUNNING && s->result.iterations == 5);
    given.searched = given.searches = 0, given.factorised = 1;
    LAW("without a step there is another search", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 0);
    given.without = -1, given.restored = MBS_STAGES_TIME_LIMIT;
    LAW("which may fail, too", advance(s, p) == MBS_STAGES_TIME_LIMIT);
    given.hessian = -1;
    LAW("curvature may have no result", advance(s, p) == MBS_STAGES_CALLBACK_FAILED);
    p->tiny = p->tiny_before = 1, p->mu = 1e-9;
    LAW("and tiny steps end it", advance(s, p) == MBS_STAGES_OUT_OF_DIGITS);
    anew(s, p);
    given.errors.scaled = 1e9, p->lower[0] = p->x[0] = -1, p->upper[0] = 1e20, given.searched = 0, given.step = 0;
    advance(s, p);
    LAW("bounds that are reached move away", p->lower[0] < -1);
}

static void warming(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    given.errors.scaled = 1e9, s->farther = 1e-3, given.farther = 1, given.boundary = 0.4;
    LAW("a warm start that is far begins anew", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 0);
    LAW("which is no iteration", s->result.iterations == 0 && s->farther == 1e-3);
    given.farther = -1;
    LAW("it may have no values", advance(s, p) == MBS_STAGES_CALLBACK_FAILED);
    given.farther = 0;
    LAW("or need none", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 1);
    given.farther = 1;
    LAW("later steps may be short", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 2);
    s->result.iterations = 0, given.boundary = 1;
    LAW("a long first step goes on", advance(s, p) == MBS_STAGES_RUNNING && given.searches == 3);
    given.searched = given.soft = -1, given.restored = MBS_STAGES_OUT_OF_DIGITS;
    LAW("a warm start without a step begins anew", advance(s, p) == MBS_STAGES_RUNNING && s->result.iterations == 2);
    given.farther = -1;
    LAW("where it has values", advance(s, p) == MBS_STAGES_CALLBACK_FAILED);
    given.farther = 0;
    LAW("else it ends", advance(s, p) == MBS_STAGES_OUT_OF_DIGITS);
    given.farther = 1, given.restored = MBS_STAGES_INFEASIBLE;
    LAW("rows that clash end it, too", advance(s, p) == MBS_STAGES_INFEASIBLE);
    given.restored = MBS_STAGES_OUT_OF_DIGITS, s->farther = 0;
    LAW("and so does no step of a cold start", advance(s, p) == MBS_STAGES_OUT_OF_DIGITS);
}

static void running(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    mbs_stages_problem problem;
    anew(s, p);
    memset(&problem, 0, sizeof problem);
    s->problem = &problem, given.errors.scaled = 1e9, given.least = 0.125;
    given.statuses[0] = given.statuses[1] = MBS_STAGES_RUNNING, given.statuses[2] = MBS_STAGES_SOLVED;
    LAW("iterations go on until there is a status", mbs_stages_run(s, p) == 100 + MBS_STAGES_SOLVED && given.searches == 2);
    LAW("a solution is polished", given.polished == 1 && given.after == MBS_STAGES_SOLVED);
    LAW("errors are those of the caller's barrier parameter", given.mu == 0.125);
    LAW("nobody watches", given.reports == 0);
    given.statuses[2] = MBS_STAGES_TIME_LIMIT, given.back = 1, problem.watch = watch;
    LAW("other ends are not polished", mbs_stages_run(s, p) == 100 + MBS_STAGES_TIME_LIMIT && given.polished == 1);
    LAW("somebody watches", given.reports == 1);
    p->elastic = 1;
    LAW("restoration ends where the caller's problem can go on", mbs_stages_run(s, p) == MBS_STAGES_RESTORED);
    LAW("and has no least barrier parameter", given.mu == 0);
    given.back = 0, given.statuses[2] = MBS_STAGES_SOLVED;
    LAW("a least violation is not polished", mbs_stages_run(s, p) == 100 + MBS_STAGES_SOLVED && given.polished == 1);
    given.derivatives = -1;
    LAW("derivatives may have no result", mbs_stages_run(s, p) == MBS_STAGES_CALLBACK_FAILED);
    given.derivatives = 0, given.hessian = -1, given.statuses[2] = MBS_STAGES_RUNNING;
    LAW("an iteration may fail", mbs_stages_run(s, p) == 100 + MBS_STAGES_CALLBACK_FAILED);
}

int main(void)
{
    lowering();
    following();
    mending();
    deciding();
    advancing();
    warming();
    running();
    return broken > 0;
}

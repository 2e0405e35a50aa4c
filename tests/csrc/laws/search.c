#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/filter.c"
#include "../../../csrc/stages/search.c"

/* Stand-ins: the violation of a trial is a function of x[0] with a step at `wall`, its barrier function another one. */
static struct {
    real wall, beyond, slope, boundary, dual, descent;
    real corrected, gain, right[2]; /* a corrected step; what remains of `beyond` after each; its right-hand side */
    real inner_gain;                /* the same of corrections of inner variables */
    int failed, evaluated, corrections, inner, barrier;
    int renewed; /* derivatives, and where */
    real renewed_at;
} given;

int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c)
{
    (void)s, (void)p;
    ++given.evaluated;
    *cost = given.slope * x[0];
    c[0] = x[0] > given.wall ? given.beyond : 0;
    c[1] = 0;
    return given.failed;
}

real mbs_stages_sum(int n, const real *c)
{
    real sum = 0;
    int i;
    for (i = 0; i < n; ++i)
        sum += real_abs(c[i]);
    return sum;
}

real mbs_stages_largest(int n, const real *c)
{
    real most = 0;
    int i;
    for (i = 0; i < n; ++i)
        most = real_abs(c[i]) > most ? real_abs(c[i]) : most;
    return most;
}

real mbs_stages_barrier(const mbs_stages *s, const mbs_stages_phase *p, const real *x, real cost)
{
    (void)s, (void)p, (void)x;
    return cost;
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

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s, (void)p;
    ++given.corrections;
    given.beyond *= given.gain;
    memcpy(given.right, c, sizeof given.right);
    d->x[0] = given.corrected;
}

/* Stages come in pairs. */
int mbs_stages_after_group(const mbs_stages_recursion *r, int k)
{
    (void)r;
    return k + 2;
}

void mbs_stages_solve_inner(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rc)
{
    (void)r, (void)m, (void)rc;
    given.inner = 10 * given.inner + k + 1;
    given.beyond *= given.inner_gain;
}

real mbs_stages_descent(const mbs_stages *s, const mbs_stages_phase *p, const real *dx)
{
    (void)s, (void)p, (void)dx;
    return given.descent;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s;
    given.barrier = barrier;
    out[0] = p->x[0];
    out[1] = 0;
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s;
    ++given.renewed;
    given.renewed_at = p->x[0];
    return 0;
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

#define SIZE 2
static real room[40][SIZE], pairs[2][MBS_STAGES_ENTRIES];
static char fixed[SIZE];
static mbs_stages solver;
static mbs_stages_phase phase;

/* A point x = (0, 5) with the step (1, 0), of violation 1 and barrier function 0. */
static void anew(mbs_stages *s, mbs_stages_phase *p)
{
    real **const arrays[] = {
        &p->x, &p->trial, &p->lower, &p->upper, &p->zl, &p->zu, &p->y, &p->slope, &p->c, &p->trial_c, &p->soc_c,
        &p->step.x, &p->step.zl, &p->step.zu, &p->step.y, &p->other.x, &p->other.zl, &p->other.zu, &p->other.y,
        &p->watchdog.x, &p->watchdog.zl, &p->watchdog.zu, &p->watchdog.y, &p->watchdog.c, &p->watchdog.step.x,
        &p->watchdog.step.zl, &p->watchdog.step.zu, &p->watchdog.step.y};
    size_t i;
    memset(s, 0, sizeof *s);
    memset(p, 0, sizeof *p);
    memset(room, 0, sizeof room);
    memset(&given, 0, sizeof given);
    memset(fixed, 0, sizeof fixed);
    s->options = mbs_stages_default_options();
    p->options = &s->options;
    for (i = 0; i < sizeof arrays / sizeof *arrays; ++i)
        *arrays[i] = room[i];
    p->filter.theta = pairs[0], p->filter.phi = pairs[1];
    s->fixed = fixed;
    s->rows = p->size = SIZE;
    for (i = 0; i < SIZE; ++i)
        p->lower[i] = -1e20, p->upper[i] = 1e20;
    p->x[1] = 5;
    p->step.x[0] = 1;
    p->step.zl[0] = 3, p->step.zu[0] = 5, p->step.y[0] = 7, p->step.y[1] = 9;
    p->theta = p->c[0] = 1;
    p->theta_most = 1e4, p->theta_least = 1e-4;
    p->tau = 0.99;
    given.wall = 1e9, given.boundary = given.dual = given.corrected = given.gain = given.inner_gain = 1;
}

static void measures(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -2};
    anew(&solver, p);
    p->theta = 0.01; /* 0.01^1.1 / 2^2.3 = 0.001281 */
    LAW("descent outweighs the violation", is_descent(p, &t, 0.00129) && !is_descent(p, &t, 0.00128));
    t.descent = 0;
    LAW("a level step is no descent", !is_descent(p, &t, 1));
    t.descent = -2, p->theta = solver.options.s_phi = solver.options.s_theta = 1;
    LAW("a descent that weighs as much outweighs nothing", !is_descent(p, &t, 0.5) && is_descent(p, &t, 0.501));
    t.descent = -2, t.phi = -1.01e-8;
    LAW("Armijo asks for a part of the slope", holds_armijo(p, &t, 0.5));
    t.phi = -0.99e-8;
    LAW("Armijo asks for no less", !holds_armijo(p, &t, 0.5));
    p->phi = -2, t.phi = -2 - 0.99e-8;
    LAW("beside the barrier function that there is", !holds_armijo(p, &t, 0.5));
    p->phi = 2, t.phi = 0.9e6;
    LAW("of any size", !rises_too_much(p, &t));
    p->phi = 0, t.phi = 0.9e6;
    LAW("five orders beside one are allowed", !rises_too_much(p, &t));
    t.phi = 1e6;
    LAW("five orders are, exactly", !rises_too_much(p, &t));
    t.phi = 1.1e6;
    LAW("more is not", rises_too_much(p, &t));
    p->phi = -50, t.phi = 4e6;
    LAW("five orders are beside the size of the barrier function", !rises_too_much(p, &t));
    p->phi = 1000, t.phi = 1.1e8;
    LAW("five orders beside three", rises_too_much(p, &t));
    t.phi = 0.9e8;
    LAW("within five orders beside three", !rises_too_much(p, &t));
    t.phi = 1e8 + 500;
    LAW("the rise counts, not the value", !rises_too_much(p, &t));
    t.phi = -1e9;
    LAW("a fall is no rise", !rises_too_much(p, &t));
}

static void progress(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -1, .phi = 1};
    anew(&solver, p);
    t.theta = 0.999989;
    LAW("less violation is progress", is_progress(p, &t));
    t.theta = 0.999991;
    LAW("hardly less is none", !is_progress(p, &t));
    t.phi = -1.1e-8;
    LAW("a lower barrier function is progress", is_progress(p, &t));
    t.phi = -0.9e-8;
    LAW("a hardly lower one is none", !is_progress(p, &t));
    t.theta = 0, t.phi = 1.1e6;
    LAW("no violation is worth any rise", !is_progress(p, &t));
    p->phi = 3, p->theta = t.theta = 0.5, t.phi = 3 - 0.6e-8;
    LAW("the fall counts, beside the violation", is_progress(p, &t));
    t.phi = 3 - 0.4e-8;
    LAW("not a part of it", !is_progress(p, &t));
}

static void acceptance(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -1, .filtered = 1};
    anew(&solver, p);
    t.theta = 2e4, t.phi = -1;
    LAW("a violation beyond the limit is refused", !is_accepted(p, &t, 1) && !t.filtered);
    p->theta = 5e4, t.theta = 1e4;
    LAW("the limit itself is allowed", is_accepted(p, &t, 1));
    p->theta = 1, t.theta = NAN;
    LAW("no number is refused", !is_accepted(p, &t, 1));
    p->theta = p->theta_least = 1e-6, t.theta = t.phi = 0;
    LAW("near rows, descent demands Armijo's condition", !is_accepted(p, &t, 1));
    t.phi = -1;
    LAW("and that is enough", is_accepted(p, &t, 1));
    t.theta = 2e-6;
    LAW("even with more violation", is_accepted(p, &t, 1));
    p->theta_least = 1e-7;
    t.phi = 0, t.theta = 0;
    LAW("far from rows, less violation is enough", is_accepted(p, &t, 1));
    mbs_stages_filter_add(&p->filter, 0.5, -1);
    p->theta = 1, t.theta = 0.6;
    LAW("the filter refuses, and it is known that the filter alone did", !is_accepted(p, &t, 1) && t.filtered);
    t.theta = 0.4;
    LAW("no refusal stays known", is_accepted(p, &t, 1) && !t.filtered);
}

static void lengths(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = 0};
    anew(&solver, p);
    p->theta = 1e-2;
    LAW("the shortest step of no descent", near(shortest(p, &t), 5e-7));
    t.descent = -2;
    LAW("the shortest step of a descent", near(shortest(p, &t), 0.05 * 0.5e-10));
    p->theta = p->theta_least = 1e-6, t.descent = -1e7;
    LAW("the shortest step near rows", near(shortest(p, &t), 0.05 * pow(1e-6, 1.1) / pow(1e7, 2.3)));
    p->theta_least = 1e-7;
    LAW("the shortest step far from rows", near(shortest(p, &t), 0.05 * 1e-21));
    t.descent = -1e-12;
    LAW("no shorter than it must be", near(shortest(p, &t), 5e-7));
}

static void bounds(void)
{
    const real eps = MBS_STAGES_EPSILON;
    mbs_stages_phase *p = &phase;
    search t = {.descent = 0};
    LAW("inside stays", keep_inside(1, 2, 0, 3) == 2);
    LAW("half of the way to a lower bound", keep_inside(1, 0, 0, 3) == 0.5 && keep_inside(1, -1, 0, 3) == 0.5);
    LAW("half of the way to an upper bound", keep_inside(1, 3, 0, 3) == 2 && keep_inside(1, 4, 0, 3) == 2);
    LAW("no digit is left below", keep_inside(1 + eps, 1, 1, 3) == 1 + eps);
    LAW("no digit is left above", keep_inside(1 - eps / 2, 1, 0, 1) == 1 - eps / 2);
    anew(&solver, p);
    p->upper[0] = 0.5, p->x[0] = 0.25, given.slope = 3, given.wall = 0.3, given.beyond = 2;
    LAW("a trial is evaluated inside", !try_step(&solver, p, p->step.x, 0.5, &t) && p->trial[0] == 0.375);
    LAW("with its violation and barrier function", t.theta == 2 && t.phi == 3 * 0.375 && p->trial_cost == t.phi);
    given.beyond = MBS_STAGES_LARGEST;
    LAW("the largest number is one", !try_step(&solver, p, p->step.x, 0.5, &t) && t.theta == MBS_STAGES_LARGEST);
    given.beyond = 2, given.slope = MBS_STAGES_LARGEST, p->step.x[0] = 0, p->x[0] = 1;
    fixed[0] = 1;
    LAW("as a barrier function, too", !try_step(&solver, p, p->step.x, 0.5, &t) && t.phi == MBS_STAGES_LARGEST);
    p->x[0] = 0.25, p->step.x[0] = 1, given.slope = 3;
    LAW("a fixed one moves freely", !try_step(&solver, p, p->step.x, 0.5, &t) && p->trial[0] == 0.75);
    given.beyond = NAN;
    LAW("no number, no trial", try_step(&solver, p, p->step.x, 0.5, &t) == -1);
    given.beyond = 0, given.slope = INFINITY;
    LAW("no infinite barrier function", try_step(&solver, p, p->step.x, 0.5, &t) == -1);
    given.slope = 0, given.failed = 1;
    LAW("no result, no trial", try_step(&solver, p, p->step.x, 0.5, &t) == -1 && t.phi == MBS_STAGES_LARGEST);
    LAW("no trial has the largest violation", t.theta == MBS_STAGES_LARGEST);
}

static void taking(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -1, .theta = 0.25, .phi = -1};
    anew(&solver, p);
    p->theta = 0.5, p->y[1] = 1, p->phi = 0.1, given.dual = 0.25, p->trial[0] = 8, p->trial_c[0] = 4, p->trial_cost = 6;
    take(&solver, p, &t, 0.5, 1, 0);
    LAW("a step that Armijo accepts adds no pair", p->filter.count == 0);
    LAW("x, rows and cost are the trial's", p->x[0] == 8 && p->c[0] == 4 && p->cost == 6);
    LAW("multipliers of rows move by the step's length", p->y[0] == 3.5 && p->y[1] == 5.5);
    LAW("the others by their own", p->zl[0] == 0.75 && p->zu[0] == 1.25);
    LAW("violations and length are kept", p->theta_before == 0.5 && p->theta == 0.25 && p->alpha == 0.5);
    LAW("a first trial is no short step", p->watchdog.shortened == 0);
    p->theta = 0.5, t.phi = 1;
    take(&solver, p, &t, 0.5, 0, 1);
    LAW("another step adds its point", p->filter.count == 1 && near(p->filter.theta[0], (1 - 1e-5) * 0.5));
    LAW("with a margin of the barrier function", near(p->filter.phi[0], 0.1 - 0.5e-8));
    LAW("a short step is counted", p->watchdog.shortened == 1);
    LAW("a refusal is counted", p->rejected == 1);
    take(&solver, p, &t, 0.5, 0, 0);
    LAW("short steps add up, refusals in a row alone", p->watchdog.shortened == 2 && p->rejected == 0);
    t.descent = 0, t.phi = -9, p->theta = 0.7, p->phi = -7, p->filter.count = 0;
    take(&solver, p, &t, 0.5, 0, 0);
    LAW("a level step adds its point", p->filter.count == 1);
}

static void counters(void)
{
    mbs_stages_phase *p = &phase;
    int i;
    anew(&solver, p);
    mbs_stages_filter_add(&p->filter, 1, 1);
    for (i = 0; i < 4; ++i)
        mind_refusals(p, 1);
    LAW("four refusals change nothing", p->rejected == 4 && p->filter.count == 1);
    mind_refusals(p, 1);
    LAW("five begin the filter anew", p->rejected == 0 && p->filter.count == 0 && p->resets == 1);
    for (i = 0; i < 20; ++i)
        mind_refusals(p, 1);
    mbs_stages_filter_add(&p->filter, 1, 1);
    for (i = 0; i < 10; ++i)
        mind_refusals(p, 1);
    LAW("at most five times", p->resets == 5 && p->filter.count == 1);
    p->added = 1;
    mind_length(p, 0.019);
    LAW("one step cut short is no reason", p->shortened == 1 && !p->cautious);
    mind_length(p, 0.021);
    LAW("a longer one ends the row", p->shortened == 0);
    mind_length(p, CUT_LENGTH);
    LAW("a fiftieth is not cut short", p->shortened == 0);
    mind_length(p, 0.019);
    mind_length(p, 0.019);
    LAW("two in a row ask for curvature of inner variables", p->cautious == 1);
    p->added = 0;
    mind_length(p, 0.019);
    LAW("without added curvature there is no row", p->shortened == 0 && p->cautious == 1);
    p->step.x[0] = 11 * MBS_STAGES_EPSILON, p->c[0] = 0, p->x[0] = 0.2;
    LAW("steps in the last digits are tiny", is_tiny(&solver, p));
    p->x[0] = 0;
    LAW("beside 1 at least", !is_tiny(&solver, p));
    p->step.x[0] = 10 * MBS_STAGES_EPSILON;
    LAW("ten roundings are tiny", is_tiny(&solver, p));
    p->step.x[0] = 0, p->step.x[1] = 59 * MBS_STAGES_EPSILON, p->c[0] = (real)1e-4;
    LAW("each beside its own variable", is_tiny(&solver, p));
    p->step.x[1] = -61 * MBS_STAGES_EPSILON;
    LAW("in both directions", !is_tiny(&solver, p));
    p->step.x[1] = 0, p->c[0] = 1.1e-4;
    LAW("a violation makes no step tiny", !is_tiny(&solver, p));
}

static void backtracking(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = 0};
    anew(&solver, p);
    given.wall = 0.3, given.beyond = 10;
    LAW("steps are halved until one is accepted", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 0.25);
    LAW("which is a short one", p->watchdog.shortened == 1 && p->alpha == 0.25);
    LAW("the first trial alone is corrected", given.corrections == 1);
    LAW("and the filter has refused none", p->rejected == 0);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    LAW("the first trial again is half of the longest", backtrack(&solver, p, &t, 1) == 0 && p->x[0] == 0.5);
    LAW("and a short one", p->watchdog.shortened == 1);
    anew(&solver, p);
    given.wall = -1, given.beyond = 10;
    LAW("where none is accepted the search ends", backtrack(&solver, p, &t, 0) == -1 && p->x[0] == 0);
    anew(&solver, p);
    given.beyond = 10;
    LAW("a whole step is no short one", backtrack(&solver, p, &t, 0) == 0 && p->watchdog.shortened == 0);
    LAW("nor one that the filter refused", p->rejected == 0);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 1.5;
    mbs_stages_filter_add(&p->filter, 0.1, -1);
    given.slope = -4e-9; /* too little for progress; with room below the filter's pair */
    given.failed = 1;
    LAW("trials without a result are known", backtrack(&solver, p, &t, 0) == -1 && p->failing);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 0.7;
    mbs_stages_filter_add(&p->filter, 0.5, -1);
    LAW("a first trial that the filter refuses", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 0.5 && p->rejected == 1);
    LAW("and that lowers the violation is not corrected", given.corrections == 0);
    anew(&solver, p);
    given.wall = 0.3, solver.options.gamma_theta = solver.options.alpha_min_frac = 0.5, given.beyond = 10;
    LAW("no step is as short as the shortest", backtrack(&solver, p, &t, 0) == -1 && given.evaluated == 3);
}

/* Corrections of whole steps that raise the violation. */
static void correcting(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = 0};
    real length = 0;
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 1, given.corrected = 0.25;
    LAW("a step that lowers nothing is corrected", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 0.25);
    LAW("which makes no short step", p->watchdog.shortened == 0 && p->step.x[0] == 0.25 && p->other.x[0] == 1);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    LAW("where corrections fail,", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 0.5);
    LAW("no step is tried twice", given.evaluated == 3);
    anew(&solver, p);
    given.wall = -1, given.beyond = 8, given.gain = 0.5, given.boundary = 0.5, p->theta_most = -1;
    p->c[0] = 3, p->c[1] = 5, p->trial_c[0] = 7, p->trial_c[1] = 11, t.theta = 8, solver.options.max_soc = 1;
    LAW("one correction, where one is asked for", correct(&solver, p, &t, 0.25, &length) == -1 && given.corrections == 1);
    LAW("for rows of the trial beside the step's", given.right[0] == 7.75 && given.right[1] == 12.25 && length == 0.5);
    solver.options.max_soc = 4, given.beyond = 8, t.theta = 8;
    LAW("and more while each halves the violation", correct(&solver, p, &t, 0.25, &length) == -1 && given.corrections == 5);
    LAW("with rows of the last beside its own", given.right[0] == 0.5 * (0.5 * (0.5 * 4.75 + 4) + 2) + 1);
    given.gain = solver.options.kappa_soc, given.beyond = t.theta = 1, solver.options.max_soc = 2;
    LAW("or lowers it by enough", correct(&solver, p, &t, 0.25, &length) == -1 && given.corrections == 7);
    given.gain = 1;
    LAW("not where one does not", correct(&solver, p, &t, 0.25, &length) == -1 && given.corrections == 8);
}

/* Inner variables of a trial: two of the first stage, one of each other. */
static void inner(void)
{
    static mbs_stages_stage stages[4];
    static real constants[3][2] = {{0.5, 0.25}, {2, 100}, {3, 100}}, x[9], trial[9], lower[9], upper[9];
    static char none_fixed[9];
    const int at[] = {0, 4, 6};
    mbs_stages_phase *p = &phase;
    mbs_stages_problem problem;
    search t = {.descent = 0};
    int i;
    anew(&solver, p);
    memset(&problem, 0, sizeof problem);
    solver.problem = &problem, problem.stages = 3, solver.recursion.stage = stages;
    for (i = 0; i < 3; ++i)
        stages[i].w = at[i], stages[i].nx = 1, stages[i].inner.n = i ? 1 : 2, stages[i].inner.constant = constants[i];
    for (i = 0; i < 9; ++i)
        trial[i] = 10 * i, lower[i] = -1e20, upper[i] = 1e20;
    p->lower = lower, p->upper = upper, p->trial = trial, solver.fixed = none_fixed;
    correct_inner(&solver, p);
    LAW("groups are solved once", given.inner == 13);
    LAW("all inner variables move", trial[1] == 10.5 && trial[2] == 20.25 && trial[5] == 52 && trial[7] == 73);
    LAW("and no others", trial[0] == 0 && trial[3] == 30 && trial[4] == 40 && trial[6] == 60 && trial[8] == 80);
    given.inner = 0, problem.stages = 2;
    correct_inner(&solver, p);
    LAW("of the stages that there are", given.inner == 1);
    p->x = x, solver.options.follow = 1, p->theta_most = -1;
    trial[0] = 1, given.wall = 0.6, given.beyond = t.theta = 8, given.evaluated = 0;
    problem.stages = 1, given.inner_gain = 0.5;
    LAW("a trial follows eight times", follow(&solver, p, &t, 1) == -1 && given.evaluated == 8);
    given.inner_gain = FOLLOWING_GAIN, given.beyond = t.theta = 1, given.evaluated = 0;
    LAW("while that lowers the violation by enough", follow(&solver, p, &t, 1) == -1 && given.evaluated == 8);
    given.inner_gain = (real)0.995, given.beyond = t.theta = 1, given.evaluated = 0;
    LAW("and not by less", follow(&solver, p, &t, 1) == -1 && given.evaluated == 1);
    solver.rows = 1, p->size = 1, p->theta_most = 1e4;
    given.inner_gain = 0.1, given.beyond = 2, p->step.x[0] = 1;
    LAW("a whole step follows at once", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 1 && p->alpha == 1);
    LAW("where its correction fails", given.corrections == 1 && p->watchdog.shortened == 0);
    problem.stages = 0;
}

/* A step passes unseen from a point of violation 1 and barrier function 0, in the watch of another point: whether it ends. */
static int ends_watch(real theta, real barrier)
{
    mbs_stages_phase *p = &phase;
    search t;
    anew(&solver, p);
    t.descent = -1, given.wall = 0.5, given.beyond = 1;
    p->watchdog.active = p->watchdog.shortened = 1, p->watchdog.alpha = 1;
    p->theta = 3 - theta, p->phi = -barrier, p->watchdog.theta = theta, p->watchdog.phi = barrier;
    LAW("an unseen step is taken", step_unseen(&solver, p, &t) == 0 && p->x[0] == 1);
    return !p->watchdog.active;
}

static void watching(void)
{
    mbs_stages_phase *p = &phase;
    int i;
    real phi, cost;
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    p->watchdog.shortened = 9;
    LAW("nine short steps rouse no watchdog", !mbs_stages_search(&solver, p) && !p->watchdog.active);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    p->watchdog.shortened = 10;
    p->elastic = 1;
    LAW("there is none in restoration", !mbs_stages_search(&solver, p) && !p->watchdog.active);
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    p->watchdog.shortened = 10, p->watchdog.phi = p->watchdog.cost = 99, phi = p->phi, cost = p->cost;
    LAW("ten do, and a whole step passes unseen", !mbs_stages_search(&solver, p) && p->watchdog.active && p->x[0] == 1);
    LAW("the point is kept", p->watchdog.x[0] == 0 && p->watchdog.trials == 1 && p->watchdog.theta == 1);
    LAW("with its barrier function and cost", p->watchdog.phi == phi && p->watchdog.cost == cost);
    for (i = 0; i < 2; ++i)
        LAW("three steps pass", !mbs_stages_search(&solver, p) && p->watchdog.active && p->x[0] == 2 + i);
    LAW("then the search goes back, to half of the step", !mbs_stages_search(&solver, p) && p->x[0] == 0.5);
    LAW("and the watchdog rests", !p->watchdog.active && p->watchdog.shortened == 1);
    LAW("no step is corrected on the way", given.corrections == 0);
    LAW("multipliers began at the point, too", near(p->zl[0], 3) && near(p->y[0], 3.5));
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    p->watchdog.shortened = 10;
    mbs_stages_search(&solver, p);
    given.wall = 1e9;
    LAW("a better point ends the watch", !mbs_stages_search(&solver, p) && !p->watchdog.active && p->x[0] == 2);
    LAW("and adds the first point to the filter", p->filter.count == 1 && near(p->filter.theta[0], 1 - 1e-5));
    anew(&solver, p);
    given.wall = 0.6, given.beyond = 10;
    p->watchdog.shortened = 10;
    mbs_stages_search(&solver, p);
    p->theta = 0, p->c[0] = 0, p->step.x[0] = 0;
    LAW("a tiny step goes back too", !mbs_stages_search(&solver, p) && !p->tiny && p->x[0] == 0.5);
    anew(&solver, p);
    p->step.x[0] = 1e-16, p->c[0] = 1e-5;
    LAW("else a tiny step is taken", !mbs_stages_search(&solver, p) && p->tiny && !p->tiny_before && p->alpha == 1);
    given.failed = 1;
    LAW("unless it has no result", mbs_stages_search(&solver, p) != 0);
    anew(&solver, p);
    LAW("a search begins with the whole step", !mbs_stages_search(&solver, p) && p->x[0] == 1);
    anew(&solver, p);
    p->soft = 1, p->theta = 0, p->phi = -1, given.slope = -1, given.wall = -1, given.beyond = 1e-9;
    p->x[0] = 1, p->step.x[0] = -0.5, p->c[0] = 0;
    LAW("after a soft step comes a soft one", !mbs_stages_search(&solver, p) && p->soft == 2 && p->x[0] == 0.5);
    LAW("a point is better than the one that is kept, not the last one", ends_watch(1, 10) && !ends_watch(1, -10));
    LAW("in either measure", ends_watch(2, -10) && !ends_watch(1, -10) && !ends_watch(0.5, -10));
}

static void softly(void)
{
    mbs_stages_phase *p = &phase;
    anew(&solver, p);
    p->x[0] = 2, p->zl[0] = 3, p->zu[0] = 0.5, p->lower[0] = 0.5, p->upper[0] = 10, p->mu = 1;
    p->c[0] = 0.25, p->c[1] = -0.25;
    p->lower[1] = -MBS_STAGES_INFINITE, p->upper[1] = MBS_STAGES_INFINITE;
    LAW("errors are means", near(mean_errors(&solver, p), 2.0 / 2 + 0.5 / 2 + (3.5 + 3.0) / 2));
    LAW("of stationarity without the barrier", given.barrier == 0);
    fixed[0] = 1;
    LAW("fixed ones have no products", near(mean_errors(&solver, p), 2.0 / 2 + 0.5 / 2));
    solver.rows = 0;
    LAW("without rows there is none of theirs", near(mean_errors(&solver, p), 2.0 / 2));
    solver.rows = 1, p->size = 0;
    LAW("nor one of variables without these", near(mean_errors(&solver, p), 0.25));
    p->y[1] = 0, p->step.y[1] = 9;
    move_multipliers(&solver, p, 1);
    LAW("multipliers of the rows that there are move", p->y[0] == 7 && p->y[1] == 0);
    anew(&solver, p);
    p->step.x[0] = 0, given.wall = -1, given.beyond = 1;
    memset(p->step.zl, 0, sizeof room[0]), memset(p->step.zu, 0, sizeof room[0]);
    try_step(&solver, p, p->step.x, 1, &(search){.descent = 0});
    LAW("errors may fall by as little as is asked for", lowers_errors(&solver, p, 1, 1) == 1);
    anew(&solver, p);
    p->x[0] = 1, p->step.x[0] = -0.5, p->theta = p->c[0] = 0.5, p->phi = -1, given.slope = -1;
    given.wall = -1, given.beyond = 0.6;
    LAW("a first soft step is made", !mbs_stages_search_softly(&solver, p) && p->filter.count == 1);
    LAW("and keeps its point with its margins", near(p->filter.theta[0], (1 - 1e-5) * 0.5));
    LAW("of both", p->filter.phi[0] < -1 && fabs(p->filter.phi[0] + 1 + 0.5e-8) < 1e-14);
    anew(&solver, p);
    p->x[0] = 1, p->step.x[0] = -0.5, given.boundary = 0.8, given.dual = 0.5, p->theta = 0, p->c[0] = 0;
    p->phi = -1, given.slope = -1, given.wall = -1, given.beyond = 1e-9; /* violation and barrier function rise: no acceptance */
    LAW("a step that lowers the errors is made", !mbs_stages_search_softly(&solver, p) && p->x[0] == 0.75);
    LAW("by the shorter length of both", p->alpha == 0.5 && p->zl[0] == 1.5 && p->zu[0] == 2.5 && p->y[0] == 3.5);
    LAW("it is counted, and its point is kept", p->soft == 1 && p->filter.count == 1);
    given.boundary = 0.25;
    LAW("another one too", !mbs_stages_search_softly(&solver, p) && p->soft == 2 && p->alpha == 0.25);
    LAW("points are kept once", p->filter.count == 1);
    p->soft = 10;
    LAW("ten are enough", mbs_stages_search_softly(&solver, p) == -1);
    p->soft = 9;
    LAW("nine are not", mbs_stages_search_softly(&solver, p) == 0);
    given.wall = 1e9, p->soft = 3, p->theta = 1;
    LAW("an accepted one ends the row", !mbs_stages_search_softly(&solver, p) && p->soft == 0);
    p->elastic = 1;
    LAW("none in restoration", mbs_stages_search_softly(&solver, p) == -1);
    anew(&solver, p);
    p->x[0] = 1, p->step.x[0] = -0.00005, p->theta = 0, p->c[0] = 0, given.slope = -1;
    p->phi = -1, given.wall = -1, given.beyond = 1e-9;
    LAW("errors must fall by more than a ten-thousandth", mbs_stages_search_softly(&solver, p) == -1);
    LAW("else all stays", p->x[0] == 1 && p->zl[0] == 0 && p->zu[0] == 0 && p->y[0] == 0 && p->y[1] == 0 && p->c[0] == 0);
    anew(&solver, p);
    p->soft = 4, p->watchdog.active = p->watchdog.shortened = 3;
    mbs_stages_search_anew(p);
    LAW("a new search remembers nothing", !p->soft && !p->watchdog.active && !p->watchdog.shortened);
    LAW("without a step and a watchdog there is an end", mbs_stages_search_without_step(&solver, p) == -1);
}

/* From x[0] = 1 to 0, with errors 0.5 and 0.05; the rows' grow, and so does the barrier function. */
static int go_boldly(real violation, real to)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -1};
    anew(&solver, p);
    p->x[0] = 1, p->step.x[0] = to - 1, p->c[0] = p->theta = 0.1, p->phi = -1, given.slope = -1;
    given.wall = -1, given.beyond = violation, given.corrected = -1;
    return step_boldly(&solver, p, &t, 1);
}

static void boldly(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.descent = -1};
    LAW("a step that halves all errors is made", go_boldly(0.4, 0) == 0 && p->x[0] == 0 && p->c[0] == 0.4);
    LAW("multipliers move with it", p->y[0] == 7 && p->zl[0] == 3 && p->zu[0] == 5 && p->alpha == 1);
    LAW("its violations are known", p->theta == 0.4 && p->theta_before == 0.1);
    LAW("its point is kept", p->filter.count == 1 && near(p->filter.theta[0], (1 - 1e-5) * 0.1));
    LAW("half is enough", go_boldly(0.55 - 1e-9, 0) == 0);
    LAW("less than half is not", go_boldly(0.55 + 1e-9, 0) == -1 && p->x[0] == 1);
    LAW("a violation may be small enough", may_lower_errors(&solver, p, 0.55 - 1e-9, 0.5));
    LAW("or too large for it", !may_lower_errors(&solver, p, 0.55 + 1e-9, 0.5));
    LAW("of all errors together", go_boldly(0.4, 0.16) == -1 && go_boldly(0.4, 0.14) == 0);
    go_boldly(0.4, 0.5);
    LAW("else all is as before", p->x[0] == 1 && p->c[0] == 0.1 && p->y[0] == 0 && p->zl[0] == 0 && p->filter.count == 0);
    LAW("derivatives, too", given.renewed == 2 && given.renewed_at == 1);
    given.failed = 1;
    LAW("values may fail", step_boldly(&solver, p, &t, 1) == -1 && p->x[0] == 1);
    go_boldly(0.4, 0.5);
    p->step.x[0] = -1, p->added = 1e-9;
    LAW("not with added curvature", step_boldly(&solver, p, &t, 1) == -1);
    p->added = 0, p->elastic = 1;
    LAW("nor in restoration", step_boldly(&solver, p, &t, 1) == -1);
    p->elastic = 0, p->watchdog.shortened = 5, p->cut = 3;
    LAW("a search makes it", backtrack(&solver, p, &t, 0) == 0 && p->x[0] == 0);
    LAW("where no correction helps", given.corrections > 0);
    LAW("it is a whole step", p->watchdog.shortened == 0 && p->cut == 0);
    go_boldly(0.4, 0.5);
    p->step.x[0] = -1;
    LAW("a step that was tried before is cut", backtrack(&solver, p, &t, 1) == -1 || p->x[0] != 0);
    go_boldly(0.6, 0.5);
    p->step.x[0] = -1, given.renewed = 0;
    LAW("one that is too far from rows is not tried", backtrack(&solver, p, &t, 0) == -1 && given.renewed == 0);
}

/* Steps that are cut short again and again get curvature. */
static void restraint(void)
{
    mbs_stages_phase *p = &phase;
    search t = {.most = 0.5, .descent = -1};
    int i;
    anew(&solver, p);
    for (i = 0; i < 3; ++i)
        restrain(p, 1);
    LAW("three steps cut short change nothing", p->restraint == 0 && p->cut == 3);
    restrain(p, 0);
    LAW("another one ends the row", p->cut == 0 && p->restraint == 0);
    for (i = 0; i < 4; ++i)
        restrain(p, 1);
    LAW("four ask for curvature: as much as a first try has", p->restraint == (real)1e-4);
    restrain(p, 1);
    LAW("and a fifth for more", near(p->restraint, 8e-4));
    restrain(p, 0);
    LAW("which falls again", near(p->restraint, 8e-4 / 3) && p->cut == 0);
    p->restraint = 1e-12;
    restrain(p, 0);
    LAW("to none", p->restraint == 0);
    p->regular = 3;
    for (i = 0; i < 4; ++i)
        restrain(p, 1);
    LAW("what was added last is the first amount", p->restraint == 3);
    anew(&solver, p);
    take(&solver, p, &t, 0.011, 0, 0);
    LAW("lengths count beside the longest", p->cut == 0);
    take(&solver, p, &t, 0.009, 0, 0);
    LAW("a fiftieth of it is short", p->cut == 1);
    anew(&solver, p);
    p->theta = 1, given.boundary = 0.5;
    backtrack(&solver, p, &t, 0);
    LAW("which is known from bounds", t.most == 0.5);
}

int main(void)
{
    measures();
    progress();
    acceptance();
    lengths();
    bounds();
    taking();
    counters();
    backtracking();
    correcting();
    inner();
    watching();
    softly();
    boldly();
    restraint();
    return broken > 0;
}

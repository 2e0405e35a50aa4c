#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/finish.c"

static struct {
    mbs_stages_errors errors;
    real worst, rounding, least, mu;
    double now;
    int failed, measured;
    mbs_stages_progress progress;
} given;

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    (void)s, (void)p;
    given.mu = mu;
    ++given.measured;
    return given.errors;
}

real mbs_stages_worst_violation(const mbs_stages *s)
{
    (void)s;
    return given.worst;
}

real mbs_stages_rounding(const mbs_stages_phase *p)
{
    (void)p;
    return given.rounding;
}

real mbs_stages_least_barrier(const mbs_stages *s)
{
    (void)s;
    return given.least;
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.failed;
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

static double tick(void *context)
{
    (void)context;
    return given.now;
}

static void watch(void *context, const mbs_stages_progress *progress)
{
    (void)context;
    given.progress = *progress;
}

static mbs_stages solver;
static mbs_stages_phase phase;
static mbs_stages_problem problem;
static real x[3], c[2];

static void anew(mbs_stages *s, mbs_stages_phase *p)
{
    memset(s, 0, sizeof *s);
    memset(p, 0, sizeof *p);
    memset(&given, 0, sizeof given);
    memset(&problem, 0, sizeof problem);
    s->options = mbs_stages_default_options();
    s->problem = &problem, s->cost_scale = 1, s->variables = 3, s->rows = 2;
    problem.clock = tick, problem.watch = watch;
    x[0] = x[1] = x[2] = c[0] = c[1] = 0;
    p->x = x, p->c = c, p->options = &s->options;
}

static mbs_stages_errors errors(real scaled, real violation, real complementarity)
{
    mbs_stages_errors e;
    e.scaled = e.dual = scaled, e.violation = violation, e.complementarity = complementarity, e.stationarity = 0;
    return e;
}

static int is_solved(mbs_stages_errors e, real tolerance)
{
    return mbs_stages_is_solved(&solver, &e, tolerance);
}

static void solving(void)
{
    anew(&solver, &phase);
    LAW("scaled errors have the tolerance", is_solved(errors(1e-8, 0, 0), 1e-8) && !is_solved(errors(1.01e-8, 0, 0), 1e-8));
    LAW("violations have their own", is_solved(errors(0, 1e-4, 0), 1e-8) && !is_solved(errors(0, 1.01e-4, 0), 1e-8));
    LAW("products too", is_solved(errors(0, 0, 1e-4), 1e-8) && !is_solved(errors(0, 0, 1.01e-4), 1e-8));
    solver.cost_scale = 0.1;
    LAW("in units of the cost", is_solved(errors(0, 0, 0.99e-5), 1e-8) && !is_solved(errors(0, 0, 1.01e-5), 1e-8));
    LAW("no number is no solution", !is_solved(errors(NAN, 0, 0), 1) && !is_solved(errors(0, NAN, 0), 1));
    given.least = 0.1; /* the price of distances is 1e-6 */
    LAW("a barrier that stays has the price of distances", is_solved(errors(1.005e-6, 0, 0), 1e-8));
    LAW("and no more", !is_solved(errors(1.02e-6, 0, 0), 1e-8) && is_solved(errors(1e-5, 0, 0), 1e-5));
}

static int check(mbs_stages_errors e)
{
    return mbs_stages_check(&solver, &phase, &e);
}

static void checking(void)
{
    const mbs_stages_errors far = errors(1, 1, 1), close = errors(1e-7, 0, 0);
    int i;
    anew(&solver, &phase);
    LAW("a solve goes on", check(far) == MBS_STAGES_RUNNING);
    LAW("until it is solved", check(errors(1e-9, 0, 0)) == MBS_STAGES_SOLVED);
    for (i = 0; i < 14; ++i)
        LAW("fourteen acceptable iterations are not enough", check(close) == MBS_STAGES_RUNNING);
    LAW("fifteen are", check(close) == MBS_STAGES_ACCEPTABLE);
    LAW("another one in between begins anew", check(far) == MBS_STAGES_RUNNING && check(close) == MBS_STAGES_RUNNING);
    LAW("with the first", phase.acceptable == 1);
    solver.options.acceptable_iter = 0, phase.acceptable = 100;
    LAW("none is accepted where none is asked for", check(close) == MBS_STAGES_RUNNING);
    solver.options.acceptable_iter = 1;
    LAW("one is enough where one is", check(close) == MBS_STAGES_ACCEPTABLE);
    anew(&solver, &phase);
    solver.result.iterations = 2999;
    LAW("iterations have a limit", check(far) == MBS_STAGES_RUNNING);
    solver.result.iterations = 3000;
    LAW("which ends the solve", check(far) == MBS_STAGES_ITERATION_LIMIT);
    LAW("unless it is solved", check(errors(0, 0, 0)) == MBS_STAGES_SOLVED);
    anew(&solver, &phase);
    solver.began = 100, solver.options.max_wall_time = 5, given.now = 104.9;
    LAW("time has a limit", check(far) == MBS_STAGES_RUNNING);
    given.now = 105;
    LAW("from the start of the solve", check(far) == MBS_STAGES_TIME_LIMIT);
    solver.options.max_wall_time = 0;
    LAW("or none", check(far) == MBS_STAGES_RUNNING);
    solver.options.max_wall_time = 5, problem.clock = 0;
    LAW("without a clock there is none", check(far) == MBS_STAGES_RUNNING);
    x[2] = -1e20;
    LAW("numbers that grow without limit end it", check(far) == MBS_STAGES_UNBOUNDED);
    x[2] = 0.9e20;
    LAW("smaller ones do not", check(far) == MBS_STAGES_RUNNING);
}

static void least_violations(void)
{
    const mbs_stages_errors far = errors(1, 1, 1);
    anew(&solver, &phase);
    phase.elastic = 1, phase.mu = 1e-3, given.worst = 1.1, given.errors = errors(0.99e-2, 0, 0);
    LAW("restoration ends at a least violation", check(far) == MBS_STAGES_SOLVED && given.mu == 1e-3);
    given.errors.scaled = 1.01e-2;
    LAW("whose conditions hold", check(far) == MBS_STAGES_RUNNING);
    given.rounding = 0.02e-2;
    LAW("but for rounding", check(far) == MBS_STAGES_SOLVED);
    given.worst = 0.99;
    LAW("which is far beyond the barrier parameter", check(far) == MBS_STAGES_RUNNING);
    phase.mu = 1.1e-2, given.worst = 100, given.errors.scaled = 0;
    LAW("believed where that is small", check(far) == MBS_STAGES_RUNNING);
    phase.mu = 0.9e-2;
    LAW("enough", check(far) == MBS_STAGES_SOLVED);
    phase.elastic = 0;
    LAW("the caller's problem has none", check(far) == MBS_STAGES_RUNNING);
}

static void settling(void)
{
    anew(&solver, &phase);
    given.errors = errors(1e-7, 0, 0), given.least = 1e-9;
    LAW("a solve out of digits may be acceptable",
        mbs_stages_settle(&solver, &phase, MBS_STAGES_OUT_OF_DIGITS) == MBS_STAGES_ACCEPTABLE && given.mu == 1e-9);
    given.errors.scaled = 2e-6;
    LAW("or not", mbs_stages_settle(&solver, &phase, MBS_STAGES_OUT_OF_DIGITS) == MBS_STAGES_OUT_OF_DIGITS);
    given.errors.scaled = 0, given.failed = 1;
    LAW("where there are derivatives", mbs_stages_settle(&solver, &phase, MBS_STAGES_OUT_OF_DIGITS) == MBS_STAGES_OUT_OF_DIGITS);
    given.failed = 0, phase.elastic = 1;
    LAW("restoration may not", mbs_stages_settle(&solver, &phase, MBS_STAGES_OUT_OF_DIGITS) == MBS_STAGES_OUT_OF_DIGITS);
    phase.elastic = given.measured = 0;
    LAW("other ends stay", mbs_stages_settle(&solver, &phase, MBS_STAGES_ITERATION_LIMIT) == MBS_STAGES_ITERATION_LIMIT);
    LAW("and are not measured", mbs_stages_settle(&solver, &phase, MBS_STAGES_SOLVED) == MBS_STAGES_SOLVED && !given.measured);
}

/* One number between 0 and 4, at 2, its multipliers, and the slope that lets the cost fall. */
static real lower[1], upper[1], zl[1], zu[1], slope[1];
static char fixed[1];

static void place_number(real steepness, real cost)
{
    anew(&solver, &phase);
    lower[0] = zl[0] = zu[0] = 0, upper[0] = 4, slope[0] = steepness, fixed[0] = 0;
    solver.fixed = fixed, phase.size = 1, phase.lower = lower, phase.upper = upper;
    phase.zl = zl, phase.zu = zu, phase.lagrangian = slope, x[0] = 2, phase.cost = cost;
}

static void deciding(void)
{
    place_number(1e-10, 3e-6);
    LAW("a cost is known to a part of it", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    LAW("which may be small", !is_decided(&solver, &phase, 1e-12, 6e-5) && is_decided(&solver, &phase, 1e-12, 7e-5));
    LAW("a solve goes on for a millionth", worthwhile(&solver) == 1e-6);
    solver.options.warm_start_init_point = 2;
    LAW("and so does one near a neighbour", worthwhile(&solver) == 1e-6);
    solver.options.warm_start_init_point = 1;
    LAW("a sample of a loop does less", worthwhile(&solver) == 1e-4 && sizable(&solver) == 1e-4);
    solver.options.warm_start_init_point = 0;
    phase.cost = 1e-6;
    LAW("or is not", !is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    x[0] = 0.5;
    LAW("no way is longer than to the bound", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    x[0] = 2;
    LAW("0 to a tolerance is known", is_decided(&solver, &phase, 1e-6, sizable(&solver)));
    zl[0] = 2, solver.giving = 0.4e-6;
    LAW("one above what bounds give is not", !is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    zu[0] = 0.1; /* its bound is of size 4 */
    phase.cost = -0.95e-6;
    LAW("one below is 0", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    zl[0] = zu[0] = 0, phase.cost = 1e-6, solver.cost_before = 1.9e-6;
    LAW("costs before a warm start count", !is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    solver.cost_before = 2.1e-6;
    LAW("if they are larger", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    phase.cost = 2.1e-6, solver.cost_before = 1e-6;
    LAW("else the own one does", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    solver.cost_before = 0, phase.cost = 0.99e-7, solver.options.tol = 4e-6;
    LAW("a loose tolerance asks for its root of the cost alone", !is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    phase.cost = 1.01e-7;
    LAW("which may be enough", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
    fixed[0] = 1, slope[0] = 1;
    LAW("a fixed number leads nowhere", is_decided(&solver, &phase, 1e-12, sizable(&solver)));
}

/* A cost that is not decided at a solution. */
static void going_on(void)
{
    const mbs_stages_errors solved = errors(1e-9, 0, 0);
    place_number(1e-8, 1e-4);
    LAW("a solve goes on with a smaller tolerance", check(solved) == MBS_STAGES_RUNNING && near(solver.options.tol, 1e-12));
    LAW("once", check(errors(1e-13, 0, 0)) == MBS_STAGES_SOLVED);
    solver.is_sharper = 0, solver.options.tol = 1.01e-8;
    LAW("not with a loose one", check(solved) == MBS_STAGES_SOLVED && solver.options.tol == 1.01e-8);
    LAW("whose end is called acceptable", mbs_stages_settle(&solver, &phase, MBS_STAGES_SOLVED) == MBS_STAGES_ACCEPTABLE);
    phase.cost = 0.99e-8;
    LAW("unless the cost is 0 to it", mbs_stages_settle(&solver, &phase, MBS_STAGES_SOLVED) == MBS_STAGES_SOLVED);
}

/* Small changes lower the cost, 1e-4, by a slope times 2. */
static void far_enough(void)
{
    const mbs_stages_errors solved = errors(1e-9, 0, 0);
    place_number(1e-8, 1e-4);
    slope[0] = 4.9e-13;
    LAW("nothing goes on where the cost is decided", check(solved) == MBS_STAGES_SOLVED && !solver.is_sharper);
    slope[0] = 1e-8;
    LAW("a solve goes on", check(solved) == MBS_STAGES_RUNNING && solver.is_sharper && solver.asked == 1e-8);
    slope[0] = 5.1e-13;
    LAW("until the cost may fall by a hundredth of what it decides", check(solved) == MBS_STAGES_RUNNING);
    slope[0] = 4.9e-13;
    LAW("and no farther", check(solved) == MBS_STAGES_SOLVED);
    LAW("where the conditions hold as was asked", check(errors(1.01e-8, 0, 0)) == MBS_STAGES_RUNNING);
    phase.elastic = 1;
    LAW("restoration has its own end", check(solved) == MBS_STAGES_RUNNING);
    phase.elastic = 0, slope[0] = 9e-13, solver.cost_before = 2e-4;
    LAW("a controller's cost is its largest", check(solved) == MBS_STAGES_SOLVED);
}

/* Rows that rounding keeps above the tolerance. */
static void rounding(void)
{
    const mbs_stages_errors rows = errors(1e-13, 5e-12, 0);
    mbs_stages_errors e = rows;
    int i;
    anew(&solver, &phase);
    solver.options.tol = 1e-12, e.scaled = 5e-12, c[1] = -5e-12;
    LAW("rows that stay are looked at twice more", check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_RUNNING);
    LAW("and are rounding then", check(e) == MBS_STAGES_SOLVED);
    anew(&solver, &phase);
    solver.options.tol = 1e-12, c[1] = 5e-12;
    LAW("others", check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_RUNNING);
    e.scaled = 4.9e-13 + 1e-12, c[1] = 4.9e-13;
    LAW("that fall", check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_RUNNING);
    LAW("count anew", check(e) == MBS_STAGES_SOLVED);
    anew(&solver, &phase);
    solver.options.tol = 1e-12, c[1] = 1.01e-10, e.scaled = 1.01e-10;
    for (i = 0; i < 5; ++i)
        LAW("large rows are no rounding", check(e) == MBS_STAGES_RUNNING);
    c[1] = 0.99e-10, e.dual = 1.01e-12;
    for (i = 0; i < 5; ++i)
        LAW("nor do they excuse slopes", check(e) == MBS_STAGES_RUNNING);
    e.dual = 1e-12, phase.elastic = 1, given.worst = 0, phase.acceptable = 0;
    for (i = 0; i < 5; ++i)
        LAW("nor end a restoration", check(e) == MBS_STAGES_RUNNING);
    phase.elastic = 0;
    LAW("one that is above", check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_RUNNING);
    e.dual = 1;
    LAW("in between", check(e) == MBS_STAGES_RUNNING);
    e.dual = 0;
    LAW("begins anew", check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_RUNNING && check(e) == MBS_STAGES_SOLVED);
}

static void reporting(void)
{
    const mbs_stages_errors e = {3, 4, 5, 6, 7};
    int i, j;
    anew(&solver, &phase);
    solver.result.iterations = 7, phase.elastic = 1, phase.cost = 8, c[1] = -9, phase.mu = 10, phase.alpha = 11;
    phase.added = 12;
    mbs_stages_report(&solver, &phase, &e);
    LAW("progress has its iteration", given.progress.iteration == 7 && given.progress.restoring == 1);
    LAW("cost and errors", given.progress.cost == 8 && given.progress.violation == 9 && given.progress.stationarity == 3);
    LAW("and the step", given.progress.barrier == 10 && given.progress.step == 11 && given.progress.curvature == 12);
    for (i = 0; i <= MBS_STAGES_DIVERGED + 1; ++i)
        for (j = 0; j < i; ++j)
            LAW("each status has its own sentence",
                strcmp(mbs_stages_explain((mbs_stages_status)i), mbs_stages_explain((mbs_stages_status)j)) != 0);
}

int main(void)
{
    solving();
    checking();
    least_violations();
    settling();
    deciding();
    going_on();
    far_enough();
    rounding();
    reporting();
    return broken > 0;
}

#include "laws.h"

#include "../../../csrc/stages/polish.c"

/* Stand-ins: a step of Newton's method goes to a target; an iterate is a solution at another number, or at the same. */
static struct {
    real boundary, dual, target, solution, least, cost, slope;
    real part; /* of the lower bound: the target and the solution, if it is not 0 */
    int barrier, fails, mended;
    const real *listed; /* errors, one after the other, if there are some */
} given;

int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c)
{
    (void)s, (void)p, (void)c;
    *cost = given.cost + given.slope * x[0];
    return given.fails == 4;
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.fails == 3;
}

int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.fails == 1;
}

int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.fails == 2;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p, (void)out;
    given.barrier = barrier;
}

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s, (void)c;
    d->x[0] = (given.part > 0 ? given.part * p->lower[0] : given.target) - p->x[0];
    d->y[0] = 8, d->zl[0] = 4, d->zu[0] = 2;
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

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    mbs_stages_errors e = {0, 0, 0, 0, 0};
    (void)s, (void)mu;
    e.scaled = given.listed ? *given.listed++ : real_abs(p->x[0] - (given.part > 0 ? given.part * p->lower[0] : given.solution));
    return e;
}

int mbs_stages_is_solved(const mbs_stages *s, const mbs_stages_errors *e, real tolerance)
{
    (void)s;
    return e->scaled <= tolerance;
}

real mbs_stages_least_barrier(const mbs_stages *s)
{
    (void)s;
    return given.least;
}

void mbs_stages_mend_bounds(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    ++given.mended;
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

static real room[20][2];
static char fixed[2];
static mbs_stages solver;
static mbs_stages_phase phase;

/* One variable in [0, 4], whose bounds give by 1e-8, and by 4e-8 above. */
static void anew(mbs_stages *s, mbs_stages_phase *p)
{
    real **const arrays[] = {&p->x, &p->lower, &p->upper, &p->zl, &p->zu, &p->y, &p->c, &p->slope,
                             &p->step.x, &p->step.zl, &p->step.zu, &p->step.y, &p->watchdog.x, &p->watchdog.zl,
                             &p->watchdog.zu, &p->watchdog.y, &p->watchdog.c, &p->watchdog.step.x,
                             &p->watchdog.step.zl, &p->watchdog.step.zu};
    int i;
    memset(s, 0, sizeof *s);
    memset(p, 0, sizeof *p);
    memset(room, 0, sizeof room);
    memset(fixed, 0, sizeof fixed);
    s->options = mbs_stages_default_options();
    p->options = &s->options;
    for (i = 0; i < 20; ++i)
        *arrays[i] = room[i];
    s->fixed = fixed, s->rows = p->size = 1;
    s->giving = 1e-8, s->options.tol = 1e-9;
    p->lower[0] = -1e-8, p->upper[0] = 4 + 4e-8;
    p->x[0] = 2, p->mu = 1e-11, p->tau = 0.99, p->zl[0] = p->zu[0] = 1e-9;
    given.boundary = given.dual = 1, given.target = given.solution = 1, given.barrier = -1;
    given.least = given.slope = 0, given.cost = 100, given.fails = given.mended = 0, given.part = 0, given.listed = 0;
}

static real away(real a, real b)
{
    return real_abs(a - b);
}

static void measuring(mbs_stages *s, mbs_stages_phase *p)
{
    anew(s, p);
    p->zl[1] = p->zu[1] = 5; /* of a number that is not there */
    LAW("bounds that do not bind change nothing", find_share(s, p, 1e-8) == 0);
    p->x[0] = -4e-9, p->zl[0] = 3;
    LAW("the cost is off by what bounds give", away(find_share(s, p, 1e-8), 3 * 1e-8) < 1e-15);
    LAW("or by the distance, where that is larger", away(find_share(s, p, 5e-9), 3 * 6e-9) < 1e-15);
    given.least = 1e-3;
    LAW("a barrier that is wanted is no error", away(find_share(s, p, 1e-8), 3 * 4e-9) < 1e-15);
    LAW("nor is a distance then", find_share(s, p, 5e-9) == 0);
    given.least = 0, p->zl[0] = 1e-9, p->x[0] = 4 + 3e-8, p->zu[0] = 5;
    LAW("above, beside the size of the bound", away(find_share(s, p, 1e-8), 5 * 4e-8) < 1e-14);
    p->lower[0] = -4 - 4e-8, p->x[0] = -4 - 3e-8, p->zl[0] = 5;
    LAW("below, too", away(find_share(s, p, 1e-8), 5 * 4e-8) < 1e-14);
    p->lower[0] = -1e-8, p->x[0] = 4 + 3e-8, p->zl[0] = 1e-9;
    fixed[0] = 1;
    LAW("fixed ones have none", find_share(s, p, 1e-8) == 0);
    fixed[0] = 0, p->cost = -200;
    LAW("the cost is off by its share", is_off(s, p, 1e-8, 0.9e-9) && !is_off(s, p, 1e-8, 1.1e-9));
    p->cost = 0;
    LAW("of a cost that is not too small", is_off(s, p, 1e-8, 1e-5) && !is_off(s, p, 1e-8, 3e-5));
    s->options.warm_start_init_point = 1, p->cost = 1.9e-3;
    LAW("after a warm start a cost that is off by a sizable part is", is_off(s, p, 1e-8, 1));
    p->cost = -2.1e-3;
    LAW("not by less", !is_off(s, p, 1e-8, 0));
    p->cost = 0, s->cost_before = 2.1e-3;
    LAW("a part of the costs before, if they are larger", !is_off(s, p, 1e-8, 0));
    s->options.warm_start_init_point = 0;
    anew(s, p);
    p->x[0] = p->lower[0] = -0.5, p->zl[0] = 0.25, p->cost = -0.25;
    LAW("a cost that is off by as much as may be is not", find_share(s, p, 1) == 0.25 && !is_off(s, p, 1, 1));
    p->zl[0] = MBS_STAGES_SIZABLE * 0.5, p->cost = 0.5, s->options.warm_start_init_point = 1;
    LAW("after a warm start, too", find_share(s, p, 1) == MBS_STAGES_SIZABLE * 0.5 && !is_off(s, p, 1, 1));
    p->x[0] = 0, p->zl[0] = 0.5;
    LAW("a bound at the distance of its multiplier does not bind", find_share(s, p, 1) == 0);
    anew(s, p);
    s->options.tol = 1e-8;
    LAW("the barrier falls by the factor", near(lower_barrier(s, 1e-9, 0.1), 1e-10));
    LAW("to the square of the tolerance", near(lower_barrier(s, 1e-9, 1e-6), 1e-16 / MBS_STAGES_WORTH));
    s->options.tol = 1e-7;
    LAW("a larger one, too", near(lower_barrier(s, 1e-9, 1e-6), 1e-14 / MBS_STAGES_WORTH));
    s->options.tol = 1e-10;
    LAW("or what digits allow", lower_barrier(s, 1e-9, 1e-6) == MBS_STAGES_LITTLE);
    LAW("and never rises", lower_barrier(s, 1e-13, 0.5) == 1e-13);
}

static void comparing(mbs_stages *s, mbs_stages_phase *p)
{
    LAW("nearer is what is off by less, and moved as was said", is_nearer(2, 1.5, -0.25, -0.25, 7));
    LAW("or nearly so", is_nearer(2, 1.5, -0.44, -0.25, 7) && is_nearer(2, 1.5, -0.06, -0.25, 7));
    LAW("by a tenth at most", is_nearer(2, 1.5, 0, -0.2, 0) && is_nearer(2, 1.5, 0, 0.2, 0));
    LAW("not what fell by more", !is_nearer(2, 1.5, -0.46, -0.25, 7));
    LAW("nor by less", !is_nearer(2, 1.5, -0.04, -0.25, 7));
    LAW("rounding of the cost is nothing", is_nearer(1e-14, 0, 1e-12, 0, 1e3) && is_nearer(1e-14, 0, 1e-12, 0, -1e3));
    LAW("but no more than that", !is_nearer(1e-14, 0, 1e-9, 0, 1e3));
    LAW("nor what is off by as much", !is_nearer(2, 2, -0.25, -0.25, 7));
    anew(s, p);
    p->x[0] = 3, p->zl[0] = 4, p->zu[0] = 1, p->watchdog.x[0] = 1, p->watchdog.zl[0] = 2, p->watchdog.zu[0] = 3;
    p->x[1] = p->zl[1] = 5; /* of a number that is not there */
    LAW("multipliers say a change by their mean", find_change(s, p) == 2);
    fixed[0] = 1;
    LAW("of numbers that are not fixed", find_change(s, p) == 0);
    anew(s, p); /* the least -x with x^2 <= give, whose multiplier has no bound */
    p->x[0] = 1e-5, p->watchdog.x[0] = 1e-4, p->zu[0] = 1 / (2 * p->x[0]), p->watchdog.zu[0] = 1 / (2e-4);
    p->x[0] *= p->x[0], p->watchdog.x[0] *= p->watchdog.x[0], p->zl[0] = p->watchdog.zl[0] = 0;
    LAW("where multipliers diverge, they say too much", !is_nearer(5e-5, 5e-6, 9e-5, find_change(s, p), 1));
}

static void tightening(mbs_stages *s, mbs_stages_phase *p)
{
    anew(s, p);
    p->x[0] = -9e-9, p->zl[0] = 0.1;
    p->lower[1] = -1, p->upper[1] = 1;
    tighten(s, p, 1e-8, 1e-10);
    LAW("of the numbers that there are", p->lower[1] == -1 && p->upper[1] == 1);
    LAW("bounds come nearer to the caller's", away(p->lower[0], -1e-10) < 1e-16 && away(p->upper[0], 4 + 4e-10) < 1e-14);
    LAW("what is beyond goes inside, to where its product is mu", away((p->x[0] - p->lower[0]) * p->zl[0], p->mu) < 1e-17);
    anew(s, p);
    p->x[0] = -9e-9, p->zl[0] = 1e-3;
    tighten(s, p, 1e-8, 1e-10);
    LAW("but no farther than it was", away(p->x[0] - p->lower[0], 1e-9) < 1e-16);
    anew(s, p);
    p->x[0] = 4 + 39e-9, p->zu[0] = 0.1;
    tighten(s, p, 1e-8, 1e-10);
    LAW("above too", away((p->upper[0] - p->x[0]) * p->zu[0], p->mu) < 1e-15);
    anew(s, p);
    p->upper[0] = 1e-8, p->x[0] = -9e-9, p->zl[0] = 1e-2, p->zu[0] = 1;
    tighten(s, p, 1e-8, 1e-10);
    LAW("nor than a quarter of the room", away(p->x[0] - p->lower[0], 0.5e-10) < 1e-16);
    anew(s, p);
    tighten(s, p, 1e-8, 1e-10);
    LAW("what is inside stays", p->x[0] == 2);
    p->zl[0] = p->mu / (p->x[0] - p->lower[0]), p->zu[0] = p->mu / (p->upper[0] - p->x[0]);
    tighten(s, p, 1e-10, 1e-12);
    LAW("also where its products are mu", p->x[0] == 2);
    anew(s, p);
    p->lower[0] = -4 - 4e-8;
    tighten(s, p, 1e-8, 1e-10);
    LAW("a bound moves by its size", away(p->lower[0], -4 - 4e-10) < 1e-14);
    anew(s, p);
    p->upper[0] = 1e-8, p->x[0] = 0;
    tighten(s, p, 1e-8, 0);
    LAW("bounds do not meet", p->lower[0] == -1e-8 && p->upper[0] == 1e-8);
    fixed[0] = 1, p->upper[0] = 4;
    tighten(s, p, 1e-8, 1e-10);
    LAW("bounds of fixed ones stay", p->lower[0] == -1e-8 && p->upper[0] == 4);
    p->x[0] = 1, p->lower[0] = 0;
    tighten_bound(&p->x[0], &p->lower[0], 2, 1, 0.75, 10);
    LAW("what is nearer than half of its distance goes there", p->lower[0] == 0.75 && p->x[0] == 1.25);
    p->x[0] = 1, p->lower[0] = 0;
    tighten_bound(&p->x[0], &p->lower[0], 2, 1, 0.625, 10);
    LAW("what is farther stays", p->lower[0] == 0.625 && p->x[0] == 1);
}

/* Beyond its upper bound, with a solution inside. */
static void ending(mbs_stages *s, mbs_stages_phase *p)
{
    anew(s, p);
    given.target = given.solution = 4 - 1e-11, given.dual = 0, given.cost = 120, given.slope = -5;
    p->x[0] = 4 + 3e-8, p->zu[0] = 5, p->cost = 120 - 5 * p->x[0];
}

static void sharpening(mbs_stages *s, mbs_stages_phase *p)
{
    anew(s, p);
    given.boundary = 0.5, given.dual = 0.25, p->step.x[1] = p->step.y[1] = p->step.zl[1] = p->step.zu[1] = 5;
    LAW("a step goes as far as bounds allow", make_step(s, p) == 0 && p->x[0] == 1.5 && p->y[0] == 4);
    LAW("of the numbers that there are", p->x[1] == 0 && p->y[1] == 0 && p->zl[1] == 0 && p->zu[1] == 0);
    LAW("multipliers by their own length", near(p->zl[0], 1 + 1e-9) && near(p->zu[0], 0.5 + 1e-9) && s->result.iterations == 1);
    LAW("the right-hand side is the barrier's, and distances are mended", given.barrier == 1 && given.mended == 1);
    ending(s, p);
    mbs_stages_polish(s, p);
    LAW("a solution goes back to the bounds", p->x[0] == given.solution && p->upper[0] - 4 < 1e-10 && p->cost > 100);
    LAW("in one step, where that is enough", s->result.iterations == 1 && p->mu == MBS_STAGES_LITTLE);
    LAW("where numbers may come nearer to bounds", p->tau == 1 - MBS_STAGES_LITTLE);
    ending(s, p);
    s->options.tol = 1.01e-8;
    mbs_stages_polish(s, p);
    LAW("not where the tolerance is loose", p->x[0] == 4 + 3e-8 && s->result.iterations == 0);
    ending(s, p);
    p->cost += 1e-7;
    LAW("where the cost rises otherwise, all stays", sharpen(s, p, 1e-8, 1e-11, 1e-3) == -1 && p->x[0] == 4 + 3e-8);
    ending(s, p);
    given.least = 1e-11;
    mbs_stages_polish(s, p);
    LAW("a barrier that is wanted stays", p->x[0] == given.solution && p->mu == 1e-11);
    ending(s, p);
    s->giving = 0, p->lower[0] = 0, p->upper[0] = 4, p->x[0] = 4 - 3e-8;
    p->cost = 120 - 5 * p->x[0];
    mbs_stages_polish(s, p);
    LAW("bounds that do not give stay", p->x[0] == given.solution && p->lower[0] == 0 && p->upper[0] == 4);
}

/* Numbers of variables and of rows are kept. */
static void keeping(mbs_stages *s, mbs_stages_phase *p)
{
    real *const variables[] = {p->x, p->zl, p->zu, p->lower, p->upper};
    int i;
    anew(s, p);
    s->rows = 2, p->y[1] = 3, p->c[1] = 4;
    for (i = 0; i < 5; ++i)
        variables[i][0] = i + 5, variables[i][1] = 9;
    keep(s, p, 0);
    p->y[1] = p->c[1] = 0;
    for (i = 0; i < 5; ++i)
        variables[i][0] = variables[i][1] = 0;
    keep(s, p, 1);
    for (i = 0; i < 5; ++i)
        LAW("variables come back, as many as there are", variables[i][0] == i + 5 && variables[i][1] == 0);
    LAW("and rows", p->y[1] == 3 && p->c[1] == 4);
}

static void converging(mbs_stages *s, mbs_stages_phase *p)
{
    const real errors[] = {1, POLISHING_GAIN, 0};
    anew(s, p);
    given.boundary = 0.95, s->options.tol = 0.01; /* each step leaves a twentieth of the way */
    LAW("steps go on while they help", follow(s, p) == 0 && s->result.iterations == 2);
    anew(s, p);
    given.boundary = 0.95;
    LAW("four at most", follow(s, p) == -1 && s->result.iterations == 4);
    anew(s, p);
    given.boundary = 0.85;
    LAW("not where they help little", follow(s, p) == -1 && s->result.iterations == 2);
    anew(s, p);
    given.listed = errors;
    LAW("or a tenth is left", follow(s, p) == -1 && s->result.iterations == 2);
    anew(s, p);
    given.fails = 4;
    LAW("nor where rows have no values", follow(s, p) == -1 && s->result.iterations == 0);
}

static void failing(mbs_stages *s, mbs_stages_phase *p)
{
    anew(s, p);
    p->cost = 2, p->x[0] = 4 + 3e-8, p->zu[0] = 5, p->y[0] = 7, given.target = 3;
    LAW("a step that lowers no error is the last", sharpen(s, p, 1e-8, 1e-10, 1e-2) == -1 && s->result.iterations == 2);
    LAW("where they fail, all is as before", p->x[0] == 4 + 3e-8 && p->zu[0] == 5 && p->zl[0] == 1e-9 && p->y[0] == 7);
    LAW("with bounds, cost, and barrier", p->upper[0] == 4 + 4e-8 && p->lower[0] == -1e-8 && p->cost == 2 && p->mu == 1e-11);
    LAW("with the part of distances that numbers keep", p->tau == 0.99);
    mbs_stages_polish(s, p);
    LAW("smaller falls are tried, above 1 none", s->result.iterations == 2 + 2 * 3);
    anew(s, p);
    s->giving = 1, p->lower[0] = -1, p->x[0] = -0.5, p->zl[0] = given.slope = 500, given.dual = 0;
    given.part = 0.5, given.cost = 0, p->cost = -250;
    mbs_stages_polish(s, p);
    LAW("six tries at most: four that help, and two that do not", s->result.iterations == 6 && s->giving == MBS_STAGES_APART);
    anew(s, p);
    p->cost = 2, p->x[0] = 4 + 3e-8, p->zu[0] = 5, given.fails = 1;
    LAW("no derivatives, no step", make_step(s, p) == -1 && sharpen(s, p, 1e-8, 1e-10, 1e-2) == -1);
    given.fails = 2;
    LAW("no factors, none", make_step(s, p) == -1 && s->result.iterations == 0);
    LAW("and all is as before", p->x[0] == 4 + 3e-8 && p->cost == 2);
    anew(s, p);
    given.fails = 1;
    LAW("no curvature, no steps", follow(s, p) == -1 && s->result.iterations == 0);
    given.fails = 3;
    LAW("no derivatives at a point, no steps from there", follow(s, p) == -1 && s->result.iterations == 0);
    anew(s, p);
    p->cost = 2, p->lower[0] = 2 - 1e-12, p->zl[0] = 5, given.target = given.solution = 2;
    LAW("a solution whose cost is off by more is left", sharpen(s, p, 0, 0, 1e-2) == -1 && p->zl[0] == 5);
}

int main(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    measuring(s, p);
    comparing(s, p);
    tightening(s, p);
    sharpening(s, p);
    keeping(s, p);
    converging(s, p);
    failing(s, p);
    return broken > 0;
}

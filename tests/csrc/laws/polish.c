#include "laws.h"

#include "../../../csrc/stages/polish.c"

/* Stand-ins: a step of Newton's method goes to x = 1; an iterate is a solution there. */
static struct {
    real boundary, dual, target;
    int barrier, fails;
} given;

int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c)
{
    (void)s, (void)p, (void)c;
    *cost = 100 + x[0];
    return 0;
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return 0;
}

int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.fails;
}

int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return 0;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p, (void)out;
    given.barrier = barrier;
}

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s, (void)c;
    d->x[0] = given.target - p->x[0];
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
    mbs_stages_errors e = {0, 0, 0, 0};
    (void)s, (void)mu;
    e.scaled = real_abs(p->x[0] - 1);
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
    return 0;
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
    s->options.bound_relax_factor = 1e-8, s->options.tol = 1e-9;
    p->lower[0] = -1e-8, p->upper[0] = 4 + 4e-8;
    p->x[0] = 2, p->mu = 1e-11, p->tau = 0.99;
    given.boundary = given.dual = 1, given.target = 1, given.barrier = -1, given.fails = 0;
}

static real away(real a, real b)
{
    return real_abs(a - b);
}

int main(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    anew(s, p);
    LAW("inside lies beyond nothing", beyond(s, p, 0) == 0 && find_price(s, p) == 0);
    p->x[0] = -4e-9, p->zl[0] = 3;
    LAW("below the caller's bound", away(beyond(s, p, 0), -4e-9) < 1e-14);
    LAW("costs the multiplier times the way", away(find_price(s, p), 12e-9) < 1e-13);
    fixed[0] = 1;
    LAW("a fixed one lies nowhere beyond", beyond(s, p, 0) == 0);
    fixed[0] = 0, p->x[0] = 4 + 3e-8, p->zu[0] = 5;
    LAW("above the caller's bound", away(beyond(s, p, 0), 3e-8) < 1e-14);
    LAW("costs its multiplier times the way", away(find_price(s, p), 15e-8) < 1e-13);
    p->x[0] = -1e-12;
    LAW("rounding is none", beyond(s, p, 0) == 0);
    p->x[0] = 4 + 5e-12;
    LAW("rounding beside the bound is none", beyond(s, p, 0) == 0);
    p->x[0] = -4e-9;
    tighten(s, p);
    LAW("a bound is the caller's again", away(p->lower[0], 0) < 1e-11 && p->upper[0] > 4);
    LAW("and the number inside, where its product is mu", away((p->x[0] - p->lower[0]) * p->zl[0], p->mu) < 1e-20);
    p->x[0] = 4 + 3e-8;
    tighten(s, p);
    LAW("above too", away(p->upper[0], 4) < 1e-11 && away((p->upper[0] - p->x[0]) * p->zu[0], p->mu) < 1e-14);
    anew(s, p);
    p->upper[0] = 2e-8, p->x[0] = -4e-9, p->zl[0] = 1e-9;
    tighten(s, p);
    LAW("no further than a quarter of the room", away(p->x[0], 2.5e-8 / 4 + 1e-9 * 1.25) < 4e-9);
    anew(s, p);
    given.boundary = 0.5, given.dual = 0.25;
    LAW("a step goes as far as bounds allow", make_step(s, p) == 0 && p->x[0] == 1.5 && p->y[0] == 4);
    LAW("multipliers by their own length", p->zl[0] == 1 && p->zu[0] == 0.5 && s->result.iterations == 1);
    LAW("the right-hand side is the barrier's", given.barrier == 1);
    anew(s, p);
    p->cost = 1, p->x[0] = 4 + 3e-8, p->zu[0] = 5;
    mbs_stages_polish(s, p);
    LAW("a solution goes back to the bounds", p->x[0] == 1 && away(p->upper[0], 4) < 1e-11 && p->cost == 101);
    LAW("in one step, where that is enough", s->result.iterations == 1);
    anew(s, p);
    p->cost = 1e-4, p->x[0] = 4 + 3e-8, p->zu[0] = 5;
    mbs_stages_polish(s, p);
    LAW("where bounds decide the cost, all stays", p->x[0] == 4 + 3e-8 && s->result.iterations == 0);
    anew(s, p);
    p->cost = 2, p->x[0] = 4 + 3e-8, p->zu[0] = 5, p->y[0] = 7, given.target = 3;
    mbs_stages_polish(s, p);
    LAW("three steps are made", s->result.iterations == 3);
    LAW("where they fail, all is as before", p->x[0] == 4 + 3e-8 && p->zu[0] == 5 && p->zl[0] == 0 && p->y[0] == 7);
    LAW("with bounds and cost", p->upper[0] == 4 + 4e-8 && p->lower[0] == -1e-8 && p->cost == 2);
    anew(s, p);
    p->cost = 2, p->x[0] = 4 + 3e-8, p->zu[0] = 5, given.fails = 1;
    mbs_stages_polish(s, p);
    LAW("no derivatives, no step", make_step(s, p) == -1);
    LAW("and all is as before", p->x[0] == 4 + 3e-8 && p->cost == 2);
    return broken > 0;
}

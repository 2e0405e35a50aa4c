/* Bounds that give, and a solution that is put back on them.
 *
 * Bounds, and rows beside them, may leave one point alone: where a motion ends at a limit, for instance. There is no
 * interior then, and multipliers have no bound. So bounds give by the option `bound_relax_factor`, as in IPOPT: multipliers of the
 * barrier problem stay below mu / that factor, and fall with mu.
 *
 * Where this changes the cost little, whole steps of Newton's method then bring back all that lies beyond the caller's
 * bounds. Where bounds in their last digits decide the cost, or the steps fail, the solution keeps its violation. */
#include "solver.h"

#include <string.h>

/* How far the caller's bound is from the one that gives. */
static real give(const mbs_stages *s, real bound)
{
    return s->options.bound_relax_factor * mbs_stages_bound_size(bound);
}

/* How far a number lies beyond the caller's bounds, where that is more than rounding; below them it is negative. */
static real beyond(const mbs_stages *s, const mbs_stages_phase *p, int i)
{
    const real below = p->lower[i] + give(s, p->lower[i]) - p->x[i], above = p->x[i] - p->upper[i] + give(s, p->upper[i]);
    if (s->fixed[i])
        return 0;
    if (mbs_stages_has(p->lower[i]) && below > MBS_STAGES_APART * mbs_stages_bound_size(p->lower[i]))
        return -below;
    if (mbs_stages_has(p->upper[i]) && above > MBS_STAGES_APART * mbs_stages_bound_size(p->upper[i]))
        return above;
    return 0;
}

/* Multipliers times ways back: what the cost rises by, to first order. */
static real find_price(const mbs_stages *s, const mbs_stages_phase *p)
{
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        const real way = beyond(s, p, i);
        sum += way > 0 ? p->zu[i] * way : -p->zl[i] * way;
    }
    return sum;
}

/* Where bounds are the caller's again, numbers beyond them go to mu / z inside. */
static void tighten(const mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const real way = beyond(s, p, i);
        real *bound = way > 0 ? &p->upper[i] : &p->lower[i];
        const real sign = way > 0 ? -1 : 1, z = way > 0 ? p->zu[i] : p->zl[i];
        const real apart = MBS_STAGES_APART * mbs_stages_bound_size(*bound), room = (p->upper[i] - p->lower[i]) / 4;
        if (way == 0)
            continue;
        *bound += sign * (give(s, *bound) - apart);
        p->x[i] = *bound + sign * (p->mu / z < room ? p->mu / z : room);
    }
}

static void move(int n, const real *step, real length, real *x)
{
    int i;
    for (i = 0; i < n; ++i)
        x[i] += length * step[i];
}

/* Rows, derivatives and the Lagrangian at x. */
static int evaluate(mbs_stages *s, mbs_stages_phase *p)
{
    if (mbs_stages_phase_values(s, p, p->x, &p->cost, p->c) || mbs_stages_phase_derivatives(s, p))
        return -1;
    mbs_stages_find_lagrangian(s, p);
    return 0;
}

/* A step of Newton's method as far as bounds allow. */
static int make_step(mbs_stages *s, mbs_stages_phase *p)
{
    real dual, length;
    if (mbs_stages_phase_hessian(s, p) || mbs_stages_newton_factorise(s, p))
        return -1;
    mbs_stages_stationarity(s, p, 1, p->slope);
    mbs_stages_newton_solve(s, p, p->c, &p->step);
    length = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
    dual = mbs_stages_dual_boundary(s, p, &p->step);
    move(p->size, p->step.x, length, p->x);
    move(s->rows, p->step.y, length, p->y);
    move(p->size, p->step.zl, dual, p->zl);
    move(p->size, p->step.zu, dual, p->zu);
    ++s->result.iterations;
    return evaluate(s, p);
}

static int is_polished(mbs_stages *s, mbs_stages_phase *p)
{
    const mbs_stages_errors e = mbs_stages_measure_errors(s, p, mbs_stages_least_barrier(s));
    return mbs_stages_is_solved(s, &e, s->options.tol);
}

/* Exchange the point with the one that the watchdog has room for; bounds go into the room of its step. */
static void keep(const mbs_stages *s, mbs_stages_phase *p, int back)
{
    mbs_stages_watchdog *w = &p->watchdog;
    real *const here[] = {p->x, p->zl, p->zu, p->lower, p->upper, p->y, p->c};
    real *const there[] = {w->x, w->zl, w->zu, w->step.x, w->step.zl, w->y, w->c};
    int i;
    for (i = 0; i < 7; ++i)
        memcpy(back ? here[i] : there[i], back ? there[i] : here[i],
               (size_t)(i < 5 ? p->size : s->rows) * sizeof *here[i]);
}

void mbs_stages_polish(mbs_stages *s, mbs_stages_phase *p)
{
    const real price = find_price(s, p), cost = p->cost;
    int i;
    if (!(price > 0) || price > MBS_STAGES_DEAR * real_abs(cost))
        return;
    keep(s, p, 0);
    tighten(s, p);
    if (evaluate(s, p) == 0)
        for (i = 0; i < POLISHING_STEPS && make_step(s, p) == 0; ++i)
            if (is_polished(s, p))
                return;
    keep(s, p, 1);
    p->cost = cost;
    mbs_stages_phase_derivatives(s, p);
    mbs_stages_find_lagrangian(s, p);
}

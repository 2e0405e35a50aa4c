/* A solution, brought nearer to the optimum: bounds that give and the barrier fall together.
 *
 * Bounds, and rows beside them, may leave one point alone: where a motion ends at a limit, for instance. There is no
 * interior then, and multipliers have no bound. So bounds give by the option `bound_relax_factor`, as in IPOPT:
 * multipliers of the barrier problem stay below mu / that factor.
 *
 * Both change the cost, to first order by multipliers times ways beyond the caller's bounds, and by products of
 * distances and multipliers where bounds bind. Where they fall by one factor, so do the distances from bounds that bind,
 * and multipliers stay, even where there is no interior. So whole steps of Newton's method follow, and are kept if the
 * optimality conditions hold to the tolerance and the cost moves as the multipliers say. Where they fail, a smaller fall is
 * tried, and at last the solution is left as it was: there, bounds in their last digits decide the cost. */
#include "solver.h"

#include <string.h>

/* The largest part of the cost that a bound may decide, if it binds: by the amount that it gives, and by the distance from
 * it. A barrier that stays is part of the problem. */
static real share_of(real distance, real z, real give, int stays)
{
    if (!(z > distance))
        return 0;
    if (stays)
        return give > distance ? z * (give - distance) : 0;
    return z * mbs_stages_larger(give, distance);
}

/* The barrier parameter after a fall: as low as is worth it for the tolerance, and not below the requested one. */
static real lower_barrier(const mbs_stages *s, real mu, real fall)
{
    const real tol = s->options.tol, worth = mbs_stages_larger(MBS_STAGES_LITTLE, tol * tol / MBS_STAGES_WORTH);
    const real lower = mbs_stages_larger(mbs_stages_larger(fall * mu, worth), mbs_stages_least_barrier(s));
    return lower < mu ? lower : mu;
}

/* The most that bounds that give by `part` of their size, and the barrier, change the cost by. */
static real find_share(const mbs_stages *s, const mbs_stages_phase *p, real part)
{
    const int stays = !(lower_barrier(s, p->mu, 0) < p->mu);
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        if (s->fixed[i])
            continue;
        if (mbs_stages_has(p->lower[i]))
            sum += share_of(p->x[i] - p->lower[i], p->zl[i], part * mbs_stages_bound_size(p->lower[i]), stays);
        if (mbs_stages_has(p->upper[i]))
            sum += share_of(p->upper[i] - p->x[i], p->zu[i], part * mbs_stages_bound_size(p->upper[i]), stays);
    }
    return sum;
}

/* Move a bound inwards by `way`. A number that comes to lie beyond it goes inside, to where its product is mu. */
static void tighten_bound(real *x, real *bound, real z, real mu, real way, real room)
{
    const real sign = way < 0 ? -1 : 1, before = sign * (*x - *bound), central = mu / z;
    const real distance = central < before ? central : before;
    *bound += way;
    if (!(2 * sign * (*x - *bound) > distance))
        *x = *bound + sign * (distance < room ? distance : room);
}

/* Let bounds give by `after` of their size, where it was `before`. */
static void tighten(const mbs_stages *s, mbs_stages_phase *p, real before, real after)
{
    const real less = before - after;
    int i;
    for (i = 0; i < p->size; ++i) {
        const real below = less * mbs_stages_bound_size(p->lower[i]), above = less * mbs_stages_bound_size(p->upper[i]);
        const real room = (p->upper[i] - p->lower[i] - below - above) / 4;
        if (s->fixed[i] || !(room > 0))
            continue;
        if (mbs_stages_has(p->lower[i]))
            tighten_bound(&p->x[i], &p->lower[i], p->zl[i], p->mu, below, room);
        if (mbs_stages_has(p->upper[i]))
            tighten_bound(&p->x[i], &p->upper[i], p->zu[i], p->mu, -above, room);
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
    mbs_stages_mend_bounds(s, p);
    ++s->result.iterations;
    return evaluate(s, p);
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

/* Newton's steps to the solution of the tighter problem; -1 where they do not come there. */
static int follow(mbs_stages *s, mbs_stages_phase *p)
{
    real last = MBS_STAGES_LARGEST;
    int i;
    if (evaluate(s, p))
        return -1;
    for (i = 0; i < POLISHING_STEPS; ++i) {
        mbs_stages_errors e;
        if (make_step(s, p))
            return -1;
        e = mbs_stages_measure_errors(s, p, mbs_stages_least_barrier(s));
        if (mbs_stages_is_solved(s, &e, s->options.tol))
            return 0;
        if (!(e.scaled < POLISHING_GAIN * last))
            return -1;
        last = e.scaled;
    }
    return -1;
}

/* The change of the cost since the point that was kept, as multipliers have it: their mean times the ways of numbers. A
 * bound that ceases to bind, or begins to, counts as far as it does. */
static real find_change(const mbs_stages *s, const mbs_stages_phase *p)
{
    const mbs_stages_watchdog *w = &p->watchdog;
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i)
        if (!s->fixed[i])
            sum += (p->zl[i] + w->zl[i] - p->zu[i] - w->zu[i]) / 2 * (p->x[i] - w->x[i]);
    return sum;
}

/* Whether the cost is off by less than before, and moved as its multipliers say: else bounds in their last digits decide
 * it, and where it would end is not known. */
static int is_nearer(real before, real after, real moved, real change, real cost)
{
    return after < before && real_abs(moved - change) <= POLISHED_RIGHT * before + SUM_ROUNDING * real_abs(cost);
}

/* Let the barrier fall by a factor, and bounds give by `after` of their size; -1: it fails, and all is as before. */
static int sharpen(mbs_stages *s, mbs_stages_phase *p, real before, real after, real fall)
{
    const real own = find_share(s, p, before);
    const real cost = p->cost, mu = p->mu, tau = p->tau;
    keep(s, p, 0);
    p->mu = lower_barrier(s, mu, fall);
    p->tau = mbs_stages_larger(1 - p->mu, s->options.tau_min);
    tighten(s, p, before, after);
    if (follow(s, p) == 0 && is_nearer(own, find_share(s, p, after), p->cost - cost, find_change(s, p), p->cost))
        return 0;
    keep(s, p, 1);
    p->cost = cost;
    p->mu = mu;
    p->tau = tau;
    mbs_stages_phase_derivatives(s, p);
    mbs_stages_find_lagrangian(s, p);
    return -1;
}

/* Whether the cost is off by more than a part of it. After a warm start that part is a sizable one: further digits of a
 * sample in a closed loop are not worth its time. */
static int is_off(const mbs_stages *s, const mbs_stages_phase *p, real part, real most)
{
    const real cost = real_abs(p->cost), off = find_share(s, p, part);
    if (mbs_stages_continues(s))
        return off > MBS_STAGES_SIZABLE * mbs_stages_larger(cost, s->cost_before);
    return off > most * mbs_stages_larger(cost, POLISHED_COST);
}

void mbs_stages_polish(mbs_stages *s, mbs_stages_phase *p)
{
    real fall = MBS_STAGES_FALL, most = MBS_STAGES_SHARP;
    int i;
    if (mbs_stages_is_loose(s))
        return;
    for (i = 0; i < POLISHING_TRIES && fall < 1 && is_off(s, p, s->giving, most); ++i) {
        const real part = s->giving, after = part > MBS_STAGES_APART ? mbs_stages_larger(fall * part, MBS_STAGES_APART) : part;
        if (sharpen(s, p, part, after, fall) == 0) {
            s->giving = after;
            most = MBS_STAGES_DULL;
        } else {
            fall *= 10;
        }
    }
}

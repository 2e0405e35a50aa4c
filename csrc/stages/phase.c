/* The barrier problem: cost - mu sum log(distance from bounds), its rows, its optimality conditions.
 *
 * Variables with one bound alone also cost KAPPA mu times their distance, so that none goes to infinity as mu falls
 * (Waechter, Biegler: On the implementation of an interior-point filter line-search algorithm, 2006, section 3.7). */
#include "solver.h"

#include <string.h>

real mbs_stages_sum(int n, const real *c)
{
    real sum[4] = {0};
    int i, l;
    for (i = 0; i + 4 <= n; i += 4)
        for (l = 0; l < 4; ++l)
            sum[l] += real_abs(c[i + l]);
    for (; i < n; ++i)
        sum[0] += real_abs(c[i]);
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

real mbs_stages_largest(int n, const real *c)
{
    real most[4] = {0};
    int i, l;
    for (i = 0; MBS_STAGES_ROOMY && i + 4 <= n; i += 4)
        for (l = 0; l < 4; ++l)
            most[l] = mbs_stages_larger(real_abs(c[i + l]), most[l]);
    for (; i < n; ++i)
        most[0] = mbs_stages_larger(real_abs(c[i]), most[0]);
    return mbs_stages_larger(mbs_stages_larger(most[0], most[1]), mbs_stages_larger(most[2], most[3]));
}

/* Violations, and the distance from the point where restoration began. */
static real elastic_cost(const mbs_stages *s, const real *x)
{
    const real *p = x + s->variables + s->slacks;
    real distance = 0;
    int i;
    for (i = 0; i < s->variables; ++i) {
        const real d = s->weight[i] * (x[i] - s->reference[i]);
        distance += d * d;
    }
    return s->options.resto_penalty_parameter * mbs_stages_sum(2 * s->rows, p) + s->weight_factor * distance / 2;
}

int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c)
{
    const real *slack = x + s->variables, *plus = slack + s->slacks, *minus = plus + s->rows;
    int k, i;
    if (mbs_stages_values(s, x, cost, c))
        return -1;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i)
            c[t->g + i] -= slack[t->s + i];
    }
    if (!p->elastic)
        return 0;
    for (i = 0; i < s->rows; ++i)
        c[i] += minus[i] - plus[i];
    *cost = elastic_cost(s, x);
    return 0;
}

static void elastic_gradient(const mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < s->variables; ++i)
        p->gradient[i] = s->weight_factor * s->weight[i] * s->weight[i] * (p->x[i] - s->reference[i]);
}

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    if (mbs_stages_jacobians(s, p->x, p->gradient))
        return -1;
    for (i = s->variables; i < p->size; ++i)
        p->gradient[i] = i < s->variables + s->slacks ? 0 : s->options.resto_penalty_parameter;
    if (p->elastic)
        elastic_gradient(s, p);
    return 0;
}

/* The distance from the reference weighs less as mu falls. */
void mbs_stages_reweigh(mbs_stages *s, mbs_stages_phase *p)
{
    if (!p->elastic)
        return;
    s->weight_factor = real_sqrt(p->mu);
    p->cost = elastic_cost(s, p->x);
    elastic_gradient(s, p);
    mbs_stages_find_lagrangian(s, p);
}

int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p)
{
    return mbs_stages_hessian(s, p->x, p->elastic ? 0 : (real)1, p->y);
}

real mbs_stages_barrier(const mbs_stages *s, const mbs_stages_phase *p, const real *x, real cost)
{
    real logarithms = 0, distances = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        const int below = mbs_stages_has(p->lower[i]), above = mbs_stages_has(p->upper[i]);
        if (s->fixed[i])
            continue;
        if (below)
            logarithms += real_log(x[i] - p->lower[i]);
        if (above)
            logarithms += real_log(p->upper[i] - x[i]);
        if (below && !above)
            distances += x[i] - p->lower[i];
        if (above && !below)
            distances += p->upper[i] - x[i];
    }
    return cost - p->mu * (logarithms - s->options.kappa_d * distances);
}

static real barrier_slope(const mbs_stages_phase *p, int i)
{
    const int below = mbs_stages_has(p->lower[i]), above = mbs_stages_has(p->upper[i]);
    real slope = 0;
    if (below)
        slope -= p->mu / (p->x[i] - p->lower[i]);
    if (above)
        slope += p->mu / (p->upper[i] - p->x[i]);
    if (below != above)
        slope += below ? p->options->kappa_d * p->mu : -p->options->kappa_d * p->mu;
    return slope;
}

/* The derivative of the barrier function along dx. */
real mbs_stages_descent(const mbs_stages *s, const mbs_stages_phase *p, const real *dx)
{
    real sum = 0;
    int i;
    for (i = 0; i < p->size; ++i)
        if (!s->fixed[i])
            sum += (p->gradient[i] + barrier_slope(p, i)) * dx[i];
    return sum;
}

/* Derivatives of cost and rows, for the multipliers that are there; to be found anew where these change. */
void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    const int at = s->variables, plus = at + s->slacks, minus = plus + s->rows;
    real *out = p->lagrangian;
    int k, i;
    memcpy(out, p->gradient, (size_t)p->size * sizeof *out);
    mbs_stages_add_transposed(&s->recursion, p->y, out);
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i)
            out[at + t->s + i] -= p->y[t->g + i];
    }
    for (i = 0; p->elastic && i < s->rows; ++i) {
        out[plus + i] -= p->y[i];
        out[minus + i] += p->y[i];
    }
}

/* Derivatives of the Lagrangian, with multipliers of bounds, or with the derivatives of the barrier for them. */
void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    int i;
    for (i = 0; i < p->size; ++i)
        if (s->fixed[i])
            out[i] = 0;
        else
            out[i] = p->lagrangian[i] + (barrier ? barrier_slope(p, i) : p->zu[i] - p->zl[i]);
}

/* Largest |distance z - mu|; the sum of z, and how many there are. */
static real complementarity(const mbs_stages *s, const mbs_stages_phase *p, real mu, real *sum, int *count)
{
    real most = 0;
    int i;
    *sum = 0;
    *count = 0;
    for (i = 0; i < p->size; ++i) {
        real a = 0, b = 0;
        if (s->fixed[i])
            continue;
        if (mbs_stages_has(p->lower[i]))
            a = real_abs((p->x[i] - p->lower[i]) * p->zl[i] - mu), ++*count;
        if (mbs_stages_has(p->upper[i]))
            b = real_abs((p->upper[i] - p->x[i]) * p->zu[i] - mu), ++*count;
        *sum += p->zl[i] + p->zu[i];
        most = a > most ? a : most;
        most = b > most ? b : most;
    }
    return most;
}

/* The mean of distance z, after steps of x and z if there are any. */
real mbs_stages_mean_product(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d, real alpha,
                             real dual)
{
    real sum = 0;
    int i, count = 0;
    for (i = 0; i < p->size; ++i) {
        const real x = p->x[i] + (d ? alpha * d->x[i] : 0);
        if (s->fixed[i])
            continue;
        if (mbs_stages_has(p->lower[i]))
            sum += (x - p->lower[i]) * (p->zl[i] + (d ? dual * d->zl[i] : 0)), ++count;
        if (mbs_stages_has(p->upper[i]))
            sum += (p->upper[i] - x) * (p->zu[i] + (d ? dual * d->zu[i] : 0)), ++count;
    }
    return count > 0 ? sum / (real)count : 0;
}

static real size_of(real sum, int count, real usual)
{
    const real mean = count > 0 ? sum / (real)count : 0;
    const real size = mean > usual ? mean / usual : 1;
    return size < MOST_FORGIVEN ? size : MOST_FORGIVEN;
}

/* The residual of a row in its own unit; a row with steep slopes, as of squares of many metres, rounds by more. */
static real unscale_residual(real c, real scale)
{
    const real rounding = scale < 1 ? ROW_ROUNDING * MBS_STAGES_EPSILON : 0, own = real_abs(c) - rounding;
    return own > 0 || own != own ? own / scale : 0;
}

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    mbs_stages_errors e;
    real sum, dual, slack;
    int count, i;
    mbs_stages_stationarity(s, p, 0, p->slope);
    e.complementarity = complementarity(s, p, mu, &sum, &count);
    e.stationarity = mbs_stages_largest(p->size, p->slope);
    e.scaled = mbs_stages_largest(s->rows, p->c);
    dual = e.stationarity / size_of(sum + mbs_stages_sum(s->rows, p->y), count + s->rows, s->options.s_max);
    slack = e.complementarity / size_of(sum, count, s->options.s_max);
    e.violation = 0;
    for (i = 0; i < s->rows; ++i) {
        const real c = unscale_residual(p->c[i], s->row_scale[i]);
        e.violation = c > e.violation ? c : e.violation;
    }
    e.dual = dual > slack ? dual : slack;
    e.scaled = e.dual > e.scaled ? e.dual : e.scaled;
    return e;
}

/* The errors of optimality conditions that rounding alone makes: multipliers of restoration are as large as its
 * penalty. */
real mbs_stages_rounding(const mbs_stages_phase *p)
{
    return p->elastic ? 100 * MBS_STAGES_EPSILON * p->options->resto_penalty_parameter : 0;
}

/* The largest step, at most 1, that keeps a part 1 - tau of each distance. */
real mbs_stages_boundary(const mbs_stages *s, const mbs_stages_phase *p, const real *x, const real *dx, real tau)
{
    real alpha = 1;
    int i;
    for (i = 0; i < p->size; ++i) {
        if (s->fixed[i])
            continue;
        if (dx[i] < 0 && mbs_stages_has(p->lower[i]) && -dx[i] * alpha > tau * (x[i] - p->lower[i]))
            alpha = tau * (x[i] - p->lower[i]) / -dx[i];
        if (dx[i] > 0 && mbs_stages_has(p->upper[i]) && dx[i] * alpha > tau * (p->upper[i] - x[i]))
            alpha = tau * (p->upper[i] - x[i]) / dx[i];
    }
    return alpha;
}

real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d)
{
    real alpha = 1;
    int i;
    for (i = 0; i < p->size; ++i) {
        if (s->fixed[i])
            continue;
        if (d->zl[i] < 0 && -d->zl[i] * alpha > p->tau * p->zl[i])
            alpha = p->tau * p->zl[i] / -d->zl[i];
        if (d->zu[i] < 0 && -d->zu[i] * alpha > p->tau * p->zu[i])
            alpha = p->tau * p->zu[i] / -d->zu[i];
    }
    return alpha;
}

/* Move a number inside its bounds, by `push` of their distance or magnitude. */
void mbs_stages_push_inside(real *x, real lower, real upper, real push)
{
    real a = push * (real_abs(lower) > 1 ? real_abs(lower) : 1), b = push * (real_abs(upper) > 1 ? real_abs(upper) : 1);
    const int below = mbs_stages_has(lower), above = mbs_stages_has(upper);
    if (below && above) {
        const real c = push * (upper - lower);
        a = a < c ? a : c;
        b = b < c ? b : c;
    }
    if (below && !(*x >= lower + a))
        *x = lower + a;
    if (above && !(*x <= upper - b))
        *x = upper - b;
}

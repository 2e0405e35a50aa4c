/* Control in real time: one Newton step of the barrier problem, split at the measurement.
 *
 * The barrier parameter stays, so that steps from one sampling period to the next go on with one another's work: with
 * nothing disturbed, they converge as Newton's method does. A step is linear in the first state. Prepared is the step
 * for the first state of the iterate, with all refinement; feedback adds its response to the measured deviation,
 * which is a sweep ahead without right-hand sides.
 *
 * There is no line search, so steps can diverge. The violation of a plan is of second order in the step that made it.
 * Where it exceeds the plan's own numbers, the linear equations say nothing about the next step, and there is none.
 *
 * Each variable takes the whole step or goes almost to its own bound. One length for all of
 * them would stop the inputs of now because of a bound that matters much later. */
#include "solver.h"

#include <string.h>

static void limit_ratio(real distance, real *z, real mu)
{
    const real middle = mu / distance;
    if (!(*z >= middle / CENTRAL_RATIO))
        *z = middle / CENTRAL_RATIO;
    if (*z > middle * CENTRAL_RATIO)
        *z = middle * CENTRAL_RATIO;
}

/* The least distance from a bound that has digits enough for a step to leave a part of it. */
static real least_distance(const mbs_stages_phase *p, real bound)
{
    const real a = real_sqrt(MBS_STAGES_EPSILON) * p->mu, b = 1000 * MBS_STAGES_EPSILON * real_abs(bound);
    return a > b ? a : b;
}

/* Put a variable that is outside of its bounds, or too near to one, on the central path. */
static void start_anew(mbs_stages_phase *p, int i, real least)
{
    const real most = p->mu / least;
    p->zl[i] = p->zl[i] < most ? p->zl[i] : most;
    p->zu[i] = p->zu[i] < most ? p->zu[i] : most;
    mbs_stages_centre(p, i);
}

/* Bring a variable inside its bounds, and its multipliers near the central path. */
static void mind_bounds(const mbs_stages *s, mbs_stages_phase *p, int i)
{
    const int below = mbs_stages_has(p->lower[i]), above = mbs_stages_has(p->upper[i]);
    const real a = below ? least_distance(p, p->lower[i]) : 0, b = above ? least_distance(p, p->upper[i]) : 0;
    if (s->fixed[i])
        return;
    if ((below && !(p->x[i] - p->lower[i] > a)) || (above && !(p->upper[i] - p->x[i] > b)))
        start_anew(p, i, a > b ? a : b);
    if (below)
        limit_ratio(p->x[i] - p->lower[i], &p->zl[i], p->mu);
    if (above)
        limit_ratio(p->upper[i] - p->x[i], &p->zu[i], p->mu);
}

/* Fixed variables take their bounds, except for the first state: that is measured later. */
static void load_variables(const mbs_stages *s, mbs_stages_phase *p)
{
    const int first = s->recursion.stage[0].nx;
    int i;
    for (i = 0; i < s->variables; ++i) {
        const int fixed = s->fixed[i];
        const real factor = s->variable_scale[i] * s->cost_scale;
        p->x[i] = fixed && i >= first ? p->lower[i] : s->point.w[i] / s->variable_scale[i];
        p->zl[i] = fixed || !mbs_stages_has(p->lower[i]) ? 0 : s->point.below[i] * factor;
        p->zu[i] = fixed || !mbs_stages_has(p->upper[i]) ? 0 : s->point.above[i] * factor;
    }
}

static void load_slacks(const mbs_stages *s, mbs_stages_phase *p, const mbs_stages_stage *t)
{
    int i;
    for (i = 0; i < t->ng; ++i) {
        const int from = t->s + i, to = s->variables + from;
        const real scale = s->row_scale[t->g + i];
        p->x[to] = s->fixed[to] ? p->lower[to] : s->slack[from] * scale;
        p->zl[to] = s->fixed[to] || !mbs_stages_has(p->lower[to]) ? 0 : s->slack_below[from] * s->cost_scale / scale;
        p->zu[to] = s->fixed[to] || !mbs_stages_has(p->upper[to]) ? 0 : s->slack_above[from] * s->cost_scale / scale;
    }
}

/* Take the iterate of the last step, with the scales of the first one. */
static int load(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    int k, i;
    if (mbs_stages_set_bounds(s))
        return MBS_STAGES_BAD_PROBLEM;
    p->mu = mbs_stages_least_barrier(s);
    load_variables(s, p);
    for (i = 0; i < s->rows; ++i)
        p->y[i] = s->point.y[i] * s->cost_scale / s->row_scale[i];
    for (k = 0; k < s->problem->stages; ++k)
        load_slacks(s, p, &s->recursion.stage[k]);
    for (i = 0; i < p->size; ++i)
        mind_bounds(s, p, i);
    return MBS_STAGES_RUNNING;
}

static void save(mbs_stages *s)
{
    const mbs_stages_phase *p = &s->main;
    int k, i;
    mbs_stages_write_point(s);
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i) {
            const int to = t->s + i, from = s->variables + to;
            const real scale = s->row_scale[t->g + i];
            s->slack[to] = p->x[from] / scale;
            s->slack_below[to] = p->zl[from] * scale / s->cost_scale;
            s->slack_above[to] = p->zu[from] * scale / s->cost_scale;
        }
    }
}

/* Evaluate all functions at the iterate. */
static int evaluate(mbs_stages *s, mbs_stages_phase *p)
{
    if (mbs_stages_phase_values(s, p, p->x, &p->cost, p->c) || mbs_stages_phase_derivatives(s, p) ||
        mbs_stages_phase_hessian(s, p))
        return MBS_STAGES_CALLBACK_FAILED;
    return MBS_STAGES_RUNNING;
}

static void measure(mbs_stages *s, mbs_stages_phase *p)
{
    const mbs_stages_errors e = mbs_stages_measure_errors(s, p, p->mu);
    int i;
    s->realtime.violation = e.violation;
    s->realtime.complementarity = e.complementarity / s->cost_scale;
    for (i = 0; i < s->variables; ++i) {
        const real a = real_abs(p->slope[i]) / (s->variable_scale[i] * s->cost_scale);
        s->realtime.stationarity = a > s->realtime.stationarity ? a : s->realtime.stationarity;
    }
}

static int is_finite(int n, const real *x)
{
    int i, finite = 1;
    for (i = 0; i < n; ++i)
        finite &= real_abs(x[i]) <= MBS_STAGES_LARGEST;
    return finite;
}

/* The step for the first state of the iterate. */
static int find_step(mbs_stages *s, mbs_stages_phase *p)
{
    if (mbs_stages_newton_factorise(s, p))
        return MBS_STAGES_OUT_OF_DIGITS;
    mbs_stages_stationarity(s, p, 1, p->slope);
    mbs_stages_newton_solve(s, p, p->c, &p->step);
    return is_finite(p->size, p->step.x) && is_finite(s->rows, p->step.y) ? MBS_STAGES_PREPARED
                                                                         : MBS_STAGES_OUT_OF_DIGITS;
}

/* Whether the violation is one that steps do not come back from. */
static int has_diverged(const mbs_stages *s, const mbs_stages_phase *p)
{
    const real given = s->options.most_violation;
    return mbs_stages_largest(s->rows, p->c) > (given > 0 ? given : HOPELESS_VIOLATION * s->usual);
}

/* The first plan gives the measure of violations: its numbers, and its own violation where it is a guess. */
static int begin(mbs_stages *s)
{
    const int status = mbs_stages_start(s);
    real size, violation;
    if (status != MBS_STAGES_RUNNING)
        return status;
    size = mbs_stages_largest(s->variables, s->main.x);
    violation = mbs_stages_largest(s->rows, s->main.c);
    size = violation > size ? violation : size;
    s->usual = size > 1 ? size : 1;
    return status;
}

static int prepare(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    int status = s->live ? load(s) : begin(s);
    if (status != MBS_STAGES_RUNNING)
        return status;
    p->tau = (real)0.99;
    s->softening = MBS_STAGES_HARD_FOR_GOOD; /* the response to the first state is not refined */
    status = evaluate(s, p);
    if (status != MBS_STAGES_RUNNING)
        return status;
    mbs_stages_find_lagrangian(s, p);
    measure(s, p);
    return s->live && has_diverged(s, p) ? MBS_STAGES_DIVERGED : find_step(s, p);
}

mbs_stages_realtime mbs_stages_prepare(mbs_stages *s, const mbs_stages_options *options, int shift)
{
    mbs_stages_realtime *about = &s->realtime;
    int status;
    memset(about, 0, sizeof *about);
    memset(&s->result, 0, sizeof s->result);
    s->options = options ? *options : mbs_stages_default_options();
    s->options.warm_start_init_point = 1;
    s->options.adaptive = 0;
    s->options.mu_init = MBS_STAGES_EPSILON;
    if (!(s->options.mu_target > 0))
        s->options.mu_target = REALTIME_BARRIER;
    s->failed_stage = -1;
    if (shift)
        mbs_stages_shift(s);
    status = prepare(s);
    s->ready = status == MBS_STAGES_PREPARED;
    about->status = (mbs_stages_status)status;
    about->stage = status == MBS_STAGES_CALLBACK_FAILED || status == MBS_STAGES_BAD_PROBLEM ? s->failed_stage : -1;
    about->factorisations = s->result.factorisations;
    about->curvature = s->main.added;
    return *about;
}

void mbs_stages_begin_anew(mbs_stages *s)
{
    s->live = s->ready = 0;
}

/* The scaled deviation of fixed first states; -1 where one is not a number. */
static int find_deviation(mbs_stages *s, const real *first, real *deviation)
{
    const int n = s->recursion.stage[0].nx;
    int i;
    for (i = 0; i < n; ++i)
        deviation[i] = s->fixed[i] ? first[i] / s->variable_scale[i] - s->main.x[i] : 0;
    s->realtime.deviation = mbs_stages_largest(n, deviation);
    return is_finite(n, deviation) ? 0 : -1;
}

/* Add the response to the deviation to the step. */
static int respond(mbs_stages *s, mbs_stages_phase *p, const real *deviation)
{
    int i;
    memset(s->residual_c, 0, (size_t)s->rows * sizeof *s->residual_c);
    mbs_stages_respond(&s->recursion, deviation, s->residual_c, s->dw, s->dy);
    for (i = 0; i < s->variables; ++i)
        p->step.x[i] += s->dw[i];
    for (i = 0; i < s->rows; ++i)
        p->step.y[i] += s->dy[i];
    mbs_stages_spread(s, p, &p->step);
    return is_finite(p->size, p->step.x) && is_finite(s->rows, p->step.y) ? 0 : -1;
}

/* The part of its step, at most 1, that keeps variable i inside its bounds. */
static real length(const mbs_stages_phase *p, int i)
{
    const real step = p->step.x[i], below = p->tau * (p->x[i] - p->lower[i]), above = p->tau * (p->upper[i] - p->x[i]);
    if (mbs_stages_has(p->lower[i]) && -step > below)
        return below / -step;
    if (mbs_stages_has(p->upper[i]) && step > above)
        return above / step;
    return 1;
}

/* Multipliers of rows and of bounds have one length each for all of them: own lengths made convergence worse. */
static void make_step(mbs_stages *s, mbs_stages_phase *p)
{
    const real dual = mbs_stages_dual_boundary(s, p, &p->step);
    real least = 1;
    int i;
    for (i = 0; i < p->size; ++i) {
        const real alpha = s->fixed[i] ? 1 : length(p, i);
        least = alpha < least ? alpha : least;
        p->x[i] += alpha * p->step.x[i];
        p->zl[i] += dual * p->step.zl[i];
        p->zu[i] += dual * p->step.zu[i];
    }
    for (i = 0; i < s->rows; ++i)
        p->y[i] += least * p->step.y[i];
    s->realtime.length = p->alpha = least;
    s->realtime.dual_length = dual;
}

static int feedback(mbs_stages *s, const real *first)
{
    mbs_stages_phase *p = &s->main;
    if (!s->ready)
        return MBS_STAGES_NOT_PREPARED;
    if (find_deviation(s, first, s->rw)) {
        s->failed_stage = 0;
        return MBS_STAGES_BAD_PROBLEM;
    }
    s->ready = 0;
    return respond(s, p, s->rw) ? MBS_STAGES_OUT_OF_DIGITS : MBS_STAGES_STEPPED;
}

mbs_stages_realtime mbs_stages_feedback(mbs_stages *s, const real *first, real *v)
{
    const mbs_stages_stage *t = &s->recursion.stage[0];
    const int status = feedback(s, first);
    s->realtime.status = (mbs_stages_status)status;
    if (status == MBS_STAGES_STEPPED) {
        make_step(s, &s->main);
        save(s);
        s->live = 1;
    }
    memcpy(v, s->point.w + t->w + t->nx, (size_t)t->nv * sizeof *v);
    s->realtime.stage = status == MBS_STAGES_BAD_PROBLEM ? s->failed_stage : s->realtime.stage;
    return s->realtime;
}

/* Whether there are factors of a step. */
static int has_step(const mbs_stages *s)
{
    return s->ready || (s->live && s->realtime.status == MBS_STAGES_STEPPED);
}

const real *mbs_stages_gain(mbs_stages *s, int j)
{
    const int n = s->recursion.stage[0].nx;
    int i;
    if (!has_step(s))
        return NULL;
    memset(s->rw, 0, (size_t)n * sizeof *s->rw);
    if (j >= 0 && j < n && s->fixed[j])
        s->rw[j] = 1 / s->variable_scale[j];
    memset(s->residual_c, 0, (size_t)s->rows * sizeof *s->residual_c);
    mbs_stages_respond(&s->recursion, s->rw, s->residual_c, s->dw, s->dy);
    for (i = 0; i < s->variables; ++i)
        s->dw[i] *= s->variable_scale[i];
    return is_finite(s->variables, s->dw) ? s->dw : NULL;
}

#ifndef MBS_STAGES_REALTIME
/* With f the free variables and h the held first ones, g their weights: g_h - K_hf K_ff^-1 g_f. */
int mbs_stages_adjoint(mbs_stages *s, const real *weights, real *first)
{
    const mbs_stages_stage *t = &s->recursion.stage[0];
    int i;
    if (!has_step(s))
        return -1;
    for (i = 0; i < s->variables; ++i)
        s->rw[i] = -weights[i] * s->variable_scale[i];
    memset(s->rc, 0, (size_t)s->rows * sizeof *s->rc);
    mbs_stages_sweep(&s->recursion, s->rw, s->rc, s->dw, s->dy);
    memset(s->residual_w, 0, (size_t)t->n * sizeof *s->residual_w);
    mbs_stages_matrix_apply_symmetric(&t->H, s->dw, s->residual_w);
    mbs_stages_add_stage_both(&s->recursion, 0, s->dw, s->residual_c, s->dy, s->residual_w);
    for (i = 0; i < t->nx; ++i)
        first[i] = s->fixed[i] ? weights[i] - s->residual_w[i] / s->variable_scale[i] : 0;
    return is_finite(t->nx, first) ? 0 : -1;
}
#endif

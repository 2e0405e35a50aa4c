/* A solve: from the caller's numbers to scaled ones, the barrier problem, and back. */
#include "condense.h"
#include "solver.h"

#include <string.h>

static const real NONE = 2 * MBS_STAGES_INFINITE;

static void set_barrier(mbs_stages_options *o)
{
    o->barrier_tol_factor = 10;
    o->mu_linear_decrease_factor = (real)0.2;
    o->mu_superlinear_decrease_power = (real)1.5;
    o->tau_min = (real)0.99;
    o->kappa_d = (real)1e-5;
    o->kappa_sigma = (real)1e10;
    o->s_max = 100;
    o->diverging_iterates_tol = (real)1e20;
    o->nlp_scaling_max_gradient = 100;
    o->nlp_scaling_min_value = (real)1e-16;
}

static void set_search(mbs_stages_options *o)
{
    o->theta_max_fact = 100;
    o->theta_min_fact = (real)1e-4;
    o->gamma_theta = (real)1e-5;
    o->gamma_phi = (real)1e-8;
    o->delta = 1;
    o->s_theta = (real)1.1;
    o->s_phi = (real)2.3;
    o->eta_phi = (real)1e-8;
    o->alpha_min_frac = (real)0.05;
    o->obj_max_inc = 5;
    o->max_soc = 4;
    o->kappa_soc = (real)0.99;
    o->watchdog_shortened_iter_trigger = 10;
    o->watchdog_trial_iter_max = 3;
    o->max_soft_resto_iters = 10;
    o->soft_resto_pderror_reduction_factor = (real)0.9999;
    o->required_infeasibility_reduction = (real)0.9;
    o->resto_penalty_parameter = 1000;
    o->bound_mult_reset_threshold = 1000;
}

static void set_curvature(mbs_stages_options *o)
{
    o->first_hessian_perturbation = (real)1e-4;
    o->min_hessian_perturbation = (real)1e-20;
    o->max_hessian_perturbation = (real)1e20;
    o->perturb_inc_fact_first = 100;
    o->perturb_inc_fact = 6;
    o->max_refinement_steps = 8;
}

mbs_stages_options mbs_stages_default_options(void)
{
    mbs_stages_options o;
    const int few = MBS_STAGES_EPSILON > (real)1e-10; /* digits */
    memset(&o, 0, sizeof o);
    o.tol = MBS_STAGES_TOLERANCE;
    o.constr_viol_tol = few ? (real)1e-3 : (real)1e-4;
    o.acceptable_tol = few ? (real)1e-3 : (real)1e-6;
    o.acceptable_iter = 15;
    o.max_iter = 3000;
    o.scaled = 1;
    o.bound_push = (real)0.01;
    o.bound_relax_factor = few ? (real)1e-5 : (real)1e-8;
    set_barrier(&o);
    set_search(&o);
    set_curvature(&o);
    return o;
}

static real bound(const real *bounds, int i, real none, real factor)
{
    const real b = bounds ? bounds[i] : none;
    return real_abs(b) < MBS_STAGES_INFINITE ? b * factor : b;
}

/* The usual size of a variable: the caller's, or by the option the larger of two bounds. */
static real variable_scale(const mbs_stages *s, int i)
{
    const mbs_stages_problem *p = s->problem;
    real a, b;
    if (p->scale)
        return p->scale[i];
    if (!s->options.scale_by_bounds || !p->lower || !p->upper || p->lower[i] == p->upper[i])
        return 1;
    a = real_abs(p->lower[i]);
    b = real_abs(p->upper[i]);
    a = a > b ? a : b;
    return a < MBS_STAGES_INFINITE && a > 0 ? a : 1;
}

/* Scales of variables and of d; -1 where one is not a positive number. */
static int set_scales(mbs_stages *s)
{
    int k, i, wrong = 0;
    s->has_scales = s->has_units = 0;
    for (i = 0; i < s->variables; ++i) {
        s->variable_scale[i] = variable_scale(s, i);
        s->has_units |= s->variable_scale[i] != 1;
        wrong |= !(s->variable_scale[i] > 0 && s->variable_scale[i] < MBS_STAGES_INFINITE);
    }
    for (i = 0; i < s->rows; ++i)
        s->row_scale[i] = 1;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->next; ++i)
            s->row_scale[t->d + i] = 1 / s->variable_scale[(t + 1)->w + i];
    }
    s->cost_scale = 1;
    return wrong ? -1 : 0;
}

static real relaxed(real bound, real amount)
{
    return mbs_stages_has(bound) ? bound + amount * mbs_stages_bound_size(bound) : bound;
}

/* Bounds of variables or slacks from `at` on; returns how many are equal, or -1 if they are no bounds. */
static int set_bounds(mbs_stages *s, int at, int n, const real *lower, const real *upper, const real *factor,
                      int inverse)
{
    mbs_stages_phase *p = &s->main;
    int i, equal = 0;
    for (i = 0; i < n; ++i) {
        const real scale = inverse ? 1 / factor[i] : factor[i];
        const real a = bound(lower, i, -NONE, scale), b = bound(upper, i, NONE, scale);
        if (!(a <= b) || a >= MBS_STAGES_INFINITE || b <= -MBS_STAGES_INFINITE)
            return -1;
        s->fixed[at + i] = a == b;
        p->lower[at + i] = a == b ? a : relaxed(a, -s->options.bound_relax_factor);
        p->upper[at + i] = a == b ? b : relaxed(b, s->options.bound_relax_factor);
        equal += a == b;
    }
    return equal;
}

static const real *from(const real *numbers, int at)
{
    return numbers ? numbers + at : NULL;
}

/* Bounds of all variables and slacks; -1 where they are not as they must be. */
int mbs_stages_set_bounds(mbs_stages *s)
{
    const mbs_stages_problem *p = s->problem;
    int k;
    for (k = 0; k < p->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        const int a = set_bounds(s, t->w, t->n, from(p->lower, t->w), from(p->upper, t->w),
                                 s->variable_scale + t->w, 1);
        const int b = set_bounds(s, s->variables + t->s, t->ng, from(p->least, t->s), from(p->most, t->s),
                                 s->row_scale + t->g, 0);
        s->failed_stage = k;
        if (a < 0 || b < 0 || a + b > t->equal)
            return -1;
    }
    return 0;
}

static void start_variables(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    int i;
    for (i = 0; i < s->variables; ++i) {
        p->x[i] = s->point.w[i] / s->variable_scale[i];
        if (s->fixed[i])
            p->x[i] = p->lower[i];
        else if (MBS_STAGES_SEARCHES && !s->options.warm_start_init_point)
            mbs_stages_push_inside(&p->x[i], p->lower[i], p->upper[i], s->options.bound_push);
    }
}

static real gentle(const mbs_stages_options *o, real steepest)
{
    const real scale = steepest > o->nlp_scaling_max_gradient ? o->nlp_scaling_max_gradient / steepest : 1;
    return scale > o->nlp_scaling_min_value ? scale : o->nlp_scaling_min_value;
}

/* The smallest scale of a variable, if it is so small that rows may be flat for it; else 1. */
static real finest_unit(const mbs_stages *s)
{
    real least = 1;
    int i;
    for (i = 0; s->has_units && i < s->variables; ++i)
        least = s->variable_scale[i] < least ? s->variable_scale[i] : least;
    return least < SMALL_UNIT ? least : 1;
}

/* Rows that are steep are divided. Flat ones in small units are multiplied, since the tolerance is absolute; at most by
 * what a product of two small ones takes. */
static real scale_row(const mbs_stages_options *o, real steepest, real finest)
{
    if (finest < 1 && steepest * o->nlp_scaling_max_gradient < 1)
        return 1 / mbs_stages_larger(steepest, steepest > 0 ? finest * finest : finest);
    return gentle(o, steepest);
}

static void scale_rows(const mbs_stages *s, real *scale, int rows, real finest)
{
    int i;
    for (i = 0; i < rows; ++i)
        scale[i] = scale_row(&s->options, scale[i], finest);
}

static void share_slopes(real *slopes, const real *others, int rows)
{
    int i;
    for (i = 0; i < rows; ++i)
        slopes[i] = mbs_stages_larger(slopes[i], others[i]);
}

static void share_with(mbs_stages *s, int k, int other)
{
    const mbs_stages_stage *t = &s->recursion.stage[k], *o = &s->recursion.stage[other];
    if (t->E.rows == o->E.rows)
        share_slopes(s->row_scale + t->e, s->row_scale + o->e, t->E.rows);
    if (t->G.rows == o->G.rows)
        share_slopes(s->row_scale + t->g, s->row_scale + o->g, t->G.rows);
}

/* Rows at the same places of stages that follow each other are of one kind, and get the largest slope of all: a slope may
 * be 0 by chance. Only small units ask for that: elsewhere rows whose slopes vary would be scaled by the steepest. */
static void share_along(mbs_stages *s)
{
    int k;
    for (k = 1; k < s->problem->stages; ++k)
        share_with(s, k, k - 1);
    for (k = s->problem->stages - 2; k >= 0; --k)
        share_with(s, k, k + 1);
}

/* Scale the cost and the rows of e and g by their first derivatives. */
static int scale_functions(mbs_stages *s)
{
    const real finest = MBS_STAGES_SEARCHES ? finest_unit(s) : 1;
    int k;
    if (!s->options.scaled)
        return 0;
    if (mbs_stages_jacobians(s, s->main.x, s->main.gradient))
        return -1;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        mbs_stages_matrix_row_maxima(&t->E, s->row_scale + t->e);
        mbs_stages_matrix_row_maxima(&t->G, s->row_scale + t->g);
    }
    if (finest < 1)
        share_along(s);
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        scale_rows(s, s->row_scale + t->e, t->E.rows, finest);
        scale_rows(s, s->row_scale + t->g, t->G.rows, finest);
    }
    s->cost_scale = gentle(&s->options, mbs_stages_largest(s->variables, s->main.gradient));
    return 0;
}

/* Slacks take the values of g, inside their bounds. */
static int start_slacks(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    real cost;
    int k, i;
    if (s->slacks && mbs_stages_values(s, p->x, &cost, p->c))
        return -1;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i) {
            const int at = s->variables + t->s + i;
            p->x[at] = s->fixed[at] ? p->lower[at] : p->c[t->g + i];
            if (MBS_STAGES_SEARCHES && !s->fixed[at] && !s->options.warm_start_init_point)
                mbs_stages_push_inside(&p->x[at], p->lower[at], p->upper[at], s->options.bound_push);
        }
    }
    return 0;
}

static void start_bounds(const mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const int fixed = s->fixed[i];
        p->zl[i] = !fixed && p->lower[i] > -MBS_STAGES_INFINITE ? 1 : 0;
        p->zu[i] = !fixed && p->upper[i] < MBS_STAGES_INFINITE ? 1 : 0;
    }
}

/* A distance from a bound, and its multiplier, on the central path: distance z = mu. The larger one stays. */
static void centre(real *distance, real *z, real most, real mu)
{
    const real root = real_sqrt(mu), strong = *z > root ? *z : root;
    if (!(*distance > mu / strong))
        *distance = mu / strong;
    if (*distance > most)
        *distance = most;
    *z = mu / *distance;
}

void mbs_stages_centre(mbs_stages_phase *p, int i)
{
    const int below = p->lower[i] > -MBS_STAGES_INFINITE, above = p->upper[i] < MBS_STAGES_INFINITE;
    const real most = below && above ? (p->upper[i] - p->lower[i]) / 2 : NONE;
    real a = p->x[i] - p->lower[i], b = p->upper[i] - p->x[i];
    if (below && (!above || a <= b)) {
        centre(&a, &p->zl[i], most, p->mu);
        p->x[i] = p->lower[i] + a;
        b = p->upper[i] - p->x[i];
    } else if (above) {
        centre(&b, &p->zu[i], most, p->mu);
        p->x[i] = p->upper[i] - b;
        a = p->x[i] - p->lower[i];
    }
    if (below)
        p->zl[i] = p->mu / a;
    if (above)
        p->zu[i] = p->mu / b;
}

/* Take all multipliers of the iterate, and put the point on the central path. */
static void start_warm(mbs_stages *s, mbs_stages_phase *p)
{
    int k, i;
    for (i = 0; i < s->rows; ++i)
        p->y[i] = s->point.y[i] * s->cost_scale / s->row_scale[i];
    for (i = 0; i < s->variables; ++i) {
        const real factor = s->variable_scale[i] * s->cost_scale;
        p->zl[i] = s->point.below[i] * factor;
        p->zu[i] = s->point.above[i] * factor;
    }
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i) {
            const real y = p->y[t->g + i];
            p->zl[s->variables + t->s + i] = y < 0 ? -y : 0;
            p->zu[s->variables + t->s + i] = y > 0 ? y : 0;
        }
    }
    for (i = 0; i < p->size; ++i)
        if (s->fixed[i])
            p->zl[i] = p->zu[i] = 0;
        else
            mbs_stages_centre(p, i);
}

/* The mean of distance z after a step that aims at 0, beside the mean before it, sets the first barrier parameter
 * (Mehrotra, 1992). */
static int choose_barrier(mbs_stages *s, mbs_stages_phase *p)
{
    real before, after, ratio, mu;
    if (mbs_stages_phase_derivatives(s, p) || mbs_stages_phase_hessian(s, p))
        return -1;
    before = mbs_stages_mean_product(s, p, NULL, 0, 0);
    p->mu = 0;
    if (before > 0 && mbs_stages_newton_factorise(s, p) == 0) {
        mbs_stages_find_lagrangian(s, p);
        mbs_stages_stationarity(s, p, 1, p->slope);
        mbs_stages_newton_solve(s, p, p->c, &p->step);
        after = mbs_stages_mean_product(s, p, &p->step, mbs_stages_boundary(s, p, p->x, p->step.x, 1),
                                        mbs_stages_dual_boundary(s, p, &p->step));
        ratio = after / before;
        mu = ratio * ratio * ratio * before;
        p->mu = mu > MBS_STAGES_LOW ? (mu < 100 ? mu : 100) : MBS_STAGES_LOW;
    } else {
        p->mu = (real)0.1;
    }
    return 0;
}

/* The barrier parameter to end with, scaled; 0: as low as the tolerance asks for. */
real mbs_stages_least_barrier(const mbs_stages *s)
{
    return s->options.mu_target > 0 ? s->options.mu_target * s->cost_scale : 0;
}

static real first_barrier(const mbs_stages *s)
{
    const mbs_stages_options *o = &s->options;
    const real first = o->mu_init > 0 ? o->mu_init : o->warm_start_init_point ? MBS_STAGES_LOW : (real)0.1;
    const real least = mbs_stages_least_barrier(s);
    return first > least ? first : least;
}

#ifndef MBS_STAGES_REALTIME
/* The first barrier parameter near the solution of another problem: the violation after a step, which falls with the
 * square of the one before, within the last one that the tolerance asks for and the usual one. */
static real near_barrier(const mbs_stages *s, real usual, real violation)
{
    const real last = s->options.tol / (s->options.barrier_tol_factor + 1), own = WARM_REST * violation * violation;
    const real first = own > last ? own : last;
    return first < usual && !(mbs_stages_least_barrier(s) > 0) ? first : usual;
}
#endif

/* Put a warm start on the central path. Where its first step is short, bounds that bind change, and it needs a higher
 * barrier parameter: the higher, the farther it is from its rows. The caller may choose one. */
static int centre_warm(mbs_stages *s, mbs_stages_phase *p)
{
    if (!(s->options.mu_init > 0)) {
        real violation;
        if (mbs_stages_phase_values(s, p, p->x, &p->cost, p->c))
            return -1;
        violation = mbs_stages_largest(s->rows, p->c);
        s->farther = violation * violation < WARM_BARRIER ? violation * violation : WARM_BARRIER;
#ifndef MBS_STAGES_REALTIME /* a step in real time keeps the barrier parameter that it aims at */
        if (s->options.warm_start_init_point == 2)
            p->mu = near_barrier(s, p->mu, violation);
#endif
    }
    start_warm(s, p);
    return mbs_stages_phase_values(s, p, p->x, &p->cost, p->c);
}

int mbs_stages_start_farther(mbs_stages *s, mbs_stages_phase *p)
{
    const real mu = s->farther;
    s->farther = 0;
    if (!(mu > p->mu))
        return 0;
    p->mu = mu;
    start_warm(s, p);
    if (mbs_stages_phase_values(s, p, p->x, &p->cost, p->c))
        return -1;
    mbs_stages_begin(s, p);
    return 1;
}

/* The first point and its multipliers; a status where that fails. */
int mbs_stages_start(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    const mbs_stages_options *o = &s->options;
    const int keeps = mbs_stages_continues(s) && s->has_scales;
    if ((!keeps && set_scales(s)) || mbs_stages_set_bounds(s))
        return MBS_STAGES_BAD_PROBLEM;
    start_variables(s);
    if (!keeps && scale_functions(s))
        return MBS_STAGES_CALLBACK_FAILED;
    s->has_scales = 1;
    if (!keeps && mbs_stages_set_bounds(s)) /* bounds that are nearly equal may become equal by scaling */
        return MBS_STAGES_BAD_PROBLEM;
    if (start_slacks(s))
        return MBS_STAGES_CALLBACK_FAILED;
    p->mu = first_barrier(s);
    s->farther = 0;
    if (MBS_STAGES_SEARCHES && !o->warm_start_init_point)
        start_bounds(s, p);
    if (!MBS_STAGES_SEARCHES || o->warm_start_init_point ? centre_warm(s, p) : mbs_stages_phase_values(s, p, p->x, &p->cost, p->c))
        return MBS_STAGES_CALLBACK_FAILED;
    if (mbs_stages_phase_derivatives(s, p))
        return MBS_STAGES_CALLBACK_FAILED;
    if (MBS_STAGES_SEARCHES && !o->warm_start_init_point)
        mbs_stages_estimate_multipliers(s, p);
    if (MBS_STAGES_SEARCHES && o->adaptive && choose_barrier(s, p))
        return MBS_STAGES_CALLBACK_FAILED;
    mbs_stages_begin(s, p);
    return MBS_STAGES_RUNNING;
}

void mbs_stages_write_point(mbs_stages *s)
{
    const mbs_stages_phase *p = &s->main;
    int i;
    for (i = 0; i < s->variables; ++i) {
        const real factor = s->variable_scale[i] * s->cost_scale;
        s->point.w[i] = p->x[i] * s->variable_scale[i];
        s->point.below[i] = p->zl[i] / factor;
        s->point.above[i] = p->zu[i] / factor;
    }
    for (i = 0; i < s->rows; ++i)
        s->point.y[i] = p->y[i] * s->row_scale[i] / s->cost_scale;
}

#ifndef MBS_STAGES_REALTIME
/* Multipliers of fixed variables: what the derivatives of the Lagrangian leave. */
static void find_fixed_multipliers(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    int i;
    memcpy(s->rw, p->gradient, (size_t)s->variables * sizeof *s->rw);
    mbs_stages_add_transposed(&s->recursion, p->y, s->rw);
    for (i = 0; i < s->variables; ++i)
        if (s->fixed[i]) {
            p->zl[i] = s->rw[i] > 0 ? s->rw[i] : 0;
            p->zu[i] = s->rw[i] < 0 ? -s->rw[i] : 0;
        }
}

static void write_result(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main;
    mbs_stages_errors e;
    int i;
    mbs_stages_find_lagrangian(s, p);
    e = mbs_stages_measure_errors(s, p, 0);
    s->result.cost = p->cost / s->cost_scale;
    s->result.violation = e.violation;
    s->result.complementarity = e.complementarity / s->cost_scale;
    s->result.barrier = p->mu;
    for (i = 0; i < s->variables; ++i) {
        const real a = real_abs(p->slope[i]) / (s->variable_scale[i] * s->cost_scale);
        s->result.stationarity = a > s->result.stationarity ? a : s->result.stationarity;
    }
}

mbs_stages_result mbs_stages_solve(mbs_stages *s, const mbs_stages_options *options)
{
    int status;
    memset(&s->result, 0, sizeof s->result);
    s->options = options ? *options : mbs_stages_default_options();
    s->failed_stage = -1;
    s->softening = MBS_STAGES_HARD;
    s->softer = 0;
    s->exact = s->unhelped = s->is_sharper = 0;
    s->giving = s->options.bound_relax_factor;
    s->cost_before = mbs_stages_continues(s) ? s->cost_before : 0;
    s->began = s->problem->clock ? s->problem->clock(s->problem->context) : 0;
    s->live = s->ready = 0;
    if (!mbs_stages_continues(s))
        mbs_stages_forget_orders(&s->recursion);
    status = mbs_stages_start(s);
    if (status == MBS_STAGES_RUNNING)
        status = mbs_stages_run(s, &s->main);
    if (status != MBS_STAGES_BAD_PROBLEM) {
        find_fixed_multipliers(s);
        mbs_stages_write_point(s);
        write_result(s);
        s->cost_before = mbs_stages_larger(s->cost_before, real_abs(s->main.cost));
    }
    s->result.status = (mbs_stages_status)status;
    s->result.stage = status == MBS_STAGES_CALLBACK_FAILED || status == MBS_STAGES_BAD_PROBLEM ? s->failed_stage : -1;
    return s->result;
}
#endif

/* Move numbers of stage k + 1 to stage k, where there are as many. */
static void shift_numbers(real *numbers, int to, int from_place, int n, int m)
{
    if (n == m)
        memmove(numbers + to, numbers + from_place, (size_t)n * sizeof *numbers);
}

void mbs_stages_shift(mbs_stages *s)
{
    mbs_stages_point *p = &s->point;
    int k;
    for (k = 0; k + 1 < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k], *next = t + 1;
        real *const of_w[] = {p->w, p->below, p->above};
        real *const of_slacks[] = {s->slack, s->slack_below, s->slack_above};
        size_t i;
        for (i = 0; i < sizeof of_slacks / sizeof *of_slacks; ++i)
            shift_numbers(of_slacks[i], t->s, next->s, t->ng, next->ng);
        for (i = 0; i < sizeof of_w / sizeof *of_w; ++i) {
            shift_numbers(of_w[i], t->w, next->w, t->nx, next->nx);
            shift_numbers(of_w[i], t->w + t->nx, next->w + next->nx, t->nv, next->nv);
        }
        shift_numbers(p->y, t->e, next->e, t->ne, next->ne);
        shift_numbers(p->y, t->d, next->d, t->next, next->next);
        shift_numbers(p->y, t->g, next->g, t->ng, next->ng);
    }
}

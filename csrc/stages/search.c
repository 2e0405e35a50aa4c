/* The line search: Waechter, Biegler, 2006, algorithm A, steps.
 *
 * A trial is accepted if it is acceptable to the filter and lowers the violation or the barrier function enough; where
 * the violation is small and the step promises descent, Armijo's condition stands instead. If the first trial raises
 * the violation, second-order corrections are tried.
 *
 * After ten short steps in a row a watchdog lets up to three whole steps pass unseen. If none of the points then is
 * better than the first one, the search goes back there. Where no length will do, steps that lower the errors of the
 * optimality conditions are made, before restoration (sections 3.2 and 3.3 there).
 *
 * A whole step that is refused, and that no correction mends, is still taken where it lowers the errors of the optimality
 * conditions by half: near a solution, rows that bend make good steps look bad (Maratos). Where steps are cut short again
 * and again, the next ones get curvature, although they are convex without.
 *
 * With the option `follow`, inner variables of a refused trial are corrected by their own equations. Then the trial's
 * violation is nearly the violation that it has where inner variables are functions of the others. */
#include "condense.h"
#include "solver.h"

#include <string.h>

typedef struct {
    real most;    /* the longest step that bounds allow */
    real descent; /* derivative of the barrier function along the step */
    real theta, phi; /* at the trial */
    int filtered;    /* the filter alone refused the last trial */
} search;

static real shortest(const mbs_stages_phase *p, const search *t)
{
    real alpha = p->options->gamma_theta;
    if (t->descent < 0) {
        const real b = p->options->gamma_phi * p->theta / -t->descent;
        const real c = p->options->delta * (real_pow(p->theta, p->options->s_theta) / real_pow(-t->descent, p->options->s_phi));
        alpha = b < alpha ? b : alpha;
        if (p->theta <= p->theta_least && c < alpha)
            alpha = c;
    }
    return p->options->alpha_min_frac * alpha;
}

/* A number that rounding put on a bound, or beyond it: half of the way there, or none if that has no digit. */
static real keep_inside(real x, real trial, real lower, real upper)
{
    if (!(trial > lower)) {
        const real half = x + (lower - x) / 2;
        return half > lower ? half : x;
    }
    if (!(trial < upper)) {
        const real half = x + (upper - x) / 2;
        return half < upper ? half : x;
    }
    return trial;
}

/* Evaluate the trial; returns -1 if there is no result. */
static int evaluate(mbs_stages *s, mbs_stages_phase *p, search *t)
{
    t->theta = t->phi = MBS_STAGES_LARGEST;
    if (mbs_stages_phase_values(s, p, p->trial, &p->trial_cost, p->trial_c))
        return -1;
    t->theta = mbs_stages_sum(s->rows, p->trial_c);
    t->phi = mbs_stages_barrier(s, p, p->trial, p->trial_cost);
    return real_abs(t->phi) <= MBS_STAGES_LARGEST && t->theta <= MBS_STAGES_LARGEST ? 0 : -1;
}

/* Evaluate x + alpha dx. */
static int try_step(mbs_stages *s, mbs_stages_phase *p, const real *dx, real alpha, search *t)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const real trial = p->x[i] + alpha * dx[i];
        p->trial[i] = s->fixed[i] ? trial : keep_inside(p->x[i], trial, p->lower[i], p->upper[i]);
    }
    return evaluate(s, p, t);
}

static int is_descent(const mbs_stages_phase *p, const search *t, real alpha)
{
    return t->descent < 0 && alpha * real_pow(-t->descent, p->options->s_phi) > p->options->delta * real_pow(p->theta, p->options->s_theta);
}

static int holds_armijo(const mbs_stages_phase *p, const search *t, real alpha)
{
    return mbs_stages_below(t->phi - p->phi, p->options->eta_phi * alpha * t->descent, p->phi);
}

static int rises_too_much(const mbs_stages_phase *p, const search *t)
{
    const real size = real_abs(p->phi) > 10 ? real_log10(real_abs(p->phi)) : 1;
    return t->phi > p->phi && real_log10(t->phi - p->phi) > p->options->obj_max_inc + size;
}

static int is_progress(const mbs_stages_phase *p, const search *t)
{
    if (rises_too_much(p, t))
        return 0;
    return mbs_stages_below(t->theta, (1 - p->options->gamma_theta) * p->theta, p->theta) ||
           mbs_stages_below(t->phi - p->phi, -p->options->gamma_phi * p->theta, p->phi);
}

static int is_accepted(const mbs_stages_phase *p, search *t, real alpha)
{
    t->filtered = 0;
    if (!(t->theta <= p->theta_most))
        return 0;
    if (is_descent(p, t, alpha) && p->theta <= p->theta_least ? !holds_armijo(p, t, alpha) : !is_progress(p, t))
        return 0;
    t->filtered = !mbs_stages_filter_accepts(&p->filter, t->theta, t->phi);
    return !t->filtered;
}

/* Correct all inner variables of the trial by their equations, with the factors of the iterate. */
static void correct_inner(mbs_stages *s, mbs_stages_phase *p)
{
    const mbs_stages_recursion *r = &s->recursion;
    int k, i;
    for (k = 0; k < s->problem->stages; k = mbs_stages_after_group(r, k))
        mbs_stages_solve_inner(r, &r->scratch[0], k, p->trial_c);
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        for (i = 0; i < t->inner.n; ++i) {
            const int at = t->w + t->nx + i;
            const real x = p->trial[at];
            if (!s->fixed[at])
                p->trial[at] = keep_inside(x, x + t->inner.constant[i], p->lower[at], p->upper[at]);
        }
    }
}

/* Let the inner variables of a refused trial follow the others, while that lowers the violation; -1: refused still. */
static int follow(mbs_stages *s, mbs_stages_phase *p, search *t, real alpha)
{
    int i;
    for (i = 0; s->options.follow && i < FOLLOWING_CORRECTIONS; ++i) {
        const real before = t->theta;
        correct_inner(s, p);
        if (evaluate(s, p, t))
            return -1;
        if (is_accepted(p, t, alpha))
            return 0;
        if (!(t->theta <= FOLLOWING_GAIN * before))
            return -1;
    }
    return -1;
}

static void exchange(mbs_stages_direction *a, mbs_stages_direction *b)
{
    const mbs_stages_direction t = *a;
    *a = *b;
    *b = t;
}

/* Correct the step for the curvature of rows; on success the correction is the step, and *length its length. */
static int correct(mbs_stages *s, mbs_stages_phase *p, search *t, real alpha, real *length)
{
    real before = t->theta;
    int k, i;
    memcpy(p->soc_c, p->c, (size_t)s->rows * sizeof *p->c);
    *length = alpha;
    for (k = 0; k < p->options->max_soc; ++k) {
        for (i = 0; i < s->rows; ++i)
            p->soc_c[i] = *length * p->soc_c[i] + p->trial_c[i];
        mbs_stages_newton_solve(s, p, p->soc_c, &p->other);
        *length = mbs_stages_boundary(s, p, p->x, p->other.x, p->tau);
        if (try_step(s, p, p->other.x, *length, t))
            return -1;
        if (is_accepted(p, t, alpha)) {
            exchange(&p->step, &p->other);
            return 0;
        }
        if (!(t->theta <= p->options->kappa_soc * before))
            return -1;
        before = t->theta;
    }
    return -1;
}

/* Steps with added curvature that are cut short again and again show that inner variables need curvature too. */
static void mind_length(mbs_stages_phase *p, real alpha)
{
    p->shortened = p->added > 0 && alpha < CUT_LENGTH ? p->shortened + 1 : 0;
    p->cautious |= p->shortened == CUT_OFTEN;
}

/* Take the trial: x and y by alpha, z by its own longest step. */
static void accept(mbs_stages *s, mbs_stages_phase *p, const search *t, real alpha)
{
    const real dual = mbs_stages_dual_boundary(s, p, &p->step);
    real *x = p->x;
    int i;
    p->x = p->trial;
    p->trial = x;
    for (i = 0; i < s->rows; ++i)
        p->y[i] += alpha * p->step.y[i];
    for (i = 0; i < p->size; ++i) {
        p->zl[i] += dual * p->step.zl[i];
        p->zu[i] += dual * p->step.zu[i];
    }
    memcpy(p->c, p->trial_c, (size_t)s->rows * sizeof *p->c);
    p->cost = p->trial_cost;
    p->theta_before = p->theta;
    p->theta = t->theta;
    p->alpha = alpha;
    mind_length(p, alpha);
}

static void augment(mbs_stages_phase *p, const search *t, real alpha)
{
    if (!is_descent(p, t, alpha) || !holds_armijo(p, t, alpha))
        mbs_stages_filter_add(&p->filter, (1 - p->options->gamma_theta) * p->theta, p->phi - p->options->gamma_phi * p->theta);
}

static int is_tiny(const mbs_stages *s, const mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i)
        if (real_abs(p->step.x[i]) > TINY_STEP * (1 + real_abs(p->x[i])))
            return 0;
    return mbs_stages_largest(s->rows, p->c) <= TINY_VIOLATION;
}

/* A filter that alone refuses first trials again and again was made far from here: start it anew. */
static void mind_refusals(mbs_stages_phase *p, int refused)
{
    p->rejected = refused ? p->rejected + 1 : 0;
    if (p->rejected >= MOST_REFUSALS && p->resets < MOST_RESETS) {
        mbs_stages_filter_clear(&p->filter);
        p->rejected = 0;
        ++p->resets;
    }
}

static void note_length(mbs_stages_phase *p, int first)
{
    p->watchdog.shortened = first ? 0 : p->watchdog.shortened + 1;
}

/* Steps that the search cuts short again and again are too long for the curvature that they know. */
static void restrain(mbs_stages_phase *p, int cut)
{
    const real first = p->regular > 0 ? p->regular : p->options->first_hessian_perturbation;
    p->cut = cut ? p->cut + 1 : 0;
    if (p->cut >= RESTRAINED_AFTER)
        p->restraint = p->restraint > 0 ? RESTRAINT_RISE * p->restraint : first;
    else if (!cut)
        p->restraint = p->restraint > RESTRAINT_LEAST ? p->restraint / RESTRAINT_FALL : 0;
}

/* Make a step of the length `alpha` to the trial. */
static int take(mbs_stages *s, mbs_stages_phase *p, const search *t, real alpha, int first, int refused)
{
    augment(p, t, alpha);
    accept(s, p, t, alpha);
    note_length(p, first);
    mind_refusals(p, refused);
    restrain(p, alpha < CUT_LENGTH * t->most);
    return 0;
}

/* The mean errors of stationarity, of rows and of complementarity, together. */
static real mean_errors(mbs_stages *s, mbs_stages_phase *p)
{
    real products = 0;
    int i, count = 0;
    mbs_stages_stationarity(s, p, 0, p->slope);
    for (i = 0; i < p->size; ++i) {
        if (s->fixed[i])
            continue;
        if (p->lower[i] > -MBS_STAGES_INFINITE)
            products += real_abs((p->x[i] - p->lower[i]) * p->zl[i] - p->mu), ++count;
        if (p->upper[i] < MBS_STAGES_INFINITE)
            products += real_abs((p->upper[i] - p->x[i]) * p->zu[i] - p->mu), ++count;
    }
    return mbs_stages_sum(p->size, p->slope) / (real)(p->size > 0 ? p->size : 1) +
           mbs_stages_sum(s->rows, p->c) / (real)(s->rows > 0 ? s->rows : 1) + products / (real)(count > 0 ? count : 1);
}

/* Add `alpha` times the step to all multipliers. */
static void move_multipliers(const mbs_stages *s, mbs_stages_phase *p, real alpha)
{
    int i;
    for (i = 0; i < s->rows; ++i)
        p->y[i] += alpha * p->step.y[i];
    for (i = 0; i < p->size; ++i) {
        p->zl[i] += alpha * p->step.zl[i];
        p->zu[i] += alpha * p->step.zu[i];
    }
}

/* Exchange the point and the trial. */
static void take_trial(mbs_stages_phase *p)
{
    real *x = p->x, *c = p->c;
    const real cost = p->cost;
    p->x = p->trial;
    p->trial = x;
    p->c = p->trial_c;
    p->trial_c = c;
    p->cost = p->trial_cost;
    p->trial_cost = cost;
}

/* Whether a point of violation theta may have errors of a part of those here. */
static int may_lower_errors(mbs_stages *s, mbs_stages_phase *p, real theta, real part)
{
    return theta <= part * mean_errors(s, p) * (real)s->rows;
}

/* Whether the trial, and multipliers that move with it, have errors of a part of those here; if so, they are the point. */
static int lowers_errors(mbs_stages *s, mbs_stages_phase *p, real alpha, real part)
{
    const real most = part * mean_errors(s, p);
    take_trial(p);
    move_multipliers(s, p, alpha);
    if (mbs_stages_phase_derivatives(s, p) == 0) {
        mbs_stages_find_lagrangian(s, p);
        if (mean_errors(s, p) <= most)
            return 1;
    }
    take_trial(p);
    move_multipliers(s, p, -alpha);
    if (mbs_stages_phase_derivatives(s, p) == 0)
        mbs_stages_find_lagrangian(s, p);
    return 0;
}

/* Make a whole step that lowers all errors, although the filter refuses it. Where curvature was added, errors may fall on
 * the way to a maximum. */
static int step_boldly(mbs_stages *s, mbs_stages_phase *p, search *t, real alpha)
{
    if (p->elastic || p->added > 0 || try_step(s, p, p->step.x, alpha, t) || !lowers_errors(s, p, alpha, BOLD_GAIN))
        return -1;
    augment(p, t, alpha);
    p->theta_before = p->theta;
    p->theta = t->theta;
    p->alpha = alpha;
    note_length(p, 1);
    restrain(p, 0);
    return 0;
}

/* Try shorter and shorter steps; `again`: the longest one was tried already. */
static int backtrack(mbs_stages *s, mbs_stages_phase *p, search *t, int again)
{
    const real most = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau), least = shortest(p, t);
    real alpha = again ? most / 2 : most, length;
    int first = 1, refused = 0;
    t->most = most;
    for (; alpha > least || first; alpha /= 2, first = 0) {
        const int failed = try_step(s, p, p->step.x, alpha, t), whole = first && !again;
        p->failing = failed;
        if (failed)
            continue;
        if (is_accepted(p, t, alpha))
            return take(s, p, t, alpha, whole, refused);
        refused |= first && t->filtered;
        if (whole && t->theta >= p->theta) {
            const real theta = t->theta;
            if (correct(s, p, t, alpha, &length) == 0)
                return take(s, p, t, length, 1, refused);
            if (may_lower_errors(s, p, theta, BOLD_GAIN) && step_boldly(s, p, t, alpha) == 0)
                return 0;
            if (s->options.follow && try_step(s, p, p->step.x, alpha, t))
                continue;
        }
        if (follow(s, p, t, alpha) == 0)
            return take(s, p, t, alpha, whole, refused);
    }
    return -1;
}

static void copy(int n, const real *from, real *to)
{
    memcpy(to, from, (size_t)n * sizeof *to);
}

static void copy_direction(int n, int m, const mbs_stages_direction *from, mbs_stages_direction *to)
{
    copy(n, from->x, to->x);
    copy(n, from->zl, to->zl);
    copy(n, from->zu, to->zu);
    copy(m, from->y, to->y);
}

/* Keep the point and its step for the watchdog. */
static void start_watching(const mbs_stages *s, mbs_stages_phase *p, real descent)
{
    mbs_stages_watchdog *w = &p->watchdog;
    copy(p->size, p->x, w->x);
    copy(p->size, p->zl, w->zl);
    copy(p->size, p->zu, w->zu);
    copy(s->rows, p->y, w->y);
    copy(s->rows, p->c, w->c);
    copy_direction(p->size, s->rows, &p->step, &w->step);
    w->cost = p->cost;
    w->theta = p->theta;
    w->phi = p->phi;
    w->descent = descent;
    w->alpha = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
    w->active = 1;
    w->trials = 0;
}

/* Go back to the point of the watchdog, and search from there with its step. */
static int go_back(mbs_stages *s, mbs_stages_phase *p)
{
    mbs_stages_watchdog *w = &p->watchdog;
    search t;
    copy(p->size, w->x, p->x);
    copy(p->size, w->zl, p->zl);
    copy(p->size, w->zu, p->zu);
    copy(s->rows, w->y, p->y);
    copy(s->rows, w->c, p->c);
    copy_direction(p->size, s->rows, &w->step, &p->step);
    p->cost = w->cost;
    p->theta = w->theta;
    p->phi = w->phi;
    w->active = w->shortened = 0;
    t.filtered = 0;
    t.descent = w->descent;
    return backtrack(s, p, &t, 1);
}

/* Make the longest step. It must be better than the watchdog's point, or a later one must. */
static int step_unseen(mbs_stages *s, mbs_stages_phase *p, search *t)
{
    mbs_stages_watchdog *w = &p->watchdog;
    const real alpha = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
    const int failed = try_step(s, p, p->step.x, alpha, t);
    p->theta = w->theta;
    p->phi = w->phi;
    t->descent = w->descent;
    if (!failed && is_accepted(p, t, w->alpha)) {
        augment(p, t, w->alpha);
        w->active = w->shortened = 0;
    } else if (failed || ++w->trials > p->options->watchdog_trial_iter_max) {
        return go_back(s, p);
    }
    accept(s, p, t, alpha);
    return 0;
}

int mbs_stages_search_softly(mbs_stages *s, mbs_stages_phase *p)
{
    const real primal = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
    const real dual = mbs_stages_dual_boundary(s, p, &p->step), alpha = primal < dual ? primal : dual;
    search t;
    t.descent = 0;
    if (p->elastic || p->soft >= p->options->max_soft_resto_iters || try_step(s, p, p->step.x, alpha, &t))
        return -1;
    if (p->soft == 0)
        mbs_stages_filter_add(&p->filter, (1 - p->options->gamma_theta) * p->theta, p->phi - p->options->gamma_phi * p->theta);
    if (is_accepted(p, &t, 0)) {
        take_trial(p);
        move_multipliers(s, p, alpha);
        p->soft = 0;
    } else if (lowers_errors(s, p, alpha, p->options->soft_resto_pderror_reduction_factor)) {
        ++p->soft;
    } else {
        return -1;
    }
    p->alpha = alpha;
    return 0;
}

void mbs_stages_search_anew(mbs_stages_phase *p)
{
    p->watchdog.active = p->watchdog.shortened = p->soft = 0;
}

int mbs_stages_search_without_step(mbs_stages *s, mbs_stages_phase *p)
{
    return p->watchdog.active ? go_back(s, p) : -1;
}

int mbs_stages_search(mbs_stages *s, mbs_stages_phase *p)
{
    search t;
    t.filtered = 0;
    t.descent = mbs_stages_descent(s, p, p->step.x);
    p->tiny_before = p->tiny;
    p->tiny = is_tiny(s, p);
    if (p->tiny && p->watchdog.active) {
        p->tiny = 0;
        return go_back(s, p);
    }
    if (p->tiny) {
        const real alpha = mbs_stages_boundary(s, p, p->x, p->step.x, p->tau);
        if (try_step(s, p, p->step.x, alpha, &t))
            return -1;
        accept(s, p, &t, alpha);
        return 0;
    }
    if (p->soft > 0)
        return mbs_stages_search_softly(s, p);
    if (!p->elastic && !p->watchdog.active && p->watchdog.shortened >= p->options->watchdog_shortened_iter_trigger)
        start_watching(s, p, t.descent);
    return p->watchdog.active ? step_unseen(s, p, &t) : backtrack(s, p, &t, 0);
}

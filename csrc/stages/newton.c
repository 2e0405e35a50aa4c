/* Newton's step of the barrier problem.
 *
 * Hard rows that v of their stage cannot meet are met by earlier stages, at once and at any price. Many such rows at
 * the end of a horizon need so high a price that digits are lost. Then hard rows are softened in the factorisation:
 * they get a small compliance, which refinement takes back (Bertsekas: Constrained optimization and Lagrange multiplier
 * methods, 1982, the method of multipliers). Where that does not converge, they get more of it; at last rows are hard
 * again.
 *
 * Near a solution, rows of g that bind hardly give: they have slacks near their bounds, whose curvature takes the digits of
 * the rows' stage. Where a step has no digits, such rows are exact in the factorisation; refinement gives them back what
 * they give. Exact rows that follow from others are left out: where there are more of these, or it does not converge, rows
 * give again.
 *
 * Slacks and elastic variables appear in one row each. They are eliminated: their curvature becomes the compliance of
 * that row, and the recursion solves for w and y. Where the reduced Hessian is not positive definite, a multiple of the
 * identity is added to the curvature of variables (Waechter, Biegler, 2006, algorithm IC). Inner variables follow the
 * others and get none, so what is condensed stays, and a further try costs no more than the recursion. Where their
 * equations do not determine them, or hardly do, small changes of the others move them far, and they get it too. */
#include "condense.h"
#include "solver.h"

#include <string.h>

static void find_sigma(const mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        p->sigma[i] = 0;
        if (s->fixed[i])
            continue;
        if (mbs_stages_has(p->lower[i]))
            p->sigma[i] += p->zl[i] / (p->x[i] - p->lower[i]);
        if (mbs_stages_has(p->upper[i]))
            p->sigma[i] += p->zu[i] / (p->upper[i] - p->x[i]);
    }
}

static void add_to(real *a, int from, int n, real b)
{
    int i;
    for (i = from; i < from + n; ++i)
        a[i] += b;
}

/* Add curvature to stages from `first` on: to the recursion's variables, to slacks, to elastic variables; by `inner` to
 * inner ones too. */
static void add_curvature(mbs_stages *s, mbs_stages_phase *p, int first, real regular, int inner)
{
    const int at = s->variables, plus = at + s->slacks, minus = plus + s->rows;
    int k;
    for (k = 0; k < s->problem->stages; ++k) {
        mbs_stages_stage *t = &s->recursion.stage[k];
        const int rows = t->g + t->ng - t->e;
        t->curvature = k < first ? 0 : regular;
        add_to(p->sigma, t->w + t->nx, inner ? t->inner.n : 0, t->curvature);
        add_to(p->sigma, at + t->s, t->ng, t->curvature);
        if (p->elastic) {
            add_to(p->sigma, plus + t->e, rows, t->curvature);
            add_to(p->sigma, minus + t->e, rows, t->curvature);
        }
    }
}

/* How far variable i yields to a force of 1. The slack of a row without bounds yields freely. */
static real yield(const mbs_stages *s, const mbs_stages_phase *p, int i)
{
    if (s->fixed[i])
        return 0;
    return p->sigma[i] > 0 ? 1 / p->sigma[i] : FREE_COMPLIANCE;
}

static void find_compliance(mbs_stages *s, const mbs_stages_phase *p)
{
    const int at = s->variables, plus = at + s->slacks, minus = plus + s->rows;
    real *compliance = s->recursion.compliance;
    int k, i;
    memset(s->softened, 0, (size_t)s->rows);
    for (i = 0; i < s->rows; ++i)
        compliance[i] = p->elastic ? yield(s, p, plus + i) + yield(s, p, minus + i) : 0;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i)
            compliance[t->g + i] += yield(s, p, at + t->s + i);
    }
    if (MBS_STAGES_SEARCHES)
        memcpy(s->gives, compliance, (size_t)s->rows * sizeof *compliance);
}

/* The diagonal beside the Hessian: of the barrier, and in restoration of the distance from the reference. */
static void find_diagonal(mbs_stages *s, const mbs_stages_phase *p)
{
    real *diagonal = s->recursion.diagonal;
    int i;
    memcpy(diagonal, p->sigma, (size_t)s->variables * sizeof *diagonal);
    for (i = 0; p->elastic && i < s->variables; ++i)
        diagonal[i] += s->weight_factor * s->weight[i] * s->weight[i];
}

/* The largest entry of a diagonal of the Hessian, at least 1. */
static real largest_curvature(const mbs_stages_recursion *r)
{
    real curvature = 1;
    int k;
    for (k = 0; k < r->stages; ++k) {
        const real most = mbs_stages_matrix_diagonal(&r->stage[k].H);
        curvature = most > curvature ? most : curvature;
    }
    return curvature;
}

/* Let hard rows give. */
static void soften_rows(mbs_stages *s)
{
    mbs_stages_recursion *r = &s->recursion;
    const real curvature = r->plain ? 1 : largest_curvature(r);
    int k, i, count = 0;
    for (k = 0; k < r->stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        for (i = t->e + t->inner.n; i < t->g + t->ng; ++i)
            if ((i < t->d || i >= t->g) && !(r->compliance[i] > 0)) {
                r->compliance[i] = (s->softer ? MBS_STAGES_SOFTER : MBS_STAGES_SOFT) / curvature;
                s->softened[i] = 1;
                ++count;
            }
    }
    if (count == 0)
        s->softening = MBS_STAGES_HARD_FOR_GOOD;
}

/* Take rows of g that hardly give as exact. */
static void harden_rows(mbs_stages *s)
{
    mbs_stages_recursion *r = &s->recursion;
    const real least = MBS_STAGES_EXACT / largest_curvature(r);
    int k, i;
    for (k = 0; k < r->stages; ++k)
        for (i = r->stage[k].g; i < r->stage[k].g + r->stage[k].ng; ++i)
            if (r->compliance[i] < least)
                r->compliance[i] = 0;
}

/* Factorise with added curvature in stages from `first` on, by `inner` of all variables; returns -1, or the stage that
 * lacks curvature. */
static int factorise_with(mbs_stages *s, mbs_stages_phase *p, int first, real regular, int inner)
{
    int k;
    find_sigma(s, p);
    add_curvature(s, p, first, regular, inner);
    find_diagonal(s, p);
    find_compliance(s, p);
    s->recursion.plain = 0;
    if (MBS_STAGES_SEARCHES && s->softening == MBS_STAGES_SOFTENED && !p->elastic)
        soften_rows(s);
    if (MBS_STAGES_SEARCHES && s->exact && !p->elastic)
        harden_rows(s);
    s->recursion.soft_dynamics = p->elastic;
    ++s->result.factorisations;
    k = mbs_stages_factorise(&s->recursion, regular > 0 && !inner);
    if (k < 0 || !mbs_stages_mind_growth(&s->recursion, k))
        return k;
    ++s->result.factorisations;
    return mbs_stages_factorise(&s->recursion, 0);
}

static real first_curvature(const mbs_stages_options *o, real before)
{
    return before == 0 ? o->first_hessian_perturbation : mbs_stages_larger(before / 3, o->min_hessian_perturbation);
}

/* Let rows be soft where more curvature than there is anywhere does not make hard ones convex: they take all digits. */
static int softens(mbs_stages *s, const mbs_stages_phase *p, real regular)
{
    if (!MBS_STAGES_SEARCHES || p->elastic || s->softening != MBS_STAGES_HARD)
        return 0;
    if (!(regular > largest_curvature(&s->recursion)))
        return 0;
    s->softening = MBS_STAGES_SOFTENED;
    return 1;
}

/* Factorise, with as little added curvature as convexity needs; returns -1 if no amount is enough.
 *
 * A stage lacks curvature because of itself and of later stages. The option `by_stage` adds it to these alone. */
int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p)
{
    const real before = p->regular;
    int first = p->restraint > 0 ? 0 : s->problem->stages, k;
    real regular = p->restraint;
    int inner = p->cautious || s->result.singular > 0;
    while ((k = factorise_with(s, p, first, regular, inner)) >= 0) {
        inner |= s->recursion.singular > 0; /* and stays so: what is condensed has the curvature of the last try */
        if (softens(s, p, regular)) {
            regular = 0;
            first = s->problem->stages;
            continue;
        }
        if (regular == 0)
            regular = first_curvature(&s->options, before);
        else if (k >= first)
            regular *= before == 0 ? s->options.perturb_inc_fact_first : s->options.perturb_inc_fact;
        k = s->options.by_stage ? k : 0;
        first = k < first ? k : first;
        if (!(regular < s->options.max_hessian_perturbation))
            return -1;
    }
    s->result.dependent = s->recursion.dependent;
    s->result.singular = s->recursion.singular;
    if (regular > 0)
        p->regular = regular;
    p->added = regular;
    return 0;
}

/* Right-hand sides of the reduced system, for rows c. */
static void reduce_right(mbs_stages *s, const mbs_stages_phase *p, const real *c)
{
    const int at = s->variables, plus = at + s->slacks, minus = plus + s->rows;
    int k, i;
    memcpy(s->rw, p->slope, (size_t)s->variables * sizeof *s->rw);
    memcpy(s->rc, c, (size_t)s->rows * sizeof *s->rc);
    for (i = 0; p->elastic && i < s->rows; ++i)
        s->rc[i] += p->slope[plus + i] * yield(s, p, plus + i) -
                    p->slope[minus + i] * yield(s, p, minus + i);
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i)
            s->rc[t->g + i] += p->slope[at + t->s + i] * yield(s, p, at + t->s + i);
    }
}

/* Residuals of the reduced system in stage k, of opposite sign: what a correction must solve for. */
static void find_stage_residual(mbs_stages *s, int k)
{
    const mbs_stages_recursion *r = &s->recursion;
    const mbs_stages_stage *t = &r->stage[k];
    const int w = t->w + t->n, rows = t->g + t->ng;
    int i;
    memcpy(s->residual_w + t->w, s->rw + t->w, (size_t)t->n * sizeof *s->rw);
    memcpy(s->residual_c + t->e, s->rc + t->e, (size_t)(rows - t->e) * sizeof *s->rc);
    if (!r->plain)
        mbs_stages_matrix_apply_symmetric(&t->H, s->dw + t->w, s->residual_w + t->w);
    mbs_stages_add_stage_both(r, k, s->dw, s->residual_c, s->dy, s->residual_w);
    mbs_stages_apply_curvature(t, s->dw + t->w, s->residual_w + t->w);
    for (i = t->w; i < w; ++i)
        s->residual_w[i] = s->fixed[i] ? 0 : s->residual_w[i] + r->diagonal[i] * s->dw[i];
    for (i = t->e; i < rows; ++i)
        s->residual_c[i] -= s->softened[i] ? 0 : s->gives[i] * s->dy[i];
}

static void find_residuals(void *solver, int from, int to, int worker)
{
    int k;
    (void)worker;
    for (k = from; k < to; ++k)
        find_stage_residual(solver, k);
}

/* Largest residuals of the gradient and of rows, these beside the compliance, if that is large: such a row is an
 * equation of its multiplier. */
typedef struct {
    real w, c;
} residuals;

static residuals measure(const mbs_stages *s, const real *w, const real *c)
{
    residuals most;
    int i;
    most.w = mbs_stages_largest(s->variables, w);
    most.c = 0;
    for (i = 0; i < s->rows; ++i) {
        const real give = s->gives[i];
        const real a = real_abs(c[i]) / (give > 1 ? give : 1);
        most.c = a > most.c ? a : most.c;
    }
    return most;
}

/* Residuals over their limits: a share of the right-hand sides, little beside the tolerance of a solution, or the
 * rounding of numbers as large as the solution. Multipliers can be a million times the right-hand sides. */
static real rate(const mbs_stages *s, residuals error, residuals right, real share)
{
    const real least = s->options.tol * REFINED_SHARE;
    const real w = mbs_stages_larger(least, SUM_ROUNDING * mbs_stages_largest(s->rows, s->dy));
    const real c = mbs_stages_larger(least, SUM_ROUNDING * mbs_stages_largest(s->variables, s->dw));
    return mbs_stages_larger(error.w / mbs_stages_larger(share * right.w, w), error.c / mbs_stages_larger(share * right.c, c));
}

static void add(int n, const real *a, real *b)
{
    int i;
    for (i = 0; i < n; ++i)
        b[i] += a[i];
}

/* Solve the reduced system, and refine while that helps. Returns how often, or -1 where the residual stays large. */
static int solve_reduced(mbs_stages *s)
{
    const residuals right = measure(s, s->rw, s->rc);
    real last = MBS_STAGES_LARGEST;
    int i;
    memset(s->best_w, 0, (size_t)s->variables * sizeof *s->best_w);
    memset(s->best_y, 0, (size_t)s->rows * sizeof *s->best_y);
    mbs_stages_sweep(&s->recursion, s->rw, s->rc, s->dw, s->dy);
    s->left = s->recursion.left;
    for (i = 0;; ++i) {
        real error;
        mbs_stages_for_all(&s->recursion, find_residuals, s);
        error = rate(s, measure(s, s->residual_w, s->residual_c), right, MBS_STAGES_REFINED);
        if (!(error < last) && i > 0)
            break;
        memcpy(s->best_w, s->dw, (size_t)s->variables * sizeof *s->dw);
        memcpy(s->best_y, s->dy, (size_t)s->rows * sizeof *s->dy);
        if (error <= 1)
            return i;
        if (error > last / 2 || i == s->options.max_refinement_steps)
            break;
        last = error;
        ++s->result.refinements;
        mbs_stages_sweep(&s->recursion, s->residual_w, s->residual_c, s->dw, s->dy);
        add(s->variables, s->best_w, s->dw);
        add(s->rows, s->best_y, s->dy);
    }
    return -1;
}

/* Newton's step of z for the step of x. */
void mbs_stages_bound_steps(const mbs_stages *s, const mbs_stages_phase *p, mbs_stages_direction *d)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const real below = p->x[i] - p->lower[i], above = p->upper[i] - p->x[i];
        const int fixed = s->fixed[i];
        d->zl[i] = !fixed && mbs_stages_has(p->lower[i]) ? (p->mu - p->zl[i] * d->x[i]) / below - p->zl[i] : 0;
        d->zu[i] = !fixed && mbs_stages_has(p->upper[i]) ? (p->mu + p->zu[i] * d->x[i]) / above - p->zu[i] : 0;
    }
}

/* The step of slacks, of elastic variables and of all bounds' multipliers, from the step of variables and rows. */
void mbs_stages_spread(const mbs_stages *s, const mbs_stages_phase *p, mbs_stages_direction *d)
{
    const int at = s->variables, plus = at + s->slacks, minus = plus + s->rows;
    int k, i;
    for (k = 0; k < s->problem->stages; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        for (i = 0; i < t->ng; ++i)
            d->x[at + t->s + i] =
                (d->y[t->g + i] - p->slope[at + t->s + i]) * yield(s, p, at + t->s + i);
    }
    for (i = 0; p->elastic && i < s->rows; ++i) {
        d->x[plus + i] = (d->y[i] - p->slope[plus + i]) * yield(s, p, plus + i);
        d->x[minus + i] = (-d->y[i] - p->slope[minus + i]) * yield(s, p, minus + i);
    }
    mbs_stages_bound_steps(s, p, d);
}

static int solve_again(mbs_stages *s, mbs_stages_phase *p, const real *c)
{
    if (mbs_stages_newton_factorise(s, p))
        return -1;
    reduce_right(s, p, c);
    return solve_reduced(s);
}

/* Solve with hard rows or soft ones, whichever keeps digits. */
static int solve_well(mbs_stages *s, mbs_stages_phase *p, const real *c)
{
    int passes = solve_reduced(s);
    if (MBS_STAGES_SEARCHES)
        s->recursion.lost = passes < 0;
    if ((passes < 0 || passes >= MANY_REFINEMENTS) && mbs_stages_mind_growth(&s->recursion, 0))
        passes = solve_again(s, p, c);
    if (!MBS_STAGES_SEARCHES || p->elastic)
        return passes;
    if (s->softening == MBS_STAGES_HARD && (passes < 0 || passes >= MANY_REFINEMENTS)) {
        s->softening = MBS_STAGES_SOFTENED;
        passes = passes < 0 ? solve_again(s, p, c) : passes;
    }
    if (s->softening == MBS_STAGES_SOFTENED && passes < 0 && !s->softer) {
        s->softer = 1;
        passes = solve_again(s, p, c);
    }
    if (s->softening == MBS_STAGES_SOFTENED && passes < 0) {
        s->softening = MBS_STAGES_HARD_FOR_GOOD;
        passes = solve_again(s, p, c);
    }
    return passes;
}

/* Let rows that hardly give be exact, or give again, whichever keeps digits; where neither does, they give. Exact rows that
 * follow from others have no multipliers. */
static void solve_otherwise(mbs_stages *s, mbs_stages_phase *p, const real *c)
{
    const int dependent = s->recursion.dependent;
    s->exact = !s->exact;
    if (solve_again(s, p, c) >= 0 && !(s->exact && s->recursion.dependent > dependent))
        return;
    ++s->unhelped;
    if (!s->exact)
        return;
    s->exact = 0;
    solve_again(s, p, c);
}

/* The step for rows c. `slope` holds the derivatives with the barrier's. */
void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    reduce_right(s, p, c);
    if (solve_well(s, p, c) < 0 && MBS_STAGES_SEARCHES && !p->elastic && s->unhelped < MOST_UNHELPED)
        solve_otherwise(s, p, c);
    memcpy(d->x, s->best_w, (size_t)s->variables * sizeof *d->x);
    memcpy(d->y, s->best_y, (size_t)s->rows * sizeof *d->y);
    mbs_stages_spread(s, p, d);
}

/* The same with soft rows. They stay soft in the first step, if that helps. */
static int estimate_softly(mbs_stages *s)
{
    s->softening = MBS_STAGES_SOFTENED;
    soften_rows(s);
    if (mbs_stages_factorise(&s->recursion, 1) < 0 && solve_reduced(s) >= 0)
        return 0;
    s->softening = MBS_STAGES_HARD;
    return -1;
}

/* Multipliers of least squares: they make the derivatives of the Lagrangian smallest. */
void mbs_stages_estimate_multipliers(mbs_stages *s, mbs_stages_phase *p)
{
    mbs_stages_recursion *r = &s->recursion;
    int i, factorised;
    memset(p->y, 0, (size_t)s->rows * sizeof *p->y);
    mbs_stages_find_lagrangian(s, p);
    mbs_stages_stationarity(s, p, 0, p->slope);
    for (i = 0; i < p->size; ++i)
        p->sigma[i] = s->fixed[i] ? 0 : 1;
    for (i = 0; i < s->variables; ++i)
        r->diagonal[i] = 1;
    for (i = 0; i < r->stages; ++i)
        r->stage[i].curvature = 0;
    find_compliance(s, p);
    r->plain = 1;
    r->soft_dynamics = p->elastic;
    p->added = 0;
    memset(p->trial_c, 0, (size_t)s->rows * sizeof *p->trial_c);
    reduce_right(s, p, p->trial_c);
    factorised = mbs_stages_factorise(r, 0) < 0;
    if (!(factorised && solve_reduced(s) >= 0) && !p->elastic && s->softening == MBS_STAGES_HARD)
        factorised |= estimate_softly(s) == 0;
    if (factorised && mbs_stages_largest(s->rows, s->best_y) <= 1000)
        memcpy(p->y, s->best_y, (size_t)s->rows * sizeof *p->y);
    r->plain = 0;
}

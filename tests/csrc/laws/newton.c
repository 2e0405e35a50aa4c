#include "laws.h"

#include "../../../csrc/stages/newton.c"

/* Stand-ins: residuals of a step, one after the other. */
static struct {
    const real *errors; /* of the first sweep, the second, ... */
    real most;
    int sweeps, dependent; /* rows that follow from others, of a factorisation */
    real needed; /* curvature that makes the second stage convex */
    int tries;
    int is_plain; /* whether all variables count alike when the matrix is factorised */
    real unit;    /* a step's multiplier */
    int lacking;  /* the stage that lacks curvature */
    int minded;   /* how often growth was looked at */
} given;

int mbs_stages_factorise(mbs_stages_recursion *r, int careful)
{
    (void)careful;
    ++given.tries;
    r->dependent = given.dependent;
    given.is_plain = r->plain && r->diagonal && r->diagonal[0] == 1 && r->diagonal[1] == 1 && r->stage[0].curvature == 0;
    return r->stage[1].curvature < given.needed ? given.lacking : -1;
}

int mbs_stages_mind_growth(mbs_stages_recursion *r, int stage)
{
    (void)r, (void)stage;
    ++given.minded;
    return 0;
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p;
    out[0] = barrier ? 5 : 3, out[1] = 4;
}

void mbs_stages_sweep(mbs_stages_recursion *r, const real *w, const real *c, real *dw, real *dy)
{
    (void)r, (void)w, (void)c;
    ++given.sweeps;
    dw[0] = given.sweeps, dy[0] = given.unit * given.sweeps;
}

void mbs_stages_for_all(const mbs_stages_recursion *r, mbs_stages_task task, void *data)
{
    mbs_stages *s = data;
    (void)r, (void)task;
    s->residual_w[0] = given.errors[given.sweeps - 1];
    s->residual_c[0] = 0;
}

real mbs_stages_matrix_diagonal(const mbs_stages_matrix *m)
{
    return given.most * (real)m->rows;
}

static real room[13][2];
static char marks[2][2];
static const mbs_stages_problem none;
static mbs_stages solver;
static mbs_stages_stage stages[2];
static mbs_stages_phase phase;

static void anew(mbs_stages *s)
{
    memset(s, 0, sizeof *s);
    memset(room, 0, sizeof room);
    memset(stages, 0, sizeof stages);
    memset(&phase, 0, sizeof phase);
    s->options = mbs_stages_default_options();
    phase.options = &s->options;
    s->recursion.stage = stages, s->recursion.stages = 2;
    s->rw = room[0], s->rc = room[1], s->dw = room[2], s->dy = room[3], s->residual_w = room[4];
    s->residual_c = room[5], s->best_w = room[6], s->best_y = room[7];
    s->recursion.compliance = room[8], s->gives = room[12];
    s->recursion.diagonal = room[10], phase.sigma = room[11], phase.slope = room[0];
    s->softened = marks[0], s->fixed = marks[1], s->problem = &none;
    s->variables = s->rows = 1;
    s->rw[0] = s->rc[0] = 1;
    given.sweeps = given.dependent = 0, given.needed = 0, given.unit = 10, given.lacking = 1;
}

static void refining(void)
{
    const real good[] = {0.1 * MBS_STAGES_REFINED}, falling[] = {1, 0.4, 0.1, 0.04, 0.1 * MBS_STAGES_REFINED};
    const real slow[] = {1, 0.6, 0.1 * MBS_STAGES_REFINED}, worse[] = {1, 2};
    mbs_stages *s = &solver;
    anew(s);
    given.errors = good;
    LAW("a good step is not refined", solve_reduced(s) == 0 && given.sweeps == 1 && s->best_w[0] == 1);
    anew(s);
    given.errors = falling, s->best_w[1] = s->best_y[1] = 5;
    LAW("refinements go on while they halve the residual", solve_reduced(s) == 4 && s->result.refinements == 4);
    LAW("of the numbers that there are", s->dw[1] == 0 && s->dy[1] == 0);
    LAW("and add up", s->best_w[0] == 1 + 2 + 3 + 4 + 5 && s->best_y[0] == 150);
    anew(s);
    given.errors = slow;
    LAW("and no longer", solve_reduced(s) == -1 && given.sweeps == 2);
    LAW("the better step stays", s->best_w[0] == 1 + 2);
    anew(s);
    given.errors = worse;
    LAW("a worse one is left", solve_reduced(s) == -1 && s->best_w[0] == 1 && s->best_y[0] == 10);
}

/* Residuals of rows that give much are equations of their multipliers. */
static void measuring(void)
{
    const real w[2] = {-5, 2}, c[2] = {3, -8}, d[2] = {1, -8};
    mbs_stages *s = &solver;
    anew(s);
    s->variables = s->rows = 2, s->gives[0] = (real)0.5, s->gives[1] = 4;
    LAW("the largest residual of each kind", measure(s, w, c).w == 5 && measure(s, w, c).c == 3);
    LAW("beside the compliance, if that is large", measure(s, w, d).c == 2);
    s->gives[1] = (real)0.25;
    LAW("or as it is", measure(s, w, d).c == 8);
    {
        const residuals none = {0, 0}, limit = {s->options.tol * REFINED_SHARE, 0}, other = {0, limit.w}, right = {2, 4};
        s->dy[0] = s->dy[1] = s->dw[0] = s->dw[1] = 0;
        LAW("a part of the tolerance is enough", near(rate(s, limit, none, 1), 1) && near(rate(s, other, none, 1), 1));
        LAW("or a share of the right-hand sides", near(rate(s, right, right, 0.5), 2));
        s->dy[1] = -3e9, s->dw[0] = 5e9;
        LAW("or the rounding of multipliers", near(rate(s, (residuals){1e-3, 0}, none, 1), 1e-3 / (SUM_ROUNDING * 3e9)));
        LAW("and of variables", near(rate(s, (residuals){0, 1e-3}, none, 1), 1e-3 / (SUM_ROUNDING * 5e9)));
    }
}

static void softening(void)
{
    mbs_stages *s = &solver;
    anew(s);
    stages[0].H.rows = 1, stages[1].H.rows = 3, given.most = 2;
    LAW("the largest curvature of all stages", largest_curvature(&s->recursion) == 6);
    stages[0].H.rows = 4;
    LAW("wherever it is", largest_curvature(&s->recursion) == 8);
    given.most = 0.1;
    LAW("is 1 at least", largest_curvature(&s->recursion) == 1);
    LAW("as much added curvature as there is softens nothing", !softens(s, &phase, 1));
    phase.elastic = 1;
    LAW("nor is restoration softened", !softens(s, &phase, 1.1));
    phase.elastic = 0;
    LAW("more does", softens(s, &phase, 1.1) && s->softening == MBS_STAGES_SOFTENED);
    LAW("once", !softens(s, &phase, 1.1));
    s->softening = MBS_STAGES_HARD_FOR_GOOD;
    LAW("or never", !softens(s, &phase, 1.1));
    LAW("curvature begins at a third of the last one", near(first_curvature(&s->options, 9), 3));
    s->options.first_hessian_perturbation = 5, s->options.min_hessian_perturbation = 2;
    LAW("and where there was none, as the options say", first_curvature(&s->options, 0) == 5);
    LAW("at the least one", first_curvature(&s->options, 3) == 2);
}

static void hardening(void)
{
    const real little = MBS_STAGES_EXACT / 8;
    mbs_stages *s = &solver;
    anew(s);
    stages[0].H.rows = 4, given.most = 2;
    stages[0].g = 0, stages[0].ng = 1, stages[1].g = 1, stages[1].ng = 1;
    s->recursion.compliance[0] = 0.9 * little, s->recursion.compliance[1] = 1.1 * little;
    harden_rows(s);
    LAW("a row that hardly gives is exact", s->recursion.compliance[0] == 0);
    LAW("beside the curvature", s->recursion.compliance[1] == 1.1 * little);
    stages[0].g = 1, stages[0].ng = 0, s->recursion.compliance[0] = 0.9 * little;
    harden_rows(s);
    LAW("other rows stay as they are", s->recursion.compliance[0] == 0.9 * little);
}

/* Each of two equal residuals ends a solution without digits. */
static void giving(void)
{
    const real bad[] = {1, 1, 1, 1, 1, 1, 1, 1}, soft[] = {1, 1, 0}, softer[] = {1, 1, 1, 1, 0};
    const real *const errors[] = {soft, softer, bad};
    mbs_stages *s = &solver;
    real zeros[1] = {0};
    int i;
    for (i = 0; i < 3; ++i) {
        anew(s);
        stages[0].d = stages[0].g = stages[1].e = stages[1].d = stages[1].g = 1, given.most = 0.1;
        given.errors = errors[i];
        LAW("hard rows without digits give, and then give more", solve_well(s, &phase, zeros) == (i < 2 ? 0 : -1));
        LAW("as little as has digits", s->softer == (i > 0));
        LAW("else they are hard for good", s->softening == (i < 2 ? MBS_STAGES_SOFTENED : MBS_STAGES_HARD_FOR_GOOD));
        if (i < 2)
            LAW("beside the curvature", near(s->recursion.compliance[0], i ? MBS_STAGES_SOFTER : MBS_STAGES_SOFT));
    }
}

/* Refinements that are many, or do not end, show a loss of digits. */
static void losing(void)
{
    const real once[] = {1, 0}, twice[] = {1, 0.4, 0}, never[] = {1, 1, 1, 1, 1, 1, 1, 1};
    const real *const errors[] = {once, twice, never};
    mbs_stages *s = &solver;
    real zeros[1] = {0};
    int i;
    for (i = 0; i < 3; ++i) {
        anew(s);
        phase.elastic = 1;
        given.errors = errors[i], given.minded = 0;
        LAW("a solution tells its refinements", solve_well(s, &phase, zeros) == (i < 2 ? i + 1 : -1));
        LAW("two of them let growth be looked at", given.minded == (i > 0));
        LAW("digits are lost where it does not end", s->recursion.lost == (i == 2));
    }
    anew(s);
    stages[0].d = stages[0].g = stages[1].e = stages[1].d = stages[1].g = 1, given.errors = twice;
    LAW("hard rows give later, after many refinements", solve_well(s, &phase, zeros) == 2 && s->softening == MBS_STAGES_SOFTENED);
    anew(s);
    stages[0].d = stages[0].g = stages[1].e = stages[1].d = stages[1].g = 1, given.errors = once;
    LAW("and not after few", solve_well(s, &phase, zeros) == 1 && s->softening == MBS_STAGES_HARD);
}

static void choosing(void)
{
    const real good[] = {1, 1, 0, 0}, bad[] = {1, 1, 1, 1, 1, 1, 1, 1};
    mbs_stages *s = &solver;
    real zeros[1] = {0};
    anew(s);
    given.errors = good, given.sweeps = 2;
    solve_otherwise(s, &phase, zeros);
    LAW("rows that hardly give are exact, where that has digits", s->exact == 1 && s->unhelped == 0);
    given.sweeps = 2;
    solve_otherwise(s, &phase, zeros);
    LAW("and give again, where that has", s->exact == 0 && s->unhelped == 0);
    given.sweeps = 2, given.dependent = 1;
    solve_otherwise(s, &phase, zeros);
    LAW("rows that follow from others need not be exact", s->exact == 0 && s->unhelped == 1);
    s->unhelped = given.dependent = 0;
    given.errors = bad, given.sweeps = 0;
    solve_otherwise(s, &phase, zeros);
    LAW("where neither has, they give", s->exact == 0 && s->unhelped == 1);
    s->exact = 1, given.sweeps = 0;
    solve_otherwise(s, &phase, zeros);
    LAW("and that is counted", s->exact == 0 && s->unhelped == 2);
}

static void stepping(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    real zl[1] = {3}, zu[1] = {4}, dx[1] = {0.5}, dzl[1], dzu[1], lower[1] = {1}, upper[1] = {6}, x[1] = {3}, sigma[1] = {5};
    char fixed[1] = {0};
    mbs_stages_direction d = {dx, dzl, dzu, 0};
    anew(s);
    p->size = 1, p->x = x, p->lower = lower, p->upper = upper, p->zl = zl, p->zu = zu, p->mu = 0.25, p->sigma = sigma;
    s->fixed = fixed;
    mbs_stages_bound_steps(s, p, &d);
    LAW("products come to mu below", near((zl[0] + dzl[0]) * 2 + zl[0] * 0.5, 0.25));
    LAW("and above", near((zu[0] + dzu[0]) * 3 - zu[0] * 0.5, 0.25));
    LAW("a variable yields by the barrier's curvature", near(yield(s, p, 0), 0.2));
    sigma[0] = 0;
    LAW("freely without bounds", yield(s, p, 0) == FREE_COMPLIANCE);
    lower[0] = -1e20, upper[0] = 1e20;
    mbs_stages_bound_steps(s, p, &d);
    LAW("no bound, no step", dzl[0] == 0 && dzu[0] == 0);
    lower[0] = 1, upper[0] = 6, fixed[0] = 1;
    mbs_stages_bound_steps(s, p, &d);
    LAW("nor of a fixed one", dzl[0] == 0 && dzu[0] == 0 && yield(s, p, 0) == 0);
}

static int curve(mbs_stages *s, real needed)
{
    given.needed = needed, given.tries = 0;
    return mbs_stages_newton_factorise(s, &phase);
}

static void curving(void)
{
    mbs_stages *s = &solver;
    mbs_stages_problem problem;
    memset(&problem, 0, sizeof problem);
    anew(s);
    problem.stages = 2, s->problem = &problem, s->variables = s->rows = 0, s->softening = MBS_STAGES_HARD_FOR_GOOD;
    LAW("what is convex gets no curvature", !curve(s, 0) && given.tries == 1 && phase.added == 0 && phase.regular == 0);
    LAW("curvature grows by 100 from the first", !curve(s, (real)0.005) && given.tries == 3 && near(phase.added, 0.01));
    LAW("and is remembered", near(phase.regular, 0.01));
    LAW("the next begins at a third of it, and grows by 6", !curve(s, (real)0.005) && near(phase.added, 0.02));
    LAW("none is tried first", given.tries == 3);
    LAW("where none is needed, the last one is remembered", !curve(s, 0) && phase.added == 0 && near(phase.regular, 0.02));
    s->options.max_hessian_perturbation = 1;
    LAW("there is a largest one", curve(s, 2) == -1 && near(phase.regular, 0.02));
}

static void estimating(void)
{
    const real good[] = {0.1 * MBS_STAGES_REFINED}, soft[] = {1, 1, 0}, refined[] = {1, 1, 1, 0}, bad[] = {1, 1, 1, 1};
    const real *const softly[] = {soft, refined, bad};
    mbs_stages *s = &solver;
    mbs_stages_phase *p = &phase;
    mbs_stages_problem problem;
    int i;
    real sigma[2] = {9, 9}, slope[2], trial_c[1] = {9}, y[1] = {9};
    char fixed[2] = {0, 1}, softened[1] = {1};
    memset(&problem, 0, sizeof problem);
    anew(s);
    problem.stages = 2, s->problem = &problem, s->variables = 2, s->fixed = fixed, s->softened = softened;
    s->recursion.diagonal = room[9], room[9][0] = room[9][1] = 7, stages[0].curvature = stages[1].curvature = 7;
    p->size = 2, p->sigma = sigma, p->slope = slope, p->trial_c = trial_c, p->y = y;
    given.errors = good, given.needed = 0;
    mbs_stages_estimate_multipliers(s, p);
    LAW("least squares count all variables alike", given.is_plain && sigma[0] == 1 && sigma[1] == 0);
    LAW("they make the cost's slope smallest", s->rw[0] == 3 && s->rw[1] == 4 && s->rc[0] == 0);
    LAW("with multipliers of the rows", y[0] == 10 && !s->recursion.plain);
    given.sweeps = 0, given.unit = 1001;
    mbs_stages_estimate_multipliers(s, p);
    LAW("larger ones than 1000 are none", y[0] == 0);
    given.sweeps = 0, given.unit = 10, given.needed = 1, given.lacking = 0, y[0] = 9;
    mbs_stages_estimate_multipliers(s, p);
    LAW("and none are without factors", y[0] == 0);
    for (i = 0; i < 3; ++i) {
        anew(s);
        memset(stages, 0, sizeof stages), stages[0].d = stages[0].g = stages[1].e = stages[1].d = stages[1].g = 1;
        s->problem = &problem, s->variables = 2, s->fixed = fixed, s->softened = softened, given.most = 0.1;
        s->recursion.diagonal = room[9], p->size = 2, p->sigma = sigma, p->slope = slope, p->trial_c = trial_c, p->y = y;
        given.errors = softly[i], y[0] = 9;
        mbs_stages_estimate_multipliers(s, p);
        LAW("by what they give without a Hessian", i == 2 || near(s->recursion.compliance[0], MBS_STAGES_SOFT));
        LAW("rows without digits give", s->softening == (i < 2 ? MBS_STAGES_SOFTENED : MBS_STAGES_HARD) && y[0] > 9);
    }
}

int main(void)
{
    estimating();
    curving();
    refining();
    measuring();
    softening();
    hardening();
    giving();
    losing();
    choosing();
    stepping();
    return broken > 0;
}

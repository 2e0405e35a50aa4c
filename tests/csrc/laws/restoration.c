#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/restoration.c"

/* Stand-ins: rows that are the first variables, and what the run of the elastic problem leads to. */
static struct {
    real dual, barrier, step[8], place[8];
    int fails, status, begun, accepts;
} given;

int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c)
{
    int i;
    for (i = 0; i < s->rows; ++i)
        c[i] = x[i] + (p->elastic ? x[s->variables + s->slacks + s->rows + i] - x[s->variables + s->slacks + i] : 0);
    *cost = 5;
    return given.fails;
}

void mbs_stages_begin(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    ++given.begun;
}

int mbs_stages_run(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < s->variables; ++i)
        p->x[i] = given.place[i];
    return given.status;
}

real mbs_stages_barrier(const mbs_stages *s, const mbs_stages_phase *p, const real *x, real cost)
{
    (void)s, (void)p, (void)x;
    return given.barrier + cost;
}

void mbs_stages_bound_steps(const mbs_stages *s, const mbs_stages_phase *p, mbs_stages_direction *d)
{
    (void)s;
    memcpy(given.step, d->x, (size_t)p->size * sizeof *d->x);
    d->zl[0] = 4, d->zu[0] = 8;
}

real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d)
{
    (void)s, (void)p, (void)d;
    return given.dual;
}

void mbs_stages_search_anew(mbs_stages_phase *p)
{
    p->soft = 0;
}

/* Two variables, a slack and two rows; the second row is an inner one. */
#define MAIN 3
#define ALL 7
static real room[24][ALL], pairs[2][MBS_STAGES_ENTRIES];
static char fixed[ALL];
static mbs_stages solver;
static mbs_stages_stage stage;
static mbs_stages_problem problem;

static mbs_stages_phase *anew(mbs_stages *s)
{
    mbs_stages_phase *p = &s->main, *q = &s->least;
    int i, k;
    real **const arrays[] = {&p->x, &p->lower, &p->upper, &p->zl, &p->zu, &p->y, &p->c, &p->trial_c, &p->step.x,
                             &p->step.zl, &p->step.zu, &q->x, &q->lower, &q->upper, &q->zl, &q->zu, &q->y, &q->c,
                             &s->reference, &s->weight, &s->row_scale};
    memset(s, 0, sizeof *s), memset(&stage, 0, sizeof stage), memset(&problem, 0, sizeof problem);
    memset(room, 0, sizeof room), memset(fixed, 0, sizeof fixed), memset(&given, 0, sizeof given);
    for (k = 0; k < (int)(sizeof arrays / sizeof *arrays); ++k)
        *arrays[k] = room[k];
    p->filter.theta = pairs[0], p->filter.phi = pairs[1];
    s->options = mbs_stages_default_options();
    problem.stages = 1, s->problem = &problem, s->recursion.stage = &stage, s->fixed = fixed;
    s->variables = s->rows = 2, s->slacks = 1, p->size = MAIN, q->size = ALL, q->elastic = 1;
    stage.ne = 2, stage.d = stage.g = 2;
    for (i = 0; i < MAIN; ++i)
        p->lower[i] = q->lower[i] = -1e20, p->upper[i] = q->upper[i] = 1e20;
    s->row_scale[0] = s->row_scale[1] = 1, p->mu = 0.1, given.dual = 0.5;
    return p;
}

/* p - n = c, with the least penalty (p + n) - mu (log p + log n). */
static void splitting(void)
{
    const real residuals[5] = {3, -3, 0, 1e-12, -1e6};
    int i;
    for (i = 0; i < 5; ++i) {
        real plus, minus;
        split_residual(residuals[i], 0.5, 1000, &plus, &minus);
        LAW("elastic variables are positive", plus > 0 && minus > 0);
        LAW("their difference is the residual", fabs(plus - minus - residuals[i]) <= 1e-15 * fabs(residuals[i]) + 1e-18);
        LAW("they cost least", fabs(2000 - 0.5 / plus - 0.5 / minus) < 1e-6 * 2000);
    }
    {
        real plus, minus;
        split_residual(-1e30, 0.5, 1000, &plus, &minus);
        LAW("where digits are lost, they are mu over the penalty", plus == 0.5 / 1000 && minus == 1e30);
        split_residual(1e30, 0.5, 1000, &plus, &minus);
        LAW("on either side", fabs(minus / (0.5 / 2000) - 1) < 1e-6 || minus == 0.5 / 1000);
    }
}

static void starting(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s), *q = &s->least;
    p->x[0] = -4, p->x[1] = 0.25, p->x[2] = 9, p->c[0] = -4, p->c[1] = 0.25, p->lower[0] = -7, p->upper[2] = 8;
    p->zl[0] = 1e4, p->zu[2] = 999, p->zl[1] = 1e3, p->zu[0] = 2e3, q->y[1] = 3, stage.inner.n = 0;
    LAW("restoration starts", start(s) == 0 && given.begun == 1);
    LAW("at the point", q->x[0] == -4 && q->x[1] == 0.25 && q->x[2] == 9 && s->reference[0] == -4 && s->reference[1] == 0.25);
    LAW("with its bounds", q->lower[0] == -7 && q->upper[2] == 8);
    LAW("and multipliers, to the penalty", q->zl[0] == 1000 && q->zu[2] == 999 && q->zl[1] == 1000 && q->zu[0] == 1000);
    LAW("none of rows", q->y[0] == 0 && q->y[1] == 0);
    LAW("with the violation as barrier parameter", q->mu == 4 && s->weight_factor == 2);
    LAW("large variables weigh by their size", s->weight[0] == 0.25 && s->weight[1] == 1);
    LAW("elastic variables take up the residuals", fabs(q->c[0]) < 1e-14 && fabs(q->c[1]) < 1e-14);
    LAW("above 0, without upper bounds", q->lower[3] == 0 && q->lower[6] == 0 && q->upper[3] > MBS_STAGES_INFINITE);
    LAW("on the central path", near(q->zl[3] * q->x[3], 4) && near(q->zl[6] * q->x[6], 4) && q->zu[3] == 0);
    p->mu = 5;
    start(s);
    LAW("the barrier parameter does not fall", q->mu == 5);
    stage.inner.n = 1;
    start(s);
    LAW("inner rows have no elastic variables", fixed[3] && fixed[5] && q->x[3] == 0 && q->x[5] == 0 && q->zl[3] == 0);
    LAW("other rows have them", !fixed[4] && !fixed[6] && q->x[4] > 0 && q->zl[6] > 0);
    given.fails = 1;
    LAW("a callback may fail", start(s) == -1);
}

static void returning(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s), *q = &s->least;
    p->c[0] = 10, q->c[0] = 6, q->x[3] = 3, q->x[5] = 0.5, q->c[1] = -8.5;
    LAW("violations are those of the caller's rows", violation(s, 0) == 8.5 && violation(s, 1) == -8.5);
    LAW("the largest counts", mbs_stages_worst_violation(s) == 8.5);
    LAW("nine tenths are enough", mbs_stages_restored(s));
    q->c[0] = 6e-3, q->c[1] = -8e-3, q->x[3] = q->x[5] = 0;
    LAW("however small it is", mbs_stages_worst_violation(s) == 8e-3);
    q->c[0] = 6, q->x[3] = 3, q->x[5] = 0.5;
    q->c[1] = -9.1;
    LAW("more is not", mbs_stages_worst_violation(s) == 9.1 && !mbs_stages_restored(s));
    q->c[1] = -8.9;
    mbs_stages_filter_add(&p->filter, 17, 4);
    LAW("the filter sees the sum of violations, and the cost", !mbs_stages_restored(s));
    given.barrier = -2;
    LAW("a lower barrier function passes", mbs_stages_restored(s));
    given.barrier = 0, p->filter.theta[0] = 18;
    LAW("less violation too", mbs_stages_restored(s));
    given.fails = 1;
    LAW("a callback may fail", !mbs_stages_restored(s));
    given.fails = 0, q->c[0] = NAN;
    LAW("no number is no return", !mbs_stages_restored(s));
}

static void resuming(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s), *q = &s->least;
    p->x[0] = 1, q->x[0] = 3, q->x[1] = -2, q->lower[0] = -5, q->upper[1] = 6, p->lower[0] = -4, p->zl[0] = 10, p->zu[0] = 20;
    p->y[1] = 4, p->soft = p->tiny = p->rejected = p->acceptable = 3, s->softening = MBS_STAGES_SOFTENED;
    LAW("the caller's problem goes on", resume(s) == MBS_STAGES_RUNNING);
    LAW("where restoration ended", p->x[0] == 3 && p->x[1] == -2 && p->c[0] == 3 && p->cost == 5);
    LAW("with its bounds", p->lower[0] == -5 && p->upper[1] == 6);
    LAW("without multipliers of rows", p->y[1] == 0);
    LAW("with multipliers of bounds that follow the way of x", given.step[0] == 2 && p->zl[0] == 12 && p->zu[0] == 24);
    LAW("nothing is remembered", !p->soft && !p->tiny && !p->rejected && !p->acceptable && s->softening == MBS_STAGES_HARD);
    p->zl[0] = 998, p->zu[0] = 0;
    resume(s);
    LAW("to a limit", p->zl[0] == 1000);
    p->zl[0] = 999, p->lower[0] = q->lower[0] = -5, p->upper[1] = q->upper[1] = 6, fixed[1] = 1;
    resume(s);
    LAW("else they begin anew", p->zl[0] == 1 && p->zu[0] == 0 && p->zl[2] == 0 && p->zu[1] == 0 && p->zl[1] == 0);
    fixed[1] = 0, p->zu[0] = 999;
    resume(s);
    LAW("upper ones too", p->zl[0] == 1 && p->zu[1] == 1 && p->zu[0] == 0);
    given.fails = 1;
    LAW("a callback may fail", resume(s) == MBS_STAGES_CALLBACK_FAILED);
}

static void clashing(void)
{
    mbs_stages *s = &solver;
    mbs_stages_result *r = &s->result;
    real c[12];
    mbs_stages_phase *p = anew(s);
    real scale[12];
    int i;
    for (i = 0; i < 12; ++i)
        c[i] = 0, scale[i] = 0.5;
    p->c = c, s->row_scale = scale, s->rows = 12, stage.d = 4, stage.g = 7, stage.ng = 5;
    c[1] = 2, c[5] = -3, c[9] = 1, c[11] = 2.9e-3, c[10] = 3.1e-3;
    find_clashes(s);
    LAW("rows beside the worst are listed", r->clashes == 4);
    LAW("the worst first", r->clash[0].kind == MBS_STAGES_DYNAMICS && r->clash[0].row == 1 && r->clash[0].stage == 0);
    LAW("in their units", r->clash[0].violation == 6);
    LAW("by their place", r->clash[1].kind == MBS_STAGES_EQUALITY && r->clash[1].row == 1);
    LAW("and kind", r->clash[2].kind == MBS_STAGES_INEQUALITY && r->clash[2].row == 2 && r->clash[3].row == 3);
    r->clashes = 0;
    for (i = 0; i < 12; ++i)
        c[i] = 1 + i % 5;
    find_clashes(s);
    LAW("all are counted", r->clashes == 12);
    for (i = 0; i < MBS_STAGES_CLASHES; ++i)
        LAW("the worst of them are kept, by their order", r->clash[i].violation == (i < 2 ? 10 : i < 4 ? 8 : i < 6 ? 6 : 4));
    LAW("the first of equal ones first", r->clash[0].row == 0 && r->clash[0].kind == MBS_STAGES_DYNAMICS);
    r->clashes = 0;
    for (i = 0; i < 12; ++i)
        c[i] = 0;
    c[0] = 2e-7, c[3] = 0.9e-7;
    find_clashes(s);
    LAW("rounding is no clash", r->clashes == 1);
}

static void ending(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    p->c[0] = 1.1e-6;
    LAW("a least violation that stays is a contradiction", conclude(s, MBS_STAGES_SOLVED) == MBS_STAGES_INFEASIBLE);
    LAW("whose rows are listed", s->result.clashes == 1);
    LAW("also an acceptable one", conclude(s, MBS_STAGES_ACCEPTABLE) == MBS_STAGES_INFEASIBLE);
    LAW("other ends stay", conclude(s, MBS_STAGES_TIME_LIMIT) == MBS_STAGES_TIME_LIMIT);
    p->c[0] = 0.9e-6;
    LAW("one within rounding is none", conclude(s, MBS_STAGES_SOLVED) == MBS_STAGES_OUT_OF_DIGITS);
    anew(s);
    p->c[0] = 1e-8;
    LAW("nothing is restored where nothing is violated", mbs_stages_restore(s) == MBS_STAGES_OUT_OF_DIGITS && !given.begun);
    p->c[0] = p->x[0] = 1.1e-8, p->theta = 6, p->phi = 7, given.status = MBS_STAGES_RESTORED, given.place[0] = 0.75;
    LAW("else the caller's problem goes on", mbs_stages_restore(s) == MBS_STAGES_RUNNING && p->x[0] == 0.75);
    LAW("but not to a worse point than the last", p->filter.count == 1 && !mbs_stages_filter_accepts(&p->filter, 6.1, 7.1));
    given.status = MBS_STAGES_SOLVED, given.place[0] = 0.5;
    LAW("or contradicts itself", mbs_stages_restore(s) == MBS_STAGES_INFEASIBLE && p->x[0] == 0.5);
    given.status = MBS_STAGES_CALLBACK_FAILED, given.place[0] = 0.25;
    LAW("or has no values", mbs_stages_restore(s) == MBS_STAGES_CALLBACK_FAILED && p->x[0] == 0.5);
    given.fails = 1;
    LAW("not even at first", mbs_stages_restore(s) == MBS_STAGES_CALLBACK_FAILED);
}

int main(void)
{
    splitting();
    starting();
    returning();
    resuming();
    clashing();
    ending();
    return broken > 0;
}

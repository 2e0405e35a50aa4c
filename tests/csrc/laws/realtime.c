#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/realtime.c"

static struct {
    mbs_stages_errors errors;
    real dual, place;
    int bad, started, factorised;
} given;

void mbs_stages_centre(mbs_stages_phase *p, int i)
{
    p->x[i] = given.place; /* for the place on the central path */
}

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    (void)s, (void)p, (void)mu;
    return given.errors;
}

real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d)
{
    (void)s, (void)p, (void)d;
    return given.dual;
}

int mbs_stages_start(mbs_stages *s)
{
    (void)s;
    return given.started;
}

int mbs_stages_set_bounds(mbs_stages *s)
{
    (void)s;
    return given.bad;
}

void mbs_stages_respond(mbs_stages_recursion *r, const real *first, const real *zero, real *dw, real *dy)
{
    (void)r, (void)zero, (void)dy;
    dw[0] = first[0], dw[1] = 3 * first[0];
}

#define SIZE 3
static real room[20][SIZE];
static char fixed[SIZE];
static mbs_stages solver;
static mbs_stages_stage stage;

/* A state, an input and a slack; the state in thousandths, the input in halves, the row in quarters, the cost in tenths. */
static mbs_stages_phase *anew(mbs_stages *s)
{
    static mbs_stages_problem problem;
    mbs_stages_phase *p = &s->main;
    int i;
    memset(s, 0, sizeof *s);
    memset(&stage, 0, sizeof stage);
    memset(room, 0, sizeof room);
    memset(fixed, 0, sizeof fixed);
    memset(&given, 0, sizeof given);
    s->options = mbs_stages_default_options();
    problem.stages = 1, s->problem = &problem, s->recursion.stage = &stage;
    stage.nx = stage.nv = stage.ng = 1;
    p->x = room[0], p->lower = room[1], p->upper = room[2], p->zl = room[3], p->zu = room[4], p->y = room[5];
    p->c = room[6], p->slope = room[7], p->step.x = room[8], p->step.zl = room[9], p->step.zu = room[10];
    p->step.y = room[11];
    s->point.w = room[12], s->point.y = room[13], s->point.below = room[14], s->point.above = room[15];
    s->slack = room[16], s->slack_below = room[16] + 1, s->slack_above = room[16] + 2;
    s->variable_scale = room[17], s->row_scale = room[18];
    s->fixed = fixed, s->cost_scale = 0.1;
    s->variables = 2, s->rows = 1, s->slacks = 1, p->size = SIZE;
    for (i = 0; i < SIZE; ++i)
        p->lower[i] = -1e20, p->upper[i] = 1e20;
    s->variable_scale[0] = 1e-3, s->variable_scale[1] = 0.5, s->row_scale[0] = 0.25;
    p->mu = 0.01, p->tau = 0.75, given.dual = 0.5, given.place = 77;
    given.started = MBS_STAGES_RUNNING;
    return p;
}

static void limiting(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    const real least = sqrt(MBS_STAGES_EPSILON) * 0.01;
    real z = 1e9;
    limit_ratio(0.5, &z, 0.01);
    LAW("a product falls to a hundred times mu", near(z, 2));
    z = 1e-9;
    limit_ratio(0.5, &z, 0.01);
    LAW("or rises to a hundredth", near(z, 2e-4));
    z = NAN;
    limit_ratio(0.5, &z, 0.01);
    LAW("no number becomes one", near(z, 2e-4));
    z = 1;
    limit_ratio(0.5, &z, 0.01);
    LAW("between them it stays", z == 1);
    LAW("the least distance has digits for a step", near(least_distance(p, 0), least));
    LAW("beside a large bound more", near(least_distance(p, -1e9), 1e12 * MBS_STAGES_EPSILON));
    p->zl[0] = 5, p->zu[0] = 1e9;
    start_anew(p, 0, 1e-3);
    LAW("multipliers have a limit at the least distance", p->zl[0] == 5 && near(p->zu[0], 10) && p->x[0] == 77);
}

static void minding(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    p->lower[0] = 0, p->upper[0] = 1, p->x[0] = 0.5, p->zl[0] = p->zu[0] = 0.02;
    mind_bounds(s, p, 0);
    LAW("inside stays", p->x[0] == 0.5 && p->zl[0] == 0.02 && p->zu[0] == 0.02);
    p->x[0] = 0;
    mind_bounds(s, p, 0);
    LAW("on a bound begins anew", p->x[0] == 77);
    p->x[0] = 1.5;
    mind_bounds(s, p, 0);
    LAW("beyond one too", p->x[0] == 77);
    p->x[0] = NAN;
    mind_bounds(s, p, 0);
    LAW("no number begins anew", p->x[0] == 77);
    p->x[0] = -1, fixed[0] = 1;
    mind_bounds(s, p, 0);
    LAW("a fixed one stays", p->x[0] == -1);
    fixed[0] = 0, p->lower[0] = p->x[0] = -1e9, p->upper[0] = 1, p->zl[0] = 1e9, given.place = -1e9 + 1e-3;
    mind_bounds(s, p, 0);
    LAW("the larger least distance limits multipliers", p->zl[0] <= 0.01 / (1e12 * MBS_STAGES_EPSILON) * 1.0001);
    anew(s);
    p->lower[0] = p->x[0] = -1, p->upper[0] = 1e9, p->zl[0] = 1e9, given.place = -1 + 1e-3;
    mind_bounds(s, p, 0);
    LAW("of either bound", p->zl[0] <= 0.01 / (1e12 * MBS_STAGES_EPSILON) * 1.0001);
    anew(s);
    p->x[0] = -3, p->upper[0] = 1, p->zu[0] = 9;
    mind_bounds(s, p, 0);
    LAW("one bound alone", p->x[0] == -3 && near(p->zu[0], 0.25) && p->zl[0] == 0);
    p->upper[0] = 1e20, p->lower[0] = -7, p->zl[0] = 9, p->zu[0] = 0;
    mind_bounds(s, p, 0);
    LAW("the other one alone", p->x[0] == -3 && near(p->zl[0], 0.25) && p->zu[0] == 0);
}

static void loading(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    s->point.w[0] = 3e-3, s->point.w[1] = 2, s->point.below[1] = 6, s->point.above[1] = 8, s->point.y[0] = 5;
    p->lower[1] = -10, p->upper[1] = 10, p->lower[2] = -20, p->upper[2] = 20;
    s->slack[0] = 4, s->slack_below[0] = 0.25, s->slack_above[0] = 0.5;
    s->options.mu_target = 1;
    LAW("the last plan is loaded", load(s) == MBS_STAGES_RUNNING);
    LAW("in scaled units", near(p->x[0], 3) && near(p->x[1], 4) && near(p->y[0], 5 * 0.1 / 0.25));
    LAW("with multipliers of bounds", near(p->zl[1], 0.3) && near(p->zu[1], 0.4) && p->zl[0] == 0 && p->zu[0] == 0);
    LAW("and slacks in the units of rows", near(p->x[2], 1) && near(p->zl[2], 0.1) && near(p->zu[2], 0.2));
    p->lower[0] = 3, p->upper[2] = 0.5;
    load(s);
    LAW("and each is brought inside of its bounds", p->x[0] == 77 && p->x[2] == 77 && near(p->x[1], 4));
    p->lower[0] = -1e20, p->upper[2] = 20;
    load(s);
    save(s);
    LAW("what is saved is what was loaded", near(s->slack[0], 4) && near(s->slack_below[0], 0.25));
    LAW("on both sides", near(s->slack_above[0], 0.5));
    fixed[0] = fixed[1] = fixed[2] = 1;
    p->lower[0] = p->upper[0] = 9, p->lower[1] = p->upper[1] = 7, p->lower[2] = p->upper[2] = 6;
    load(s);
    LAW("a first state is measured later", near(p->x[0], 3));
    LAW("other fixed ones take their bounds", p->x[1] == 7 && p->x[2] == 6);
    LAW("without multipliers", !p->zl[0] && !p->zl[1] && !p->zl[2] && !p->zu[0] && !p->zu[1] && !p->zu[2]);
    given.bad = 1;
    LAW("bounds that cross are no problem", load(s) == MBS_STAGES_BAD_PROBLEM);
}

static void measuring(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    real first[1] = {5e-3}, deviation[1];
    given.errors.violation = 3, given.errors.complementarity = 4;
    p->slope[0] = 1e-6, p->slope[1] = -2;
    measure(s, p);
    LAW("violation is as it is", s->realtime.violation == 3);
    LAW("complementarity in units of the cost", near(s->realtime.complementarity, 40));
    LAW("stationarity in units of cost over variable", near(s->realtime.stationarity, 2 / (0.5 * 0.1)));
    p->slope[0] = 1;
    measure(s, p);
    LAW("the largest one", near(s->realtime.stationarity, 1 / (1e-3 * 0.1)));
    LAW("numbers are finite", is_finite(SIZE, p->x));
    p->x[1] = -INFINITY;
    LAW("or not", !is_finite(SIZE, p->x));
    p->x[1] = NAN;
    LAW("each of them", !is_finite(SIZE, p->x) && is_finite(1, p->x));
    s->usual = 2, p->c[0] = 19.9;
    LAW("ten times the usual violation", !has_diverged(s, p));
    p->c[0] = -20.1;
    LAW("is the most", has_diverged(s, p));
    s->options.most_violation = 21;
    LAW("unless the caller gives more", !has_diverged(s, p));
    s->options.most_violation = 1;
    LAW("or less", has_diverged(s, p));
    p->x[0] = -8, p->x[1] = 2, p->x[2] = 99, p->c[0] = 3;
    LAW("a plan begins", begin(s) == MBS_STAGES_RUNNING && s->usual == 8);
    p->c[0] = -12;
    begin(s);
    LAW("its violation may be the larger", s->usual == 12);
    p->x[0] = p->x[1] = p->c[0] = 0.1;
    begin(s);
    LAW("the usual one is 1 at least", s->usual == 1);
    s->usual = 5, given.started = MBS_STAGES_BAD_PROBLEM;
    LAW("or it does not", begin(s) == MBS_STAGES_BAD_PROBLEM && s->usual == 5);
    p->x[0] = 3, fixed[0] = 1;
    LAW("a deviation is scaled", find_deviation(s, first, deviation) == 0 && near(deviation[0], 2));
    LAW("and told", near(s->realtime.deviation, 2));
    first[0] = NAN;
    LAW("no number is none", find_deviation(s, first, deviation) == -1);
    fixed[0] = 0;
    LAW("a free state has none", find_deviation(s, first, deviation) == 0 && deviation[0] == 0);
}

static void stepping(void)
{
    mbs_stages *s = &solver;
    mbs_stages_phase *p = anew(s);
    p->lower[0] = 0, p->upper[0] = 10, p->x[0] = 2, p->step.x[0] = -1;
    LAW("inside a step is whole", length(p, 0) == 1);
    p->step.x[0] = -3;
    LAW("else a part of the distance stays", near(length(p, 0), 0.5));
    p->step.x[0] = 12;
    LAW("above too", near(length(p, 0), 0.5));
    p->step.x[0] = 5;
    LAW("a whole step above", length(p, 0) == 1);
    p->lower[0] = -1e20, p->step.x[0] = -1e19;
    LAW("no bound stops nothing", length(p, 0) == 1);
    p->upper[0] = 1e20, p->step.x[0] = 1e19;
    LAW("on either side", length(p, 0) == 1);
    anew(s);
    p->lower[0] = 0, p->x[0] = 2, p->step.x[0] = -3, p->step.x[1] = 4, p->lower[1] = 0, p->x[1] = 1;
    p->lower[2] = 0, p->x[2] = 1, p->step.x[2] = -9, fixed[2] = 1, p->y[0] = 1, p->step.y[0] = 6;
    p->step.zl[0] = 8, p->step.zu[1] = 10;
    make_step(s, p);
    LAW("each variable goes as far as it can", near(p->x[0], 0.5) && p->x[1] == 5 && p->x[2] == -8);
    LAW("multipliers of rows by the shortest length", near(p->y[0], 4));
    LAW("of bounds by their own", p->zl[0] == 4 && p->zu[1] == 5);
    LAW("both are told", near(s->realtime.length, 0.5) && s->realtime.dual_length == 0.5 && near(p->alpha, 0.5));
    LAW("without a preparation there is no feedback", feedback(s, room[19]) == MBS_STAGES_NOT_PREPARED);
    s->ready = 1, s->rw = room[18], room[19][0] = NAN, fixed[0] = 1;
    LAW("nor of no number, which keeps the preparation", feedback(s, room[19]) == MBS_STAGES_BAD_PROBLEM && s->ready);
    s->live = 1;
    mbs_stages_begin_anew(s);
    LAW("a new beginning forgets both", !s->live && !s->ready);
}

static void gaining(void)
{
    mbs_stages *s = &solver;
    const real *gain;
    anew(s);
    s->rw = room[19], s->residual_c = room[14], s->dw = room[12], s->dy = room[13];
    fixed[0] = 1;
    LAW("without a step there is no gain", mbs_stages_gain(s, 0) == NULL);
    s->live = 1, s->realtime.status = MBS_STAGES_DIVERGED;
    LAW("nor after one that was not made", mbs_stages_gain(s, 0) == NULL);
    s->realtime.status = MBS_STAGES_STEPPED;
    gain = mbs_stages_gain(s, 0);
    LAW("a gain is in the caller's units", gain && near(gain[0], 1) && near(gain[1], 3 * 0.5 / 1e-3));
    s->live = 0, s->ready = 1;
    LAW("also before a step", mbs_stages_gain(s, 0) != NULL);
    gain = mbs_stages_gain(s, 1);
    LAW("what is no first state moves nothing", gain && gain[0] == 0 && gain[1] == 0);
    gain = mbs_stages_gain(s, -1);
    LAW("on either side", gain && gain[0] == 0);
    fixed[0] = 0;
    gain = mbs_stages_gain(s, 0);
    LAW("nor does a free one", gain && gain[0] == 0);
    fixed[0] = 1, s->variable_scale[0] = 0;
    LAW("no number is no gain", mbs_stages_gain(s, 0) == NULL);
}

int main(void)
{
    gaining();
    limiting();
    minding();
    loading();
    measuring();
    stepping();
    return broken > 0;
}

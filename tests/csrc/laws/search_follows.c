/* Corrections of refused trials: of inner variables by their own equations, and of the step for the curvature of rows. */
#include "drawn.h"

#include "../../../csrc/stages/search.c"

static mbs_stages_phase *open_trial(void)
{
    mbs_stages_phase *p = open_iterate(4, 1, 0);
    LAW("the conditions are factorised", mbs_stages_newton_factorise(drawn, p) == 0);
    mbs_stages_stationarity(drawn, p, 1, p->slope);
    mbs_stages_newton_solve(drawn, p, p->c, &p->step);
    p->theta = mbs_stages_sum(ROWS, p->c), p->phi = mbs_stages_barrier(drawn, p, p->x, p->cost);
    return p;
}

/* Whether variable i of w is inner: the first stage variable of each stage. */
static int is_inner(int i)
{
    return i == 2 || i == 6 || i == 10;
}

static real inner_violation(const real *x)
{
    return fmax(fabs(row_value(x, 0)), fmax(fabs(row_value(x, 5)), fabs(row_value(x, 10))));
}

static void corrections(void)
{
    mbs_stages_phase *p = open_trial();
    real before[W + S], start;
    int i, turn;
    for (i = 0; i < W + S; ++i)
        p->trial[i] = p->x[i] + (i < W && !drawn->fixed[i] ? pick() / 8 : 0);
    memcpy(before, p->trial, sizeof before);
    start = inner_violation(p->trial);
    for (turn = 0; turn < 6; ++turn) {
        const real last = inner_violation(p->trial);
        mbs_stages_phase_values(drawn, p, p->trial, &p->trial_cost, p->trial_c);
        correct_inner(drawn, p);
        LAW("inner equations come to hold", inner_violation(p->trial) < last / 2 || last < 1e-9);
        for (i = 0; i < W + S; ++i)
            LAW("by inner variables alone", is_inner(i) || p->trial[i] == before[i]);
    }
    LAW("of all stages", start > 1e-2 && inner_violation(p->trial) < start * 1e-3);
    memcpy(p->trial, before, sizeof before);
    mbs_stages_phase_values(drawn, p, p->trial, &p->trial_cost, p->trial_c);
    p->lower[6] = p->trial[6] - (real)1e-9, p->upper[6] = p->trial[6] + (real)1e-9;
    drawn->fixed[10] = 1;
    correct_inner(drawn, p);
    LAW("inside of their bounds", p->trial[6] > p->lower[6] && p->trial[6] < p->upper[6] && p->trial[2] != before[2]);
    LAW("fixed ones stay", p->trial[10] == before[10]);
    drawn->fixed[10] = 0;
}

/* A point where all rows hold, and a trial whose inner variables alone are off: by that its violation. */
static real spoil(mbs_stages_phase *p, search *t)
{
    int i;
    for (i = 0; i < W + S; ++i)
        p->trial[i] = p->x[i] + (is_inner(i) ? (real)0.2 : 0);
    LAW("the trial has values", evaluate(drawn, p, t) == 0);
    return t->theta;
}

static mbs_stages_phase *open_held(void)
{
    mbs_stages_phase *p = open_iterate(4, 1, 0);
    int i, row;
    let_hold();
    memcpy(p->x, held, sizeof held);
    for (row = 0; row < ROWS; ++row)
        if (slack_of(row) >= 0)
            p->x[W + slack_of(row)] = row_value(held, row);
    for (i = 0; i < W; ++i)
        p->lower[i] = drawn->fixed[i] ? p->lower[i] : -1e20, p->upper[i] = drawn->fixed[i] ? p->upper[i] : 1e20;
    LAW("there are derivatives", !mbs_stages_phase_derivatives(drawn, p) && !mbs_stages_phase_hessian(drawn, p));
    LAW("the conditions are factorised", mbs_stages_newton_factorise(drawn, p) == 0);
    p->phi = 0, p->theta = 1e9, drawn->options.follow = 1;
    return p;
}

static void following(void)
{
    mbs_stages_phase *p = open_held();
    search t = {.descent = -1};
    const real off = spoil(p, &t);
    int before;
    p->theta_most = off / 2;
    LAW("a trial that follows is accepted", follow(drawn, p, &t, 1) == 0 && t.theta < off / 2);
    spoil(p, &t);
    p->theta_most = off * (real)1e-6;
    LAW("after as many corrections as it takes", follow(drawn, p, &t, 1) == 0 && t.theta <= p->theta_most);
    spoil(p, &t);
    p->theta_most = -1, before = drawn->result.evaluations;
    LAW("eight at most", follow(drawn, p, &t, 1) == -1 && drawn->result.evaluations - before <= 8);
    drawn->fixed[2] = drawn->fixed[6] = drawn->fixed[10] = 1, before = drawn->result.evaluations;
    spoil(p, &t);
    LAW("and none where the first lowers nothing", follow(drawn, p, &t, 1) == -1 && drawn->result.evaluations - before == 2);
    drawn->fixed[2] = drawn->fixed[6] = drawn->fixed[10] = 0, drawn->options.follow = 0, p->theta_most = 1e9;
    spoil(p, &t);
    LAW("and none without the option", follow(drawn, p, &t, 1) == -1 && near(t.theta, off));
    drawn->options.follow = 1, failing = 1;
    LAW("values may fail", follow(drawn, p, &t, 1) == -1);
    failing = 0;
}

static void second_order(void)
{
    int turn, tried = 0;
    for (turn = 0; turn < 6; ++turn) {
        mbs_stages_phase *p = open_trial();
        search t = {.descent = -1};
        real length, first, x[W + S], step[W + S];
        int i;
        for (i = 0; i < W + S; ++i)
            p->lower[i] = drawn->fixed[i] ? p->lower[i] : -1e20, p->upper[i] = drawn->fixed[i] ? p->upper[i] : 1e20;
        memcpy(step, p->step.x, sizeof step);
        LAW("a whole step has values", try_step(drawn, p, p->step.x, 1, &t) == 0);
        first = t.theta, p->theta_most = first / 2;
        if (first > p->theta / 4)
            continue; /* rows bend too much for it */
        ++tried;
        LAW("a step that bends rows is corrected", correct(drawn, p, &t, 1, &length) == 0 && length == 1);
        LAW("to a smaller violation", t.theta <= first / 2);
        for (i = 0; i < W + S; ++i)
            x[i] = p->x[i] + length * p->step.x[i];
        LAW("and is the step then", !memcmp(step, p->other.x, sizeof step) && fabs(x[5] - p->trial[5]) < 1e-12);
        p = open_trial();
        try_step(drawn, p, p->step.x, (real)0.5, &t);
        p->options = &drawn->options, drawn->options.max_soc = 0, p->theta_most = 1e9, p->theta = 1e9;
        LAW("as often as is asked for", correct(drawn, p, &t, (real)0.5, &length) == -1);
        drawn->options.max_soc = 4, failing = 1;
        LAW("values may fail", correct(drawn, p, &t, (real)0.5, &length) == -1);
        failing = 0;
    }
    LAW("some steps bend rows", tried > 1);
}

/* Lengths begin with the longest one, or with half of it where that was tried before. */
static void lengths(void)
{
    int again;
    for (again = 0; again < 2; ++again) {
        mbs_stages_phase *p = open_trial();
        const real most = mbs_stages_boundary(drawn, p, p->x, p->step.x, p->tau);
        search t = {.descent = -1};
        p->theta = p->theta_most = 1e9; /* any trial is progress */
        LAW("a trial is taken", backtrack(drawn, p, &t, again) == 0);
        LAW("the longest, or the next", near(p->alpha, again ? most / 2 : most));
        p = open_trial();
        p->theta_most = -1;
        LAW("none is, where none will do", backtrack(drawn, p, &t, again) == -1);
    }
}

int main(void)
{
    corrections(), following(), second_order(), lengths();
    close_drawn();
    return broken > 0;
}

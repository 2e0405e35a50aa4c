/* Steps in real time against the conditions of the problem that they solve: at once where it is a linear quadratic one. */
#include "drawn.h"

#include "../../../csrc/stages/realtime.c"

/* The largest residual of rows, and of slopes with all multipliers; of numbers from `first` on. */
static real rows_off(const real *w)
{
    real most = 0;
    int row;
    for (row = 0; row < ROWS; ++row)
        most = slack_of(row) < 0 ? fmax(most, fabs(row_value(w, row))) : most;
    return most;
}

static real slopes_off(const mbs_stages_point *q, int measured)
{
    real most = 0;
    int i, row;
    for (i = 0; i < W; ++i) {
        real left = cost_slope(q->w, i) - q->below[i] + q->above[i];
        for (row = 0; row < ROWS; ++row)
            left += q->y[row] * entry_of(q->w, row, i);
        most = i < measured || w_lower[i] == w_upper[i] ? most : fmax(most, fabs(left));
    }
    return most;
}

/* Rows that are linear, and no bounds but the measured state's. */
static void open_linear(void)
{
    int i, k, row;
    open_drawn(4, 0);
    for (k = 0; k < STAGES; ++k)
        for (row = 1; row < FUNCTIONS; ++row)
            memset(bent[k][row], 0, sizeof bent[k][row]);
    for (i = 0; i < W; ++i)
        w_lower[i] = i < 2 ? 0 : -1e20, w_upper[i] = i < 2 ? 0 : 1e20, w_scale[i] = i % 3 ? 2 : (real)0.5;
    for (i = 0; i < S; ++i)
        g_least[i] = -1e20, g_most[i] = 1e20;
    linear[1][0][1] = -400, linear[1][1][0] = 300;
}

static void linear_ones(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    const real measured[3][2] = {{(real)0.25, -1}, {(real)0.75, 2}, {-1, (real)0.5}};
    real v[2], before[W], gain[2][W], weights[W], pulled[2];
    mbs_stages_realtime r;
    int i, j, turn;
    open_linear();
    o.mu_target = (real)1e-3;
    for (turn = 0; turn < 3; ++turn) {
        real deviation = 0;
        const real *x = measured[turn];
        r = mbs_stages_prepare(drawn, turn ? &o : NULL, 0);
        LAW("a step can be prepared", r.status == MBS_STAGES_PREPARED && r.stage == -1 && r.factorisations >= 1);
        LAW("without curvature", r.curvature == 0);
        LAW("a plan that is a solution has no errors", !turn || (r.violation < 1e-10 && r.stationarity < 1e-9));
        LAW("a guess has", turn || (r.violation > 0.01 && r.stationarity > 0.01));
        for (i = 0; i < 2; ++i)
            deviation = fmax(deviation, fabs(x[i] - drawn->point.w[i]) / w_scale[i]);
        memcpy(before, drawn->point.w, sizeof before);
        for (i = 0; i < ROWS; ++i)
            drawn->residual_c[i] = 9; /* which no response reads */
        for (j = 0; j < 2; ++j)
            memcpy(gain[j], mbs_stages_gain(drawn, j), sizeof gain[j]);
        for (i = 0; i < W; ++i)
            weights[i] = (real)((7 * i + turn) % 11) - 5;
        LAW("an adjoint has the factors of gains", mbs_stages_adjoint(drawn, weights, pulled) == 0);
        for (j = 0; j < 2; ++j) {
            real sum = 0;
            for (i = 0; i < W; ++i)
                sum += weights[i] * gain[j][i];
            LAW("and the derivatives of a sum", fabs(pulled[j] - sum) < 1e-10 * (1 + fabs(sum)));
        }
        for (i = 0; i < ROWS; ++i)
            drawn->residual_c[i] = 9;
        r = mbs_stages_feedback(drawn, x, v);
        LAW("a step is made", r.status == MBS_STAGES_STEPPED && r.length == 1 && r.dual_length == 1);
        LAW("from the measured state", near(drawn->point.w[0], x[0]) && near(drawn->point.w[1], x[1]));
        LAW("whose deviation is scaled", near(r.deviation, deviation));
        LAW("the first variables are returned", v[0] == drawn->point.w[2] && v[1] == drawn->point.w[3]);
        LAW("rows hold at once", rows_off(drawn->point.w) < 1e-11);
        LAW("and slopes vanish", slopes_off(&drawn->point, 2) < 1e-9);
        for (i = 0; i < W && turn; ++i) {
            const real moved = gain[0][i] * (x[0] - before[0]) + gain[1][i] * (x[1] - before[1]);
            LAW("a gain is the change by a measured state", fabs(drawn->point.w[i] - before[i] - moved) < 1e-11);
        }
    }
    memcpy(before, drawn->point.w, sizeof before);
    r = mbs_stages_prepare(drawn, &o, 1);
    LAW("a plan that moves ahead is another one", r.status == MBS_STAGES_PREPARED && r.violation > 1e-3);
    for (i = 0; i < 6; ++i)
        LAW("by one stage", drawn->point.w[i] == before[i + 4]);
}

/* Steps for one measured state come to the solution of the barrier problem. */
static void repeated(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_realtime r = {0};
    real v[2], x[2] = {(real)0.25, NAN}, change, price;
    int i, k, turn, s;
    for (turn = 0; turn < 4; ++turn) {
        const mbs_stages_point *q;
        open_drawn(4, turn % 2);
        let_hold();
        for (i = 0; i < W; ++i)
            w_scale[i] = turn > 1 && i % 3 ? 2 : 1;
        if (turn > 1)
            linear[1][0][1] = -400;
        o.mu_target = turn ? (real)1e-3 : (real)0.25, o.bound_relax_factor = 0;
        price = (real)1.01e-5 * o.mu_target + (real)1e-9;
        q = &drawn->point;
        for (k = 0; k < 60; ++k) {
            r = mbs_stages_prepare(drawn, &o, 0);
            LAW("steps can be prepared", r.status == MBS_STAGES_PREPARED);
            change = q->w[2];
            r = mbs_stages_feedback(drawn, x, v);
            LAW("and made", r.status == MBS_STAGES_STEPPED && r.length > 0 && r.length <= 1);
            for (i = 0; i < W; ++i)
                LAW("inside of bounds", w_lower[i] == w_upper[i] || (q->w[i] > w_lower[i] && q->w[i] < w_upper[i]));
        }
        LAW("steps end", fabs(change - q->w[2]) < 1e-9 && r.length == 1);
        LAW("at a point without errors", r.stationarity < price && r.violation < 1e-9 && r.complementarity < 1e-9);
        LAW("where rows hold", rows_off(q->w) < 1e-9);
        LAW("and slopes vanish, but for the price of distances", slopes_off(q, 0) < price);
        for (i = 0; i < W; ++i) {
            const real low = q->below[i] * (q->w[i] - w_lower[i]), high = q->above[i] * (w_upper[i] - q->w[i]);
            LAW("products are the caller's, below", w_lower[i] < -1e19 || w_lower[i] == w_upper[i] || fabs(low - o.mu_target) < 1e-7);
            LAW("and above", w_upper[i] > 1e19 || w_lower[i] == w_upper[i] || fabs(high - o.mu_target) < 1e-7);
        }
        for (i = 0; i < ROWS; ++i)
            if ((s = slack_of(i)) > 0) {
                const real value = row_value(q->w, i), y = q->y[i];
                const real low = g_least[s] > -1e19 ? o.mu_target / (value - g_least[s]) : 0;
                const real high = g_most[s] < 1e19 ? o.mu_target / (g_most[s] - value) : 0;
                LAW("rows push by their distances from their bounds", fabs(y - high + low) < price);
            }
    }
}

/* A measurement whose step overflows, and scales that are none. */
static void extremes(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_realtime r;
    real v[2], x[2] = {(real)1.7e308, (real)1.7e308}, before[W];
    int i;
    open_linear();
    for (i = 0; i < W; ++i)
        w_scale[i] = 1;
    linear[0][2][0] = linear[0][3][1] = 4;
    LAW("a step is prepared", mbs_stages_prepare(drawn, &o, 0).status == MBS_STAGES_PREPARED);
    memcpy(before, drawn->point.w, sizeof before);
    LAW("numbers that overflow are no step", mbs_stages_feedback(drawn, x, v).status == MBS_STAGES_OUT_OF_DIGITS);
    LAW("and the plan stays", !memcmp(before, drawn->point.w, sizeof before) && v[0] == before[2]);
    open_linear();
    w_scale[5] = -1;
    r = mbs_stages_prepare(drawn, &o, 0);
    LAW("scales are positive, of all stages", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == -1);
}

static void ends(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_realtime r;
    real v[2], x[2] = {(real)0.25, 0}, bad[2] = {NAN, 0}, before[W];
    open_drawn(4, 0);
    let_hold();
    memcpy(before, drawn->point.w, sizeof before);
    r = mbs_stages_feedback(drawn, x, v);
    LAW("nothing is prepared at first", r.status == MBS_STAGES_NOT_PREPARED && v[0] == before[2] && v[1] == before[3]);
    for (failing = 1; failing <= 3; ++failing) {
        failing_stage = failing - 1;
        r = mbs_stages_prepare(drawn, &o, 0);
        LAW("a callback may have no result", r.status == MBS_STAGES_CALLBACK_FAILED && r.stage == failing_stage);
        LAW("there is no step then", mbs_stages_feedback(drawn, x, v).status == MBS_STAGES_NOT_PREPARED);
        LAW("and the plan stays", !memcmp(before, drawn->point.w, sizeof before) && mbs_stages_gain(drawn, 0) == NULL);
        LAW("and there is no adjoint", mbs_stages_adjoint(drawn, before, before) == -1);
    }
    failing = 0;
    LAW("a step is prepared", mbs_stages_prepare(drawn, &o, 0).status == MBS_STAGES_PREPARED);
    r = mbs_stages_feedback(drawn, bad, v);
    LAW("a measurement that is no number is none", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == 0);
    LAW("another may follow", mbs_stages_feedback(drawn, x, v).status == MBS_STAGES_STEPPED);
    LAW("once", mbs_stages_feedback(drawn, x, v).status == MBS_STAGES_NOT_PREPARED);
    w_lower[5] = 2, w_upper[5] = 1;
    r = mbs_stages_prepare(drawn, &o, 0);
    LAW("bounds that cross are no problem", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == 1);
    w_lower[5] = -1e20, w_upper[5] = 1e20;
    base[1][1] += 1e6, memcpy(before, drawn->point.w, sizeof before);
    r = mbs_stages_prepare(drawn, &o, 0);
    LAW("a plan far from its rows is none", r.status == MBS_STAGES_DIVERGED && r.violation > 1e5);
    LAW("and makes no step", mbs_stages_feedback(drawn, x, v).status == MBS_STAGES_NOT_PREPARED);
    LAW("but stays", !memcmp(before, drawn->point.w, sizeof before));
    o.most_violation = 1e7;
    LAW("unless that is asked for", mbs_stages_prepare(drawn, &o, 0).status == MBS_STAGES_PREPARED);
    o.most_violation = 0;
    mbs_stages_begin_anew(drawn);
    LAW("a new beginning measures violations anew", mbs_stages_prepare(drawn, &o, 0).status == MBS_STAGES_PREPARED);
}

int main(void)
{
    linear_ones(), repeated(), extremes(), ends();
    close_drawn();
    return broken > 0;
}

/* What a solve begins with, and what it returns: scales, bounds, points, multipliers, in the caller's numbers. */
#include "drawn.h"

#include "../../../csrc/stages/solve.c"

static mbs_stages_phase *begin(const mbs_stages_options *o)
{
    drawn->options = *o;
    LAW("a problem at random can begin", mbs_stages_start(drawn) == MBS_STAGES_RUNNING);
    return &drawn->main;
}

/* A guess that is near no bound, or beyond some. */
static void guess(real far)
{
    int i;
    for (i = 0; i < W; ++i)
        drawn->point.w[i] = far * pick();
}

static real largest_entry(const real *w, int row)
{
    real most = 0;
    int i, k, first = 0, at = 0;
    for (k = 0; row >= first + count_rows(k); ++k)
        first += count_rows(k), at += count_variables(k);
    for (i = at; i < at + count_variables(k); ++i)
        most = fmax(most, fabs(entry_of(w, row, i) * w_scale[i]));
    return most;
}

/* The row of dynamics gives this state; or -1. */
static int next_state_of(int row)
{
    int k, first = 0, at = 0;
    for (k = 0; row >= first + count_rows(k); ++k)
        first += count_rows(k), at += count_variables(k);
    row -= first + drawn_sizes[k].ne;
    return row >= 0 && row < count_next(k) ? at + count_variables(k) + row : -1;
}

static void scales(int scaled)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_phase *p;
    real w[W], steepest = 0;
    int i, row;
    open_drawn(4, 0);
    for (i = 0; i < W; ++i)
        w_scale[i] = i % 3 ? i % 3 == 1 ? 8 : (real)0.5 : 1;
    linear[1][0][1] = -4000, linear[0][2][2] = 900, linear[2][2][0] = -700, linear[1][1][3] = 500; /* cost, d, g, e */
    guess(1);
    o.scaled = scaled;
    p = begin(&o);
    for (i = 0; i < W; ++i)
        w[i] = p->x[i] * w_scale[i];
    for (i = 0; i < W; ++i) {
        LAW("variables have the caller's scales", drawn->variable_scale[i] == w_scale[i] && drawn->has_units);
        steepest = fmax(steepest, fabs(cost_slope(w, i) * w_scale[i]));
    }
    LAW("a steep cost gets a slope of 100", fabs(drawn->cost_scale - (scaled ? 100 / steepest : 1)) < 1e-12);
    for (row = 0; row < ROWS; ++row) {
        const int next = next_state_of(row);
        const real slope = largest_entry(w, row), wanted = scaled && slope > 100 ? 100 / slope : 1;
        LAW("steep rows, too", next >= 0 || fabs(drawn->row_scale[row] - wanted) < 1e-12);
        LAW("dynamics have the scales of their states", next < 0 || near(drawn->row_scale[row], 1 / w_scale[next]));
    }
    for (row = 0; row < ROWS; ++row) {
        const real slack = slack_of(row) < 0 ? 0 : p->x[W + slack_of(row)];
        LAW("rows are there, in their scales", fabs(row_value(w, row) * drawn->row_scale[row] - slack - p->c[row]) < 1e-12);
    }
}

/* In small units flat rows are multiplied, and rows at the same places of stages have the scale of the steepest. */
static void small_units(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    int k, row, i;
    open_drawn(4, 0);
    for (i = 0; i < W; ++i)
        w_scale[i] = (real)1e-4;
    for (k = 0; k < STAGES; ++k)
        for (row = 1; row < FUNCTIONS; ++row)
            for (i = 0; i < MOST; ++i)
                linear[k][row][i] = (real)(i == 1 ? row : 0), bent[k][row][i][0] = bent[k][row][i][1] = 0,
                bent[k][row][i][2] = bent[k][row][i][3] = 0;
    linear[0][1][1] = (real)0.5, linear[1][1][1] = 5, linear[2][1][1] = 2; /* e */
    linear[0][4][1] = 2, linear[0][5][1] = 3, linear[1][4][1] = (real)0.25, linear[1][5][1] = 8; /* g */
    linear[2][2][1] = 40;
    begin(&o);
    for (k = 0; k < STAGES; ++k)
        LAW("rows of e have the slope of the steepest", near(drawn->row_scale[k * 5], 1 / (5 * (real)1e-4)));
    for (k = 0; k < 2; ++k) {
        LAW("rows of g, too", near(drawn->row_scale[k * 5 + 3], 1 / (2 * (real)1e-4)));
        LAW("each with its own", near(drawn->row_scale[k * 5 + 4], 1 / (8 * (real)1e-4)));
        LAW("dynamics keep the scales of their states", near(drawn->row_scale[k * 5 + 1], (real)1e4) &&
                                                            near(drawn->row_scale[k * 5 + 2], (real)1e4));
    }
    LAW("where stages have as many", near(drawn->row_scale[11], 1 / (40 * (real)1e-4)));
    w_scale[2] = 1, linear[1][1][1] = 0;
    linear[0][1][1] = 0, linear[0][1][2] = 7;
    begin(&o);
    LAW("from either side", near(drawn->row_scale[5], 1) && near(drawn->row_scale[10], 1));
}

/* The room of a number between its bounds, and the size of a bound. */
static void points(int warm)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_phase *p;
    real w[W];
    int i, row, turn;
    for (turn = 0; turn < 4; ++turn) {
        open_drawn(4, 0);
        o.scaled = 0, o.warm_start_init_point = warm, o.bound_relax_factor = (real)1e-3;
        for (i = 0; i < W; ++i)
            w_scale[i] = i % 2 ? 2 : 1;
        guess(turn % 2 ? 6 : 1);
        for (i = 0; i < W; ++i)
            w[i] = drawn->point.w[i];
        p = begin(&o);
        for (i = 0; i < W; ++i) {
            const real a = w_lower[i] / w_scale[i], b = w_upper[i] / w_scale[i], x = w[i] / w_scale[i];
            const int below = a > -1e19, above = b < 1e19;
            LAW("equal bounds hold a number", i != 0 || (drawn->fixed[i] && p->x[i] == a && p->lower[i] == a && p->upper[i] == a));
            LAW("no other", drawn->fixed[i] == (i == 0 || i == 3));
            if (drawn->fixed[i])
                continue;
            LAW("a lower bound gives by its size", !below || near(p->lower[i], a - 1e-3 * fmax(1, fabs(a))));
            LAW("an upper one, too", !above || near(p->upper[i], b + 1e-3 * fmax(1, fabs(b))));
            LAW("a bound that is not there is none", (below || p->lower[i] <= -1e19) && (above || p->upper[i] >= 1e19));
            LAW("numbers begin inside", (!below || p->x[i] > p->lower[i]) && (!above || p->x[i] < p->upper[i]));
            if (!warm)
                LAW("by a hundredth of a bound's size or of the room", (!below || p->x[i] - p->lower[i] > 0.0099) &&
                        (!above || p->upper[i] - p->x[i] > 0.0099));
            LAW("where they were, if that is inside", warm || turn % 2 || p->x[i] == x);
            LAW("bounds have multipliers of 1", warm || (p->zl[i] == below && p->zu[i] == above));
        }
        for (i = 0; i < W; ++i)
            w[i] = p->x[i] * w_scale[i];
        for (row = 0; row < ROWS; ++row)
            if (slack_of(row) >= 0) {
                const int s = slack_of(row), at = W + s;
                const real value = row_value(w, row), a = g_least[s], b = g_most[s];
                const int inside = value > a + 0.5 && value < b - 0.5;
                LAW("slacks have the bounds of their rows", s == 0 || ((a < -1e19 || near(p->lower[at], a - 1e-3 * fabs(a))) &&
                        (b > 1e19 || near(p->upper[at], b + 1e-3 * fabs(b)))));
                LAW("and begin at their rows", s == 0 || !inside || warm || fabs(p->x[at] - value) < 1e-12);
                LAW("or inside", s == 0 || (p->x[at] > p->lower[at] && p->x[at] < p->upper[at]));
                LAW("equal bounds hold a slack", s != 0 || (p->x[at] == g_least[0] && drawn->fixed[at]));
            }
    }
}

/* A point with multipliers, between solves: it comes back as it is, but on the central path. */
static void warmth(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_phase *p;
    real w[W], y[ROWS];
    int i;
    open_drawn(4, 0);
    for (i = 0; i < W; ++i)
        w_scale[i] = i % 3 ? 4 : 1;
    linear[1][0][1] = -4000, linear[2][2][0] = -700;
    guess(1);
    o.warm_start_init_point = 2, o.mu_init = (real)1e-3;
    for (i = 0; i < ROWS; ++i)
        drawn->point.y[i] = y[i] = pick();
    for (i = 0; i < W; ++i)
        w[i] = drawn->point.w[i], drawn->point.below[i] = 0, drawn->point.above[i] = 0;
    p = begin(&o);
    LAW("the caller may choose the barrier parameter", p->mu == (real)1e-3 && drawn->farther == 0);
    for (i = 0; i < W + S; ++i)
        if (!drawn->fixed[i]) {
            LAW("products are on the central path",
                (p->lower[i] <= -1e19 || fabs((p->x[i] - p->lower[i]) * p->zl[i] - 1e-3) < 1e-12) &&
                    (p->upper[i] >= 1e19 || fabs((p->upper[i] - p->x[i]) * p->zu[i] - 1e-3) < 1e-12));
        } else
            LAW("fixed numbers have none", p->zl[i] == 0 && p->zu[i] == 0);
    mbs_stages_write_point(drawn);
    for (i = 0; i < W; ++i)
        LAW("numbers come back in the caller's scales", i == 0 || i == 3 || fabs(drawn->point.w[i] - w[i]) < 1e-12);
    for (i = 0; i < ROWS; ++i)
        LAW("multipliers, too", fabs(drawn->point.y[i] - y[i]) < 1e-12);
    for (i = 0; i < W; ++i) /* z of the cost's and the variable's unit */
        LAW("and those of bounds",
            near(drawn->point.below[i] * (drawn->cost_scale * w_scale[i]), p->zl[i]) &&
                near(drawn->point.above[i] * (drawn->cost_scale * w_scale[i]), p->zu[i]));
    o.mu_init = 0, drawn->point.w[6] = w_lower[6] + (real)4e-3;
    p = begin(&o);
    LAW("it does not go far from its bounds", fabs(p->x[6] - w_lower[6] - (real)4e-3) < 1e-12);
    LAW("else it begins low", p->mu == MBS_STAGES_LOW);
    LAW("and may begin farther, by the square of the violation", drawn->farther > 0 && drawn->farther <= WARM_BARRIER);
    LAW("which is large here", drawn->farther == WARM_BARRIER);
    LAW("it does", mbs_stages_start_farther(drawn, p) == 1 && p->mu == WARM_BARRIER && drawn->farther == 0);
    LAW("once", mbs_stages_start_farther(drawn, p) == 0 && p->mu == WARM_BARRIER);
    drawn->farther = p->mu;
    LAW("and to a higher parameter alone", mbs_stages_start_farther(drawn, p) == 0 && drawn->farther == 0);
}

/* How far a warm start may begin, and how slacks take the multipliers of their rows. */
static void distances(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    const real y[2] = {-3, 2};
    mbs_stages_phase *p;
    int i;
    open_drawn(4, 0);
    let_hold();
    o.warm_start_init_point = 1, o.scaled = 0;
    for (i = 0; i < W; ++i)
        drawn->point.w[i] = held[i];
    base[1][1] += (real)1e-3;
    begin(&o);
    LAW("the square of the violation", fabs(drawn->farther - 1e-6) < 1e-12);
    base[1][5] -= 100, drawn->point.y[8] = 1, drawn->point.y[9] = y[0]; /* the second row of g: beyond its bounds */
    g_least[3] = -2, g_most[3] = 3;
    p = begin(&o);
    LAW("a slack's lower bound takes a negative multiplier", fabs(p->zl[W + 3] - 3) < 1e-6);
    base[1][5] += 200, drawn->point.y[9] = y[1];
    p = begin(&o);
    LAW("the upper one a positive one", fabs(p->zu[W + 3] - 2) < 1e-6);
}

/* Callbacks without a result, in each stage. */
static void failures(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    int warm;
    for (failing = 1; failing <= 3; ++failing)
        for (failing_stage = 0; failing_stage < STAGES; ++failing_stage)
            for (warm = 0; warm < 3; ++warm) {
                mbs_stages_result r;
                open_drawn(4, 0);
                let_hold();
                o.warm_start_init_point = warm == 1, o.adaptive = warm == 2, o.scaled = warm != 1;
                r = mbs_stages_solve(drawn, &o);
                LAW("a solve ends where a callback has no result", r.status == MBS_STAGES_CALLBACK_FAILED);
                LAW("and names the stage", r.stage == failing_stage);
                LAW("at once", r.iterations == 0);
                LAW("the start knows it", mbs_stages_start(drawn) ==
                        (failing < 3 || warm == 2 ? MBS_STAGES_CALLBACK_FAILED : MBS_STAGES_RUNNING));
            }
    failing = 0;
}

static void barriers(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    open_drawn(4, 0);
    o.scaled = 0;
    LAW("the first barrier parameter is 0.1", near(begin(&o)->mu, (real)0.1));
    o.mu_init = (real)0.03;
    LAW("or the caller's", near(begin(&o)->mu, (real)0.03));
    o.mu_target = (real)0.5;
    LAW("no lower than the last", near(begin(&o)->mu, (real)0.5));
    LAW("which is in units of the cost", near(mbs_stages_least_barrier(drawn), (real)0.5));
    drawn->cost_scale = (real)0.25;
    LAW("scaled", near(mbs_stages_least_barrier(drawn), (real)0.125));
    drawn->options.mu_target = 0;
    LAW("or none", mbs_stages_least_barrier(drawn) == 0);
    o.mu_init = o.mu_target = 0, o.adaptive = 1;
    LAW("an affine step chooses another", begin(&o)->mu != (real)0.1 && drawn->main.mu >= MBS_STAGES_LOW && drawn->main.mu <= 100);
}

/* A number and its multipliers on the central path. */
static void central(void)
{
    real x[1], lower[1], upper[1], zl[1], zu[1];
    mbs_stages_phase p;
    memset(&p, 0, sizeof p);
    p.x = x, p.lower = lower, p.upper = upper, p.zl = zl, p.zu = zu, p.mu = (real)0.01;
    x[0] = 2, lower[0] = 1, upper[0] = 1e20, zl[0] = zu[0] = 0;
    mbs_stages_centre(&p, 0);
    LAW("a distance that is long stays", x[0] == 2 && near(zl[0], 0.01) && zu[0] == 0);
    zl[0] = 5, x[0] = 1 + (real)1e-6;
    mbs_stages_centre(&p, 0);
    LAW("a strong multiplier sets its distance", near(x[0] - 1, 0.002) && fabs(zl[0] - 5) < 1e-9);
    zl[0] = (real)1e-3, x[0] = 0;
    mbs_stages_centre(&p, 0);
    LAW("a weak one is the root of the parameter", near(x[0], 1.1) && fabs(zl[0] - 0.1) < 1e-9);
    zl[0] = 0, lower[0] = -1e20, upper[0] = 3, x[0] = 3 - (real)1e-6, zu[0] = 5;
    mbs_stages_centre(&p, 0);
    LAW("above, too", fabs(3 - x[0] - 0.002) < 1e-12 && fabs(zu[0] - 5) < 1e-9 && zl[0] == 0);
    lower[0] = 0, upper[0] = (real)0.1, x[0] = (real)0.01, zl[0] = (real)0.01, zu[0] = 0;
    mbs_stages_centre(&p, 0);
    LAW("between bounds no distance is above half of the room", near(x[0], 0.05) && near(zl[0], 0.2) && near(zu[0], 0.2));
    lower[0] = 0, upper[0] = 1, x[0] = (real)0.75, zl[0] = zu[0] = 0;
    mbs_stages_centre(&p, 0);
    LAW("the nearer bound counts", x[0] == (real)0.75 && near(zu[0], 0.04) && near(zl[0], (real)0.01 / (real)0.75));
    x[0] = (real)0.25;
    mbs_stages_centre(&p, 0);
    LAW("on both sides", x[0] == (real)0.25 && near(zl[0], 0.04) && near(zu[0], (real)0.01 / (real)0.75));
    lower[0] = -1e20, upper[0] = 1e20, x[0] = 7, zl[0] = zu[0] = 0;
    mbs_stages_centre(&p, 0);
    LAW("without bounds nothing moves", x[0] == 7 && zl[0] == 0 && zu[0] == 0);
}

static mbs_stages_result solve(void)
{
    return mbs_stages_solve(drawn, NULL);
}

/* Bounds that are none, and scales. */
static void refusals(void)
{
    static const real wrong[][2] = {{2, 1}, {NAN, 1}, {0, NAN}, {1e19, 3e19}, {-3e19, -1e19}};
    mbs_stages_result r;
    size_t i;
    int k;
    for (i = 0; i < sizeof wrong / sizeof *wrong; ++i)
        for (k = 0; k < 2; ++k) {
            open_drawn(4, 0);
            (k ? w_lower : g_least)[k ? 5 : 2] = wrong[i][0], (k ? w_upper : g_most)[k ? 5 : 2] = wrong[i][1];
            r = solve();
            LAW("bounds must be bounds", r.status == MBS_STAGES_BAD_PROBLEM);
            LAW("or their stage is named", r.stage == 1);
        }
    open_drawn(4, 0);
    w_lower[6] = w_upper[6] = 0;
    r = solve();
    LAW("no further bounds become equal", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == 1);
    open_drawn(4, 0);
    g_least[2] = g_most[2] = 0;
    r = solve();
    LAW("of rows, too", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == 1);
    open_drawn(4, 0);
    w_lower[0] = -1, w_upper[0] = 1, let_hold();
    LAW("fewer may", solve().status == MBS_STAGES_SOLVED);
    for (i = 0; i < 4; ++i) {
        open_drawn(4, 0);
        w_scale[8] = i == 0 ? 0 : i == 1 ? -1 : i == 2 ? 1e19 : (real)NAN;
        r = solve();
        LAW("scales are positive numbers, of all stages", r.status == MBS_STAGES_BAD_PROBLEM && r.stage == -1);
    }
}

/* Scales that the caller leaves to the bounds. */
static void sizes_by_bounds(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    const real wanted[5] = {1, 1, 1, 7, 5};
    int i;
    open_drawn(4, 0);
    drawn_problem.scale = NULL;
    w_lower[4] = 0, w_upper[4] = 0, w_lower[6] = -7, w_upper[6] = 2, w_lower[7] = -1, w_upper[7] = 5;
    w_lower[4] = -2, w_upper[4] = 1e20;
    o.scale_by_bounds = 1;
    w_lower[8] = -3, w_upper[8] = 1e19;
    begin(&o);
    LAW("a bound of 1e19 is none", drawn->variable_scale[8] == 1);
    for (i = 3; i < 8; ++i)
        LAW("the larger of two bounds is a variable's size", drawn->variable_scale[i] == wanted[i - 3]);
    o.scale_by_bounds = 0;
    begin(&o);
    for (i = 0; i < W; ++i)
        LAW("by demand alone", drawn->variable_scale[i] == 1 && !drawn->has_units);
    o.scale_by_bounds = 1, drawn_problem.upper = NULL;
    begin(&o);
    LAW("where both are there", drawn->variable_scale[6] == 1);
    open_drawn(4, 0);
    w_lower[6] = -1e19, w_upper[7] = 1e19, w_scale[6] = w_scale[7] = 4;
    begin(&o);
    LAW("a bound of 1e19 is none in any scale", drawn->main.lower[6] <= -1e19 && drawn->main.upper[7] >= 1e19);
    LAW("and has no multiplier", drawn->main.zl[6] == 0 && drawn->main.zu[7] == 0 && drawn->main.zl[7] == 1);
}

/* A solution meets its conditions, in the caller's numbers. */
static void solutions(void)
{
    int turn, i, row;
    for (turn = 0; turn < 6; ++turn) {
        mbs_stages_result r;
        const mbs_stages_point *q;
        real cost = 0, worst = 0, slope_left = 0;
        int k, at = 0;
        open_drawn(4, turn % 2);
        if (turn % 3 == 1)
            w_lower[3] = -2, w_upper[3] = 2, g_least[0] = -1, g_most[0] = 1;
        for (i = 0; i < W; ++i)
            w_scale[i] = turn > 2 && i % 3 ? 4 : 1;
        if (turn > 3)
            linear[1][0][1] = -400, linear[2][2][0] = -300;
        let_hold();
        q = &drawn->point;
        r = solve();
        LAW("problems at random are solved", r.status == MBS_STAGES_SOLVED && r.stage == -1);
        for (k = 0; k < STAGES; at += count_variables(k++))
            cost += value_of(k, 0, q->w + at);
        LAW("the cost is the sum of all stages", fabs(cost - r.cost) < 1e-9 * fabs(cost));
        for (row = 0; row < ROWS; ++row) {
            const int s = slack_of(row);
            const real value = row_value(q->w, row), y = q->y[row];
            const real off = s < 0 ? fabs(value) : fmax(fmax(g_least[s] - value, value - g_most[s]), 0);
            worst = fmax(worst, off);
            LAW("rows hold", off < 1e-6);
            LAW("a multiplier pushes from a bound that binds", s < 0 || s == 0 || y > -1e-6 || value < g_least[s] + 1e-3);
            LAW("from either", s < 0 || s == 0 || y < 1e-6 || value > g_most[s] - 1e-3);
        }
        for (i = 0; i < W; ++i) {
            real left = cost_slope(q->w, i) - q->below[i] + q->above[i];
            for (row = 0; row < ROWS; ++row)
                left += q->y[row] * entry_of(q->w, row, i);
            slope_left = fmax(slope_left, fabs(left));
            LAW("numbers are within bounds", q->w[i] >= w_lower[i] - 1e-6 && q->w[i] <= w_upper[i] + 1e-6);
            LAW("multipliers of bounds are positive", q->below[i] >= 0 && q->above[i] >= 0);
            LAW("and belong to bounds that bind", q->below[i] < 1e-4 || q->w[i] < w_lower[i] + 1e-3);
            LAW("above, too", q->above[i] < 1e-4 || q->w[i] > w_upper[i] - 1e-3);
        }
        LAW("slopes of the Lagrangian vanish, of fixed numbers, too", slope_left < 1e-5);
        LAW("errors are in the caller's units", r.stationarity < 1e-5 && r.violation < 1e-6 && r.complementarity < 1e-6);
        LAW("and count what is left", r.barrier > 0 && r.barrier < 1e-7 && r.evaluations > r.iterations);
    }
}

/* Errors at the first point are errors of the caller's functions. */
static void first_errors(void)
{
    mbs_stages_options o = mbs_stages_default_options();
    mbs_stages_result r;
    const mbs_stages_point *q;
    real worst = 0, most = 0;
    int i, row;
    open_drawn(4, 0);
    for (i = 0; i < W; ++i)
        w_scale[i] = i % 3 ? 4 : (real)0.5;
    linear[1][0][1] = -4000, linear[2][2][0] = -700, linear[0][0][0] = 90000, w_lower[0] = -1;
    guess(1);
    o.max_iter = 0, o.bound_relax_factor = 0;
    drawn->exact = drawn->unhelped = drawn->is_sharper = drawn->softer = drawn->live = drawn->ready = 7;
    drawn->softening = MBS_STAGES_SOFTENED, drawn->cost_before = 7;
    r = mbs_stages_solve(drawn, &o), q = &drawn->point;
    LAW("a solve may stop at once", r.status == MBS_STAGES_ITERATION_LIMIT && r.iterations == 0);
    LAW("and forgets the solve before", !drawn->exact && !drawn->unhelped && !drawn->is_sharper && !drawn->softer);
    LAW("in real time, too", !drawn->live && !drawn->ready && drawn->softening == MBS_STAGES_HARD);
    LAW("and its cost", fabs(drawn->cost_before - fabs(r.cost) * drawn->cost_scale) < 1e-9 * drawn->cost_before);
    for (row = 0; row < ROWS; ++row) {
        const real slack = slack_of(row) < 0 ? 0 : drawn->main.x[W + slack_of(row)] / drawn->row_scale[row];
        const real left = fabs(row_value(q->w, row) - slack);
        worst = fmax(worst, left);
    }
    LAW("the violation is unscaled", fabs(r.violation - worst) < 1e-8 * worst);
    for (i = 0; i < W; ++i) {
        real left = cost_slope(q->w, i) - q->below[i] + q->above[i];
        for (row = 0; row < ROWS; ++row)
            left += q->y[row] * entry_of(q->w, row, i);
        most = drawn->fixed[i] ? most : fmax(most, fabs(left));
        LAW("fixed numbers have the multipliers that are left",
            !drawn->fixed[i] || (fabs(left) < 1e-9 * 4000 && q->below[i] * q->above[i] == 0));
    }
    LAW("so is stationarity", fabs(r.stationarity - most) < 1e-9 * most);
}

/* Each stage takes the next one's numbers, where sizes are equal. */
static void shifts(void)
{
    int i;
    open_drawn(4, 0);
    for (i = 0; i < W; ++i)
        drawn->point.w[i] = i, drawn->point.below[i] = 100 + i, drawn->point.above[i] = 200 + i;
    for (i = 0; i < ROWS; ++i)
        drawn->point.y[i] = i;
    for (i = 0; i < S; ++i)
        drawn->slack[i] = i, drawn->slack_below[i] = 10 + i, drawn->slack_above[i] = 20 + i;
    mbs_stages_shift(drawn);
    for (i = 0; i < W; ++i) {
        const int from = i < 4 ? i + 4 : i < 6 ? i + 4 : i; /* the last stage has one v, the others two */
        LAW("numbers move ahead", drawn->point.w[i] == from);
        LAW("with their bounds' multipliers", drawn->point.below[i] == 100 + from && drawn->point.above[i] == 200 + from);
    }
    for (i = 0; i < ROWS; ++i) { /* rows: e d d g g | e d d g g | e g */
        const int from = i <= 5 ? i + 5 : i;
        LAW("multipliers move where there are as many", drawn->point.y[i] == from);
    }
    for (i = 0; i < S; ++i) {
        const int from = i < 2 ? i + 2 : i;
        LAW("slacks, too", drawn->slack[i] == from);
        LAW("with their multipliers", drawn->slack_below[i] == 10 + from && drawn->slack_above[i] == 20 + from);
    }
}

int main(void)
{
    scales(1), scales(0), small_units(), points(0), points(1), warmth(), distances(), failures(), barriers(), central(), refusals(), sizes_by_bounds();
    solutions(), first_errors(), shifts();
    close_drawn();
    return broken > 0;
}

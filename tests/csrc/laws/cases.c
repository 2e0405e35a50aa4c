/* A stack of cases: each is solved with its own row of every number, and its end is written to its own row. */
#define _POSIX_C_SOURCE 199309L

#include <stdio.h>
#include <string.h>
#include <time.h>

static double wall = 5, own = 7; /* s */

static int tick(clockid_t clock, struct timespec *t)
{
    const double now = clock == CLOCK_MONOTONIC ? wall : own;
    t->tv_sec = (time_t)now, t->tv_nsec = (long)(1e9 * (now - (double)t->tv_sec));
    return 0;
}

#define clock_gettime tick
#include "../../../csrc/cases/mbs_cases.c"

static int broken;

#define LAW(text, condition) ((condition) ? (void)0 : (void)(++broken, printf("%s: %s\n", text, #condition)))

enum { CASES = 4, GIVEN = 3, VARIABLES = 2, ROWS = 1 };

static mbs_stages_real w[VARIABLES], y[ROWS], below[VARIABLES], above[VARIABLES];
static mbs_stages_real parameters[GIVEN], lower[VARIABLES], upper[VARIABLES], least[ROWS], most[ROWS], scale[VARIABLES];
static mbs_timed_program timed;
static int solves, limits[CASES];
static mbs_stages_options options;

mbs_stages_point mbs_stages_iterate(const mbs_stages *s)
{
    const mbs_stages_point p = {.w = w, .y = y, .below = below, .above = above, .variables = VARIABLES, .rows = ROWS};
    (void)s;
    return p;
}

/* A sum of all that is given, with a factor for each entry; then the point moves on. */
mbs_stages_result mbs_stages_solve(mbs_stages *s, const mbs_stages_options *o)
{
    mbs_stages_result r;
    (void)s;
    memset(&r, 0, sizeof r);
    limits[solves++ % CASES] = o->max_iter;
    r.status = solves % 2 ? MBS_STAGES_SOLVED : MBS_STAGES_INFEASIBLE;
    r.iterations = (int)(parameters[0] + 2 * parameters[2] + 3 * lower[1] + 5 * upper[0] + 7 * least[0] + 11 * most[0]
                         + 13 * scale[1] + 17 * w[1] + 19 * y[0] + 23 * below[0] + 29 * above[1]);
    w[0] = 1000 + r.iterations, y[0] = 2000, below[1] = 3000, above[0] = 4000;
    timed.seconds += 0.5, wall += 3.75, own += 2.5;
    return r;
}

static mbs_stages_real given[6][CASES * GIVEN], point[4][CASES * VARIABLES];
static int status[CASES], iterations[CASES];
static double seconds[CASES], evaluating[CASES], cpu_seconds[CASES];

int main(void)
{
    static const int tighter[CASES] = {0, 3, 50, 7};
    const mbs_cases_worker worker = {NULL, &options, &timed, GIVEN, VARIABLES, ROWS, parameters, lower, upper, least, most, scale};
    const mbs_cases_stack stack = {given[0], given[1], given[2], given[3], given[4], given[5],
                                   point[0], point[1], point[2], point[3], tighter, status, iterations,
                                   seconds, evaluating, cpu_seconds};
    int i, k;
    for (k = 0; k < 6; ++k)
        for (i = 0; i < CASES * GIVEN; ++i)
            given[k][i] = 100 * k + i;
    for (k = 0; k < 4; ++k)
        for (i = 0; i < CASES * VARIABLES; ++i)
            point[k][i] = 1000 * k + i;
    for (i = 0; i < CASES; ++i)
        status[i] = iterations[i] = -1, seconds[i] = evaluating[i] = cpu_seconds[i] = -1;
    options.max_iter = 20;
    mbs_cases_solve(&worker, &stack, 1, CASES);
    LAW("cases before the part are left", status[0] == -1 && iterations[0] == -1 && seconds[0] == -1 && evaluating[0] == -1
        && cpu_seconds[0] == -1 && point[0][0] == 0 && point[1][0] == 1000 && point[2][1] == 2001 && point[3][0] == 3000);
    LAW("all others are solved", solves == CASES - 1);
    for (i = 1; i < CASES; ++i) {
        const int expected = 3 * i + 2 * (3 * i + 2) + 3 * (100 + 2 * i + 1) + 5 * (200 + 2 * i) + 7 * (300 + i)
            + 11 * (400 + i) + 13 * (500 + 2 * i + 1) + 17 * (2 * i + 1) + 19 * (1000 + i) + 23 * (2000 + 2 * i)
            + 29 * (3000 + 2 * i + 1);
        LAW("with the numbers of the row", iterations[i] == expected);
        LAW("the end is in the row", point[0][2 * i] == 1000 + expected && point[0][2 * i + 1] == 2 * i + 1
            && point[1][i] == 2000 && point[2][2 * i] == 2000 + 2 * i && point[2][2 * i + 1] == 3000
            && point[3][2 * i] == 4000 && point[3][2 * i + 1] == 3000 + 2 * i + 1);
        LAW("with its status", status[i] == (i % 2 ? (int)MBS_STAGES_SOLVED : (int)MBS_STAGES_INFEASIBLE));
        LAW("the time of its functions alone", evaluating[i] == 0.5);
        LAW("and its times", seconds[i] == 3.75 && cpu_seconds[i] == 2.5);
    }
    LAW("a limit of steps may be tighter", limits[0] == 3 && limits[2] == 7);
    LAW("not wider", limits[1] == 20 && options.max_iter == 20);
    mbs_cases_solve(&worker, &stack, 0, 1);
    LAW("0 is no limit", limits[3] == 20 && status[0] == MBS_STAGES_INFEASIBLE);
    return broken > 0;
}

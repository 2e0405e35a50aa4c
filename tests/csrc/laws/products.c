#include "laws.h"

#include "../../../csrc/stages/products.c"

enum { SIZE = 4 };

/* Stand-ins: the corrected step's own part, and the lengths of both steps. */
static struct {
    real dx[SIZE], dy[2], length, corrected; /* of the step that is there, and of the other */
    real slope[SIZE], c[2];                  /* as the equations were asked for */
    int solved, barrier;
} given;

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s;
    ++given.solved;
    memcpy(given.slope, p->slope, sizeof given.slope), memcpy(given.c, c, sizeof given.c);
    memcpy(d->x, given.dx, sizeof given.dx), memcpy(d->y, given.dy, sizeof given.dy);
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    int i;
    (void)s, (void)p;
    given.barrier = barrier;
    for (i = 0; i < SIZE; ++i)
        out[i] = 77;
}

real mbs_stages_boundary(const mbs_stages *s, const mbs_stages_phase *p, const real *x, const real *dx, real tau)
{
    (void)s;
    LAW("lengths are asked to the bounds", x == p->x && tau == p->tau);
    return dx == p->other.x ? given.corrected : given.length;
}

/* Variable 0 has both bounds, 1 a lower one, 2 an upper one, 3 is fixed. */
static mbs_stages solver;
static mbs_stages_phase phase;
static char fixed[SIZE] = {0, 0, 0, 1};
static real x[SIZE], lower[SIZE], upper[SIZE], zl[SIZE], zu[SIZE], slope[SIZE], rows[2], step[4][SIZE], other[4][SIZE];

static void anew(void)
{
    static const real at[SIZE] = {3, 2, 1, 5}, below[SIZE] = {1, 1.5, -1e20, 4}, above[SIZE] = {7, 1e20, 3, 6};
    static const real by[SIZE] = {-1, 0.5, 1, 1}, left[SIZE] = {-0.012, 0.03, 9, 9}, right[SIZE] = {0.013, 9, 0.003, 9};
    static const mbs_stages_phase none;
    int i;
    phase = none;
    phase.size = SIZE, phase.mu = 1e-3, phase.tau = 0.99;
    phase.x = x, phase.lower = lower, phase.upper = upper, phase.zl = zl, phase.zu = zu, phase.slope = slope;
    phase.soc_c = rows;
    phase.step = (mbs_stages_direction){step[0], step[1], step[2], step[3]};
    phase.other = (mbs_stages_direction){other[0], other[1], other[2], other[3]};
    solver.rows = 2, solver.fixed = fixed;
    for (i = 0; i < SIZE; ++i) {
        x[i] = at[i], lower[i] = below[i], upper[i] = above[i], zl[i] = 0.25, zu[i] = 0.5;
        step[0][i] = by[i], step[1][i] = left[i], step[2][i] = right[i], step[3][i] = i < 2 ? 10 : 77;
        given.dx[i] = 0.125 * (i + 1), other[0][i] = other[1][i] = other[2][i] = other[3][i] = slope[i] = 99;
    }
    given.dy[0] = 4, given.dy[1] = 5, rows[0] = rows[1] = 99;
    given.length = 0.5, given.corrected = 0.6, given.solved = 0, given.barrier = -1;
}

/* Products that lack something, and good ones: from a tenth of mu to ten times mu. */
static void lacks(void)
{
    LAW("small products lack something to a tenth", near(lack(0.05, 1), 0.05) && near(lack(-3, 1), 3.1));
    LAW("good ones nothing", lack(0.1001, 1) == 0 && lack(9.999, 1) == 0 && lack(2, 2) == 0);
    LAW("large ones have too much", near(lack(12, 1), -2) && near(lack(25, 2), -5));
    LAW("of which as much is taken off at most", near(lack(31, 1), -10) && near(lack(19, 1), -9));
    LAW("all beside mu", near(lack(0.05, 0.7), 0.02));
}

/* The products after the whole corrected step, to the first order: mu, and what each lacked. */
static void corrects(void)
{
    real below[SIZE], above[SIZE];
    int i;
    anew();
    for (i = 0; i < SIZE; ++i) {
        below[i] = i < 2 ? lack(1e-3 + step[0][i] * step[1][i], 1e-3) : 0;
        above[i] = i == 0 || i == 2 ? lack(1e-3 - step[0][i] * step[2][i], 1e-3) : 0;
        LAW("a lower bound alone has a product below", lack_below(&solver, &phase, i) == below[i]);
        LAW("and an upper one above", lack_above(&solver, &phase, i) == above[i]);
    }
    LAW("there is something to correct", below[0] < 0 && below[1] < 0 && above[0] < 0 && above[2] > 0);
    find_corrected(&solver, &phase, &phase.other);
    for (i = 0; i < SIZE; ++i) {
        const real distance[2] = {x[i] - lower[i], upper[i] - x[i]}, d = given.dx[i];
        LAW("lacks are forces", near(given.slope[i], -below[i] / distance[0] + above[i] / distance[1]));
        LAW("a correction is added to the step", near(other[0][i], step[0][i] + d));
        if (i < 2)
            LAW("products below change by what they lack",
                near(distance[0] * (other[1][i] - step[1][i]) + zl[i] * d, below[i]));
        else
            LAW("without a bound there is none", other[1][i] == 0);
        if (i == 0 || i == 2)
            LAW("products above too", near(distance[1] * (other[2][i] - step[2][i]) - zu[i] * d, above[i]));
        else
            LAW("nor above", other[2][i] == 0);
        LAW("the slope is found again", slope[i] == 77);
    }
    LAW("with the barrier", given.barrier == 1);
    LAW("rows ask for nothing", given.c[0] == 0 && given.c[1] == 0);
    LAW("multipliers are added", other[3][0] == 14 && other[3][1] == 15 && other[3][2] == 99);
}

static int is_taken(void)
{
    const real *was = phase.step.x, *its = phase.other.zl, *y = phase.other.y;
    mbs_stages_correct_products(&solver, &phase);
    LAW("a step is taken as a whole",
        (phase.step.x != was) == (phase.step.zl == its) && (phase.step.x != was) == (phase.step.y == y));
    LAW("and the other one is kept", (phase.step.x != was) == (phase.other.x == was));
    return phase.step.x != was;
}

static void decides(void)
{
    anew();
    given.length = 0.25, given.corrected = 0.25 + CORRECTION_GAIN;
    LAW("a correction must lengthen the step by a tenth", is_taken());
    anew();
    given.length = 0.25, given.corrected = 0.24 + CORRECTION_GAIN;
    LAW("not less", !is_taken() && given.solved == 1);
    anew();
    given.length = CORRECTED_SHORT, given.corrected = 2;
    LAW("a step that is long stays", !is_taken() && given.solved == 0);
    anew();
    given.length = 0.99 * CORRECTED_SHORT, given.corrected = 1;
    LAW("a shorter one is corrected", is_taken());
    anew();
    phase.mu = CORRECTED_BELOW;
    LAW("the barrier parameter must be low", is_taken());
    anew();
    phase.mu = 1.01 * CORRECTED_BELOW;
    LAW("before, all stays", !is_taken() && given.solved == 0);
    anew();
    phase.elastic = 1;
    LAW("restoration is left alone", !is_taken() && given.solved == 0);
    anew();
    phase.soft = 1;
    LAW("steps that lower errors alone", !is_taken() && given.solved == 0);
    anew();
    phase.watchdog.active = 1;
    LAW("a watchdog's", !is_taken() && given.solved == 0);
    anew();
    phase.added = 1e-9;
    LAW("and steps with added curvature", !is_taken() && given.solved == 0);
}

int main(void)
{
    lacks();
    corrects();
    decides();
    return broken > 0;
}

#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/mbs_cone.c"
#include "../../../csrc/mbs_dense.c"

/* A push, and a contact that slides obliquely: by its W, impulses and speeds a solution of which all is known. */
static const casadi_int kind[2] = {MBS_PUSH, MBS_TOUCH}, first[2] = {0, 1};
static const casadi_real grip[2] = {0, 0.5}, W[16] = {3, 1, 0.5, -0.2, 1, 2, 0.3, 0.1, 0.5, 0.3, 5, -1, -0.2, 0.1,
    -1, 4};
static const casadi_real solution[4] = {2, 10, -3, -4}, speed[4] = {0, 0, 0.6, 0.8};

/* The largest difference between the matrix at P and differences of the residual. */
static casadi_real compare(mbs_solver *s, casadi_real *P)
{
    const casadi_int n = s->p->rows;
    const casadi_real step = 1e-6;
    casadi_real matrix[16], ahead[4], most = 0;
    casadi_int i, k;
    measure(s, P);
    differentiate(s, P);
    for (i = 0; i < n * n; ++i)
        matrix[i] = s->matrix[i];
    for (k = 0; k < n; ++k) {
        P[k] += step;
        measure(s, P);
        for (i = 0; i < n; ++i)
            ahead[i] = s->gap[i];
        P[k] -= 2 * step;
        measure(s, P);
        for (i = 0; i < n; ++i)
            most = fmax(most, fabs((ahead[i] - s->gap[i]) / (2 * step) - matrix[i * n + k]));
        P[k] += step;
    }
    return most;
}

/* Two pushes at one place: each answers for the other. */
static void repeat_a_push(void)
{
    static const casadi_int kinds[2] = {MBS_PUSH, MBS_PUSH}, firsts[2] = {0, 1};
    static const casadi_real grips[2] = {0, 0}, ones[4] = {1, 1, 1, 1}, free_speed[2] = {-2, -2};
    casadi_real P[2] = {1, 1}, room[6 * 2 + 4];
    casadi_int pivots[2];
    const mbs_cone problem = {2, 2, kinds, firsts, grips, ones, free_speed};
    mbs_solver s = {&problem, 0, SHIFT[0], room, room + 2, room + 4, room + 6, room + 8, room + 10, room + 12, pivots};
    scale(&s, P);
    measure(&s, P);
    differentiate(&s, P);
    LAW("rows that repeat others leave the matrix positive definite",
        s.matrix[0] * s.matrix[3] > s.matrix[1] * s.matrix[2] * (1 + 1e-8));
}

/* --- a brake, a contact, a push and a contact: eight rows,
    with a solution of which all is known ----------------------- */

enum { ROWS = 8, BLOCKS = 4 };
static const casadi_int kinds[BLOCKS] = {MBS_BRAKE, MBS_TOUCH, MBS_PUSH, MBS_TOUCH}, firsts[BLOCKS] = {0, 1, 4, 5};
static casadi_real grips[BLOCKS], matrix_of[ROWS * ROWS], freed[ROWS], wanted[ROWS], velocity[ROWS];
static const mbs_cone all = {ROWS, BLOCKS, kinds, firsts, grips, matrix_of, freed};
static casadi_real *reals;
static casadi_int *integers;
static unsigned seed;

static casadi_real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (casadi_real)(seed / 65536 % 2001) / 1000 - 1;
}

/* Open the method in a room of exactly the numbers that are asked for. */
static mbs_solver open_here(const mbs_cone *p)
{
    const casadi_int n = p->rows;
    mbs_solver s;
    free(reals), free(integers);
    reals = malloc((size_t)mbs_cone_reals(n) * sizeof *reals),
        integers = malloc((size_t)mbs_cone_integers(n) * sizeof *integers);
    s.p = p, s.scale = 0, s.rho = reals, s.w = reals + n, s.gap = reals + 2 * n, s.trial = reals + 3 * n;
    s.best = reals + 4 * n, s.kept = reals + 5 * n, s.matrix = reals + 6 * n, s.pivots = integers, s.shift = SHIFT[0];
    return s;
}

/* Draw a problem: a root of W, then modes of all blocks, impulses and velocities that belong to them. */
static void draw_problem(void)
{
    casadi_real root[ROWS * ROWS];
    casadi_int i, j, k;
    for (i = 0; i < ROWS * ROWS; ++i)
        root[i] = draw() + (i % (ROWS + 1) == 0 ? 2 : 0);
    for (i = 0; i < ROWS; ++i)
        for (j = 0; j < ROWS; ++j)
            for (k = 0, matrix_of[i * ROWS + j] = 0; k < ROWS; ++k)
                matrix_of[i * ROWS + j] += root[i * ROWS + k] * root[j * ROWS + k];
    for (k = 0; k < BLOCKS; ++k) {
        const casadi_int r = firsts[k];
        const casadi_real choice = draw(), size = 1 + draw(), angle = 3 * draw();
        grips[k] = 0.75 + draw() / 2;
        for (i = r; i < ROWS && i < r + 3; ++i)
            wanted[i] = velocity[i] = 0;
        if (kinds[k] == MBS_BRAKE) {
            wanted[r] = fabs(choice) < 0.3 ? choice * grips[k] : choice > 0 ? grips[k] : -grips[k];
            velocity[r] = fabs(choice) < 0.3 ? 0 : choice > 0 ? -size : size;
            continue;
        }
        wanted[r] = choice > -0.4 ? 0.5 + size : 0, velocity[r] = choice > -0.4 ? 0 : size;
        if (kinds[k] != MBS_TOUCH)
            continue;
        for (i = 0; i < 2; ++i) {
            const casadi_real axis = i ? sin(angle) : cos(angle);
            wanted[r + 1 + i] = grips[k] * wanted[r] * axis * (choice > 0.2 ? 1 : 0.5);
            velocity[r + 1 + i] = choice > 0.2 || choice <= -0.4 ? -size * axis : 0;
        }
    }
    for (i = 0; i < ROWS; ++i)
        for (k = 0, freed[i] = velocity[i]; k < ROWS; ++k)
            freed[i] -= matrix_of[i * ROWS + k] * wanted[k];
}

static casadi_real differ(const casadi_real *a, const casadi_real *b)
{
    casadi_real most = 0;
    casadi_int i;
    for (i = 0; i < ROWS; ++i)
        most = fmax(most, fabs(a[i] - b[i]));
    return most;
}

static void parts(void)
{
    casadi_real t[2] = {3, -4};
    LAW("there is room for six vectors and a matrix", mbs_cone_reals(3) == 27 && mbs_cone_integers(3) == 3);
    LAW("numbers within a bound stay", clip(0.5, 2) == 0.5 && clip(-2, 2) == -2);
    LAW("others are put on it", clip(3, 2) == 2 && clip(-3, 2) == -2);
    shorten(6, t);
    LAW("a vector that is short stays", t[0] == 3 && t[1] == -4);
    shorten(2.5, t);
    LAW("a longer one is shortened", t[0] == 1.5 && t[1] == -2);
    t[0] = t[1] = 0, shorten(0, t);
    LAW("one of no length has none", t[0] == 0 && t[1] == 0);
}

/* A push and a contact, by hand: across the normal (5 3; 3 -3) has the eigenvalues 6 and -4. */
static void scales(void)
{
    static const casadi_int kind_of[2] = {MBS_PUSH, MBS_TOUCH}, first_of[2] = {0, 1};
    static const casadi_real grip_of[2] = {0, 0.5};
    casadi_real w[16] = {0.5, 7, 7, 7, 7, 4, 7, 7, 7, 7, 5, 3, 7, 7, 3, -3}, free_of[4] = {2, -20, 3, 0}, P[4] = {0,
        0, 0, 0};
    const mbs_cone p = {4, 2, kind_of, first_of, grip_of, w, free_of};
    mbs_solver s = open_here(&p);
    scale(&s, P);
    LAW("normals have the inverse of their own entry", s.rho[0] == 2 && s.rho[1] == 0.25);
    LAW("friction has one of the largest change in its plane", fabs(s.rho[2] * 6 - 1) < 1e-15 && s.rho[2] == s.rho[3]);
    LAW("impulses have the size that stops all", s.scale == 5);
    P[3] = -8;
    scale(&s, P);
    LAW("or that of the guess", s.scale == 8);
    P[3] = 0, P[0] = 9, w[0] = 1e-20;
    scale(&s, P);
    LAW("any of it", s.scale == 4e11 && s.rho[0] == 1 / (1e-12 * 5));
    w[0] = 0.5, w[10] = w[11] = w[14] = w[15] = 0, free_of[0] = free_of[2] = 0, P[0] = 0;
    scale(&s, P);
    LAW("what cannot be moved is judged beside the others", s.rho[2] == 1 / (1e-12 * 4));
    LAW("by the largest of the diagonal", s.scale == 5);
    memset(w, 0, sizeof w), free_of[1] = -3;
    scale(&s, P);
    LAW("or alone", s.rho[0] == 1 && s.scale == 3);
    w[0] = 0.25;
    scale(&s, P);
    LAW("the first counts", s.rho[1] == 4e12);
    free_of[0] = 0.0625, free_of[1] = 0;
    scale(&s, P);
    LAW("small impulses have a small size", s.scale == 0.25);
}

/* A contact alone: across the normal (5 3; 3 -3). */
static void scale_one(void)
{
    static const casadi_int kind_of[1] = {MBS_TOUCH}, first_of[1] = {0};
    static const casadi_real grip_of[1] = {0.5}, w[9] = {4, 7, 7, 7, 5, 3, 7, 3, -3}, free_of[3] = {0, 0, 0};
    const casadi_real P[3] = {0, 0, 0};
    const mbs_cone p = {3, 1, kind_of, first_of, grip_of, w, free_of};
    mbs_solver s = open_here(&p);
    scale(&s, P);
    LAW("the first block may be a contact", s.rho[0] == 0.25 && fabs(s.rho[1] * 6 - 1) < 1e-15 && s.rho[2] == s.rho[1]);
}

/* Residuals of unit masses: velocities are impulses and more. */
static void residuals(void)
{
    casadi_real P[ROWS] = {0.5, 2, 1, 0, 0.25, 0, 0, 0};
    casadi_int i;
    mbs_solver s = open_here(&all);
    memset(matrix_of, 0, sizeof matrix_of);
    for (i = 0; i < ROWS; ++i)
        matrix_of[i * (ROWS + 1)] = 2, s.rho[i] = 0.5, freed[i] = 0;
    grips[0] = 1, grips[1] = 0.5, grips[3] = 10;
    freed[0] = 4, freed[1] = -3, freed[2] = -6, freed[3] = 8, freed[4] = -0.25, freed[5] = 4, freed[6] = 1;
    /* P - w/2 is -free/2: brake -2, on -1; normal 1.5; friction (3, -4), on 0.75 (0.6, -0.8); push 1/8; the last -2 */
    LAW("the largest residual is returned", measure(&s, P) == 1.5);
    LAW("brakes are clipped", s.gap[0] == 1.5);
    LAW("contacts push", s.gap[1] == 0.5 && s.gap[5] == 0);
    LAW("and rub by their normal part", fabs(s.gap[2] - 0.55) < 1e-15 && fabs(s.gap[3] - 0.6) < 1e-15 && s.gap[6] == 0);
    LAW("stops push", s.gap[4] == 0.125);
    LAW("velocities are of impulses", s.w[0] == 5 && s.w[2] == -4 && s.w[6] == 1);
    sweep(&s, P);
    LAW("a sweep finds impulses of unit masses",
        P[0] == -1 && P[1] == 1.5 && fabs(P[2] - 0.45) < 1e-15 && fabs(P[3] + 0.6) < 1e-15);
    LAW("each", P[4] == 0.125 && P[5] == 0 && P[6] == 0);
    P[0] = NAN;
    LAW("an unknown residual is infinite", measure(&s, P) == INFINITY);
    P[0] = 0, P[7] = NAN;
    LAW("anywhere", measure(&s, P) == INFINITY);
}

/* Random problems: the residual vanishes at the solution alone, is differentiated, and is made to vanish. */
static void solutions(void)
{
    casadi_real P[ROWS], ahead[ROWS], own[ROWS * ROWS], most, before;
    casadi_int i, k, turn, sweeps = 0, steps = 0;
    seed = 11;
    for (turn = 0; turn < 200 && !broken; ++turn) {
        mbs_cone_effort effort = {0, 0, 0};
        mbs_solver s = open_here(&all);
        draw_problem();
        memcpy(P, wanted, sizeof P);
        scale(&s, P);
        LAW("a solution has no residual", measure(&s, P) < 1e-13 * s.scale);
        sweep(&s, P);
        LAW("and stays", differ(P, wanted) < 1e-12);
        for (i = 0; i < ROWS; ++i)
            P[i] = wanted[i] + draw() * (turn % 2 ? 4 : 0.5);
        scale(&s, P), before = measure(&s, P), differentiate(&s, P);
        memcpy(own, s.matrix, sizeof own);
        for (k = 0, most = 0; k < ROWS; ++k) {
            P[k] += 1e-6, measure(&s, P), memcpy(ahead, s.gap, sizeof ahead), P[k] -= 2e-6, measure(&s, P),
                P[k] += 1e-6;
            for (i = 0; i < ROWS; ++i)
                most = fmax(most, fabs((ahead[i] - s.gap[i]) / 2e-6 - own[i * ROWS + k]));
        }
        LAW("the matrix is the residual's derivative, but for a shift", most < 2e-7);
        most = iterate(&s, P, before, &effort);
        LAW("steps make a residual smaller", most <= before);
        LAW("and return it", fabs(measure(&s, P) - most) <= 1e-14 * s.scale);
        for (i = 0; i < ROWS; ++i)
            P[i] = draw() * 10;
        before = measure(&s, P);
        most = leap(&s, P, 1, before, &effort);
        LAW("whole steps keep the best place", most <= before && fabs(measure(&s, P) - most) <= 1e-14 * s.scale);
        most = leap(&s, P, 0, 0.5 * most, &effort);
        LAW("or the one before, from nothing too", fabs(measure(&s, P) - most) <= 1e-14 * s.scale || most > 0);
        for (i = 0; i < ROWS; ++i)
            P[i] = wanted[i] * (1 + 1e-3 * draw());
        effort.steps = effort.sweeps = 0;
        LAW("a good guess needs no sweeps",
            mbs_cone_solve(&all, 1e-2, P, &effort, reals, integers) == 0 && effort.sweeps == 0);
        LAW("and few steps", effort.steps < 4);
        LAW("to rounding, whatever is asked", differ(P, wanted) < 1e-9 && effort.residual < 1e-12);
        for (i = 0; i < ROWS; ++i)
            P[i] = draw() * 10;
        LAW("any guess leads to a solution", mbs_cone_solve(&all, 1e-10, P, &effort, reals, integers) == 0);
        LAW("to rounding", effort.residual < 1e-12); /* friction may have several */
        sweeps += effort.sweeps, steps += effort.steps;
        i = effort.steps;
        mbs_cone_solve(&all, 1e-10, P, &effort, reals, integers);
        LAW("a solution needs nothing", effort.steps <= i + 1);
    }
    LAW("by few steps and sweeps", steps < 1700 && sweeps < 200);
}

/* A push that nothing answers: each sweep adds what is free, each step of Newton's method fails. */
static void endless(void)
{
    static const casadi_int kind_of[1] = {MBS_PUSH}, first_of[1] = {0};
    static const casadi_real grip_of[1] = {0}, w[1] = {0};
    casadi_real free_of[1] = {-0.25}, P[1] = {0}, room[7];
    const mbs_cone p = {1, 1, kind_of, first_of, grip_of, w, free_of};
    mbs_cone_effort effort = {0, 0, 0};
    casadi_int pivot[1];
    LAW("a problem without solution ends", mbs_cone_solve(&p, 1e-9, P, &effort, room, pivot) == 1);
    LAW("after sixty rounds, ten sweeps more in each", effort.steps == 60 + 59 * 2 * SHIFTS * LEAPS && effort.sweeps == 10 * (60 * 61 / 2 - 1));
    LAW("with its residual beside impulses", fabs(effort.residual * 18290 - 1) < 1e-12 && P[0] == 0.25 * 18290);
    P[0] = 0, effort.sweeps = effort.steps = 0;
    LAW("which may be enough", mbs_cone_solve(&p, 1e-4, P, &effort, room, pivot) == 0);
    LAW("from the fifth round",
        effort.sweeps > 10 * (2 + 3 + 4) && effort.sweeps < 18290 && fabs(effort.residual * P[0] * 4 - 1) < 1e-12);
    P[0] = 0, effort.sweeps = 0;
    LAW("and in the first ones is not",
        mbs_cone_solve(&p, 0.5, P, &effort, room, pivot) == 0 && effort.sweeps == 10 * (2 + 3 + 4 + 5));
    free_of[0] = 0, P[0] = 0;
    effort.steps = effort.sweeps = 0;
    LAW("nothing needs nothing",
        mbs_cone_solve(&p, 1e-9, P, &effort, room, pivot) == 0 && effort.steps + effort.sweeps == 0);
    LAW("without residual", effort.residual == 0 && P[0] == 0);
}

int main(void)
{
    casadi_real free_speed[4], P[4], room[6 * 4 + 16], most;
    casadi_int pivots[4], i, k;
    const mbs_cone problem = {4, 2, kind, first, grip, W, free_speed};
    mbs_cone_effort effort = {0, 0, 0};
    mbs_solver s = {&problem, 0, SHIFT[0], room, room + 4, room + 8, room + 12, room + 16, room + 20, room + 24, pivots};
    for (i = 0; i < 4; ++i) {
        free_speed[i] = speed[i];
        for (k = 0; k < 4; ++k)
            free_speed[i] -= W[4 * i + k] * solution[k];
        P[i] = solution[i];
    }
    scale(&s, P);
    sweep(&s, P);
    for (i = 0, most = 0; i < 4; ++i)
        most = fmax(most, fabs(P[i] - solution[i]));
    LAW("a sweep leaves a solution as it is", most < 1e-14);
    LAW("it has no residual", measure(&s, P) < 1e-14);
    P[0] = 1, P[1] = 3, P[2] = 2, P[3] = -1;
    for (k = 0; k < 500; ++k)
        sweep(&s, P);
    for (i = 0, most = 0; i < 4; ++i)
        most = fmax(most, fabs(P[i] - solution[i]));
    LAW("sweeps alone find it", most < 1e-12);
    P[0] = 1, P[1] = 3, P[2] = 2, P[3] = -1;
    LAW("and so does the method", mbs_cone_solve(&problem, 1e-10, P, &effort, room, pivots) == 0);
    for (i = 0, most = 0; i < 4; ++i)
        most = fmax(most, fabs(P[i] - solution[i]));
    LAW("to rounding", most < 1e-12);
    P[0] = 1, P[1] = 3, P[2] = 2, P[3] = -1;
    scale(&s, P);
    LAW("the matrix of Newton's step is the residual's derivative where a contact slides", compare(&s, P) < 2e-7);
    P[0] = 1, P[1] = 30, P[2] = 0.1, P[3] = -0.2;
    LAW("and where it sticks", compare(&s, P) < 2e-7);
    P[0] = -20, P[1] = -30;
    LAW("and where nothing touches", compare(&s, P) < 2e-7);
    repeat_a_push(), parts(), scales(), scale_one(), residuals(), solutions(), endless();
    return broken > 0;
}

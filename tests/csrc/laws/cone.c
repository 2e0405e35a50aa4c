#include "laws.h"

#include <math.h>

#include "../../../csrc/mbs_cone.c"
#include "../../../csrc/mbs_dense.c"

/* A push, and a contact that slides obliquely: by its W, impulses and speeds a solution of which all is known. */
static const casadi_int kind[2] = {MBS_PUSH, MBS_TOUCH}, first[2] = {0, 1};
static const casadi_real grip[2] = {0, 0.5}, W[16] = {3, 1, 0.5, -0.2, 1, 2, 0.3, 0.1, 0.5, 0.3, 5, -1, -0.2, 0.1, -1, 4};
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
    casadi_real P[2] = {1, 1}, room[5 * 2 + 4];
    casadi_int pivots[2];
    const mbs_cone problem = {2, 2, kinds, firsts, grips, ones, free_speed};
    mbs_solver s = {&problem, 0, room, room + 2, room + 4, room + 6, room + 8, room + 10, pivots};
    scale(&s, P);
    measure(&s, P);
    differentiate(&s, P);
    LAW("rows that repeat others leave the matrix positive definite",
        s.matrix[0] * s.matrix[3] > s.matrix[1] * s.matrix[2] * (1 + 1e-8));
}

int main(void)
{
    casadi_real free_speed[4], P[4], room[5 * 4 + 16], most;
    casadi_int pivots[4], i, k;
    const mbs_cone problem = {4, 2, kind, first, grip, W, free_speed};
    mbs_cone_effort effort = {0, 0, 0};
    mbs_solver s = {&problem, 0, room, room + 4, room + 8, room + 12, room + 16, room + 20, pivots};
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
    repeat_a_push();
    return broken > 0;
}

#include "laws.h"

#include <math.h>

#include "../../../csrc/mbs_cone.c"
#include "../../../csrc/mbs_dense.c"

/* A push, and a contact that slides obliquely: by its W, impulses and speeds a solution of which all is known. */
static const casadi_int kind[2] = {MBS_PUSH, MBS_TOUCH}, first[2] = {0, 1};
static const casadi_real grip[2] = {0, 0.5}, W[16] = {3, 1, 0.5, -0.2, 1, 2, 0.3, 0.1, 0.5, 0.3, 5, -1, -0.2, 0.1, -1, 4};
static const casadi_real solution[4] = {2, 10, -3, -4}, speed[4] = {0, 0, 0.6, 0.8};

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
    return broken > 0;
}

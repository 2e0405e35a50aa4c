#include "laws.h"

#include "../../../csrc/mbs_stepping.c"

casadi_int mbs_cone_reals(casadi_int rows)
{
    return rows;
}

casadi_int mbs_cone_integers(casadi_int rows)
{
    return rows;
}

int mbs_cone_solve(const mbs_cone *p, casadi_real tolerance, casadi_real *P, mbs_cone_effort *effort,
                   casadi_real *reals, casadi_int *integers)
{
    (void)p, (void)tolerance, (void)P, (void)effort, (void)reals, (void)integers;
    return 0;
}

/* Count the struck rows of blocks of some kinds; the kind that follows is of an earlier step. */
static casadi_int struck(casadi_int blocks, casadi_int a, casadi_int b, casadi_int c, casadi_int later)
{
    casadi_int kind[4] = {a, b, c, later}, first[4], k, at = 0;
    mbs_stepper s;
    memset(&s, 0, sizeof s);
    s.blocks = blocks, s.kind = kind, s.first = first;
    for (k = 0; k < 4; ++k) {
        first[k] = at;
        at += kind[k] == MBS_TOUCH ? 3 : 1;
    }
    return count_struck(&s);
}

int main(void)
{
    LAW("nothing is struck where there is nothing", struck(0, MBS_TOUCH, MBS_TOUCH, MBS_TOUCH, MBS_TOUCH) == 0);
    LAW("nor are brakes", struck(2, MBS_BRAKE, MBS_BRAKE, MBS_TOUCH, MBS_TOUCH) == 0);
    LAW("a contact has three rows", struck(1, MBS_TOUCH, MBS_PUSH, MBS_PUSH, MBS_PUSH) == 3);
    LAW("a stop has one", struck(2, MBS_TOUCH, MBS_PUSH, MBS_TOUCH, MBS_TOUCH) == 4);
    LAW("brakes that follow are left out", struck(3, MBS_PUSH, MBS_TOUCH, MBS_BRAKE, MBS_PUSH) == 4);
    LAW("all of them", struck(3, MBS_TOUCH, MBS_BRAKE, MBS_BRAKE, MBS_PUSH) == 3);
    return broken > 0;
}

/* Swing a pendulum up with a torque that cannot hold it: least effort, 60 steps of Euler's method. */
#ifndef PENDULUM_H
#define PENDULUM_H

#include "mbs_stages.h"

enum { PENDULUM_INTERVALS = 60, PENDULUM_VARIABLES = 3 * PENDULUM_INTERVALS + 2 };
#define PENDULUM_STEP ((mbs_stages_real)0.06)

/* What the problem consists of; it must live as long as its solver. */
typedef struct {
    mbs_stages_problem problem;
    mbs_stages_size size[PENDULUM_INTERVALS + 1];
    mbs_stages_real lower[PENDULUM_VARIABLES], upper[PENDULUM_VARIABLES];
} pendulum;

/* Write the problem: from rest below, with torques up to `limit`. */
void pendulum_describe(pendulum *p, mbs_stages_real limit);

#endif

/* Laws of one file of the solver: the program includes the file, and prints each law that it breaks.
 *
 * Functions of other files are stand-ins where a law reaches them; the others stay unresolved. */
#ifndef LAWS_H
#define LAWS_H

#include "solver.h"

#include <stdio.h>
#include <string.h>

static int broken;

#define LAW(text, condition) ((condition) ? (void)0 : (void)(++broken, printf("%s: %s\n", text, #condition)))

static inline int near(real a, real b)
{
    const real size = real_abs(a) > real_abs(b) ? real_abs(a) : real_abs(b);
    return real_abs(a - b) <= 20 * MBS_STAGES_EPSILON * size;
}

#endif

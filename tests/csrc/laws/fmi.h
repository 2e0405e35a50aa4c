/* Small mechanisms with closed forms for the laws of FMI units, and a memory that can end.
 *
 * `guided`: x'' = -2 k x + u + 3 y + 5 y' + t, where k is a parameter and joint y is driven; it has the output x + 10 y.
 * `looped`: two coordinates without forces, and the loop y = 2 x. `led`: the same loop, where y is driven. */
#ifndef LAWS_FMI_H
#define LAWS_FMI_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define mbs_fmi_model (*present) /* which the laws choose */
#include "../../../csrc/fmi/mbs_fmi.h"

static int broken;

#define LAW(text, condition) ((condition) ? (void)0 : (void)(++broken, printf("%s: %s\n", text, #condition)))

static long left = -1; /* grants of memory; -1: any number */

static void *grant(size_t size)
{
    void *made = left == 0 ? NULL : malloc(size);
    left -= left > 0;
    if (made)
        memset(made, 0x55, size);
    return made;
}

static inline void *grant_zeros(size_t count, size_t size)
{
    void *made = grant(count * size);
    return made ? memset(made, 0, count * size) : NULL;
}

#define malloc grant
#define calloc grant_zeros

/* Places among the numbers of `guided`. */
enum { X, Y, XD, YD, U, YDD, CLOCK, K, DOUBLED, RATES, OUTPUT = RATES + 4, CLOSED, ALONE = CLOSED + 4, SLOPES, SIZE = SLOPES + 4 };

static int setups, evaluations; /* how many */
static double last = 1e9, widest = 1e9; /* the time until which accelerations are known, the end of loops that close */

static int prepare(mbs_real *x)
{
    ++setups;
    x[DOUBLED] = 2 * x[K];
    return x[K] < 0;
}

static int accelerate(mbs_real *x)
{
    ++evaluations;
    x[RATES + XD] = -x[DOUBLED] * x[X] + x[U] + 3 * x[Y] + 5 * x[YD] + x[CLOCK];
    x[RATES + YD] = x[YDD];
    return x[CLOCK] > last ? 7 : 0;
}

static int put_out(mbs_real *x)
{
    x[OUTPUT] = x[X] + 10 * x[Y];
    return x[X] == 77;
}

static int slope_by_states(mbs_real *x)
{
    x[SLOPES] = -x[DOUBLED], x[SLOPES + 1] = 3;
    return x[X] == 78;
}

static int slope_by_inputs(mbs_real *x)
{
    x[SLOPES + 2] = 5, x[SLOPES + 3] = 10;
    return x[X] == 79;
}

static int rest(mbs_real *x)
{
    ++evaluations;
    x[RATES + XD] = x[RATES + YD] = 0;
    return 0;
}

static int close_places(mbs_real *x)
{
    x[CLOSED + X] = x[X], x[CLOSED + Y] = 2 * x[X];
    return fabs(x[X]) > widest;
}

static int close_velocities(mbs_real *x)
{
    x[CLOSED + XD] = x[ALONE], x[CLOSED + YD] = 2 * x[ALONE];
    return fabs(x[ALONE]) > widest;
}

/* The point of y = 2 x that is next to the given one. */
static int put_back(mbs_real *x)
{
    x[CLOSED + X] = (x[X] + 2 * x[Y]) / 5, x[CLOSED + Y] = 2 * x[CLOSED + X];
    x[CLOSED + XD] = (x[XD] + 2 * x[YD]) / 5, x[CLOSED + YD] = 2 * x[CLOSED + XD];
    return fabs(x[X]) > widest;
}

static int follow(mbs_real *x)
{
    x[CLOSED + X] = x[Y] / 2, x[CLOSED + XD] = x[YD] / 2, x[CLOSED + Y] = x[Y], x[CLOSED + YD] = x[YD];
    return fabs(x[Y]) > widest;
}

static const mbs_real start[] = {0.5, 0.25, -1, 2, 3, 4, 0, 1.5};
static const int moving[] = {X, XD}, all[] = {X, Y, XD, YD}, given[] = {U, Y, YD, YDD}, first[] = {0};
static const mbs_fmi_function slopes[] = {slope_by_states, slope_by_inputs};
static const int row[] = {0, 1, 1, 1, 1, 2, 2}, column[] = {1, 0, 2, 3, 4, 0, 3};
static const int place[] = {-1, SLOPES, -1, SLOPES + 1, SLOPES + 2, -1, SLOPES + 3};

static const mbs_fmi_mechanism guided = {
    "guided", 2, 2, 2, 4, 1, 1, 1, SIZE, RATES, K, CLOSED, CLOCK, moving, given, start, 8, 0.1,
    prepare, NULL, accelerate, put_out, NULL, NULL, NULL, 0, first, 2, slopes, 7, row, column, place,
};
static const mbs_fmi_mechanism looped = {
    "looped", 2, 2, 4, 0, 0, 1, 0, SIZE, RATES, K, CLOSED, -1, all, given, start, 8, 0.1,
    prepare, NULL, rest, NULL, close_places, close_velocities, put_back, 1, first, 0, slopes, 0, row, column, place,
};
static const mbs_fmi_mechanism led = {
    "led", 2, 2, 2, 4, 1, 1, 1, SIZE, RATES, K, CLOSED, CLOCK, moving, given, start, 8, 0.1,
    prepare, NULL, accelerate, put_out, NULL, NULL, follow, 0, first, 2, slopes, 7, row, column, place,
};
const mbs_fmi_mechanism *present = &guided;

static inline int same(double a, double b)
{
    return fabs(a - b) <= 1e-14 * (fabs(a) + fabs(b) + 1);
}

#endif

/* Many problems of one kind, one after the other in one call: their numbers lie in stacks, a row for each case.
 *
 * Each case starts near a solution, or from a guess, as its options say, and knows nothing of the others. A part of a
 * stack may be solved by another worker with separate memory; no number depends on how the stack is divided.
 *
 * Lies in a folder of csrc: compile with -I csrc/stages, -I csrc/program and -I csrc/timing. */
#ifndef MBS_CASES_H
#define MBS_CASES_H

#include "mbs_timed_program.h"

/* What solves: a solver, and the numbers that its problem reads, which are written before each case. */
typedef struct {
    mbs_stages *solver;
    const mbs_stages_options *options;
    mbs_timed_program *timed; /* the context of the problem */
    int given;                /* as many parameters come with the cases */
    int variables, rows;      /* of the bounds: of variables, and of g */
    mbs_stages_real *parameters, *lower, *upper, *least, *most, *scale;
} mbs_cases_worker;

/* The cases; the point of each is replaced by the one where its solve ended. */
typedef struct {
    const mbs_stages_real *parameters, *lower, *upper, *least, *most, *scale;
    mbs_stages_real *w, *y, *below, *above;
    const int *most_iterations; /* 0: as the options say */
    int *status, *iterations;
    double *seconds, *evaluating; /* by the clock: of a solve, and of these in functions and derivatives */
    double *cpu_seconds;          /* of the worker's thread */
} mbs_cases_stack;

/* Solve the cases from .. to - 1. */
void mbs_cases_solve(const mbs_cases_worker *worker, const mbs_cases_stack *stack, int from, int to);

#endif

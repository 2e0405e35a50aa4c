/* A mechanism for FMI, of any version: its numbers, their derivatives, its steps and its saved states.
 *
 * mbs_fmi2.c and mbs_fmi3.c are the two interfaces of the standard on top of these functions. A function that returns an
 * int returns 0, or 1 after it has reported why it failed. */
#ifndef MBS_FMI_H
#define MBS_FMI_H

#include <stddef.h>
#include <stdint.h>

#include "mbs_abi.h"

#if defined(_WIN32)
#define MBS_FMI_API __declspec(dllexport)
#elif defined(__GNUC__)
#define MBS_FMI_API __attribute__((visibility("default")))
#else
#define MBS_FMI_API
#endif

/* A generated function, which takes its arguments from the numbers of an instance, and writes its results there. The
 * numbers are the inputs (coordinates, velocities, forces, wrenches, given accelerations,
 * parameters, set-up), then the results (rates,
 * accelerations, outputs, closed coordinates and velocities, independent velocities, slopes). */
typedef int (*mbs_fmi_function)(mbs_real *numbers);

/* A mechanism: sizes, first values, functions, and the nonzeros of the derivatives of (rates of states, outputs)
 * by (states, inputs). A function is NULL where there is none. */
typedef struct {
    const char *token;
    int coordinates, velocities, states, inputs;
    int driven; /* joints, whose coordinates, velocities and accelerations are the last inputs */
    int parameters, outputs;
    int size;              /* of the numbers */
    int results;           /* where rates begin; accelerations and outputs follow */
    int parameter;         /* where parameters begin */
    int closed;            /* where closed coordinates begin; closed velocities, then independent ones follow */
    int clock;             /* where the time is, of forces that read it; -1: none does */
    const int *state, *input; /* their places among the numbers */
    const mbs_real *start; /* of the numbers up to the set-up */
    int given;             /* how many they are */
    mbs_real step;         /* the longest step of co-simulation [s] */
    mbs_fmi_function setup, rates, accelerations, places;
    mbs_fmi_function close, close_rates; /* close the loops, as the independent joints stand and move */
    mbs_fmi_function project;            /* closed coordinates and velocities that are next to the given ones */
    int independents;
    const int *independent; /* entries of the velocities that determine all others */
    int slopes;             /* functions that write derivatives */
    const mbs_fmi_function *slope;
    int nonzeros;
    const int *row, *column, *place; /* of each nonzero; its place among the numbers, -1: it is 1 */
} mbs_fmi_mechanism;

extern const mbs_fmi_mechanism mbs_fmi_model;

/* An instance of the mechanism. The interfaces extend it. */
typedef struct mbs_fmi_instance {
    void (*report)(struct mbs_fmi_instance *c, const char *message);
    double time, step;
    int is_set_up, is_known; /* whether set-up, and rates, accelerations and outputs, belong to the present numbers */
    mbs_real *numbers, *work; /* work: four rates of the states, the states before a step, and the
                                 coordinates and velocities of driven joints before all steps */
} mbs_fmi_instance;

typedef uint32_t mbs_fmi_reference;

/* Allocate the numbers; or return 1, and allocate nothing. */
int mbs_fmi_open(mbs_fmi_instance *c, const char *token);
void mbs_fmi_close(mbs_fmi_instance *c);
/* Take the first values. */
void mbs_fmi_begin(mbs_fmi_instance *c);
/* Report a failure; return 1. */
int mbs_fmi_fail(mbs_fmi_instance *c, const char *message);

/* Set the time, for messages and for forces that read it. */
void mbs_fmi_set_time(mbs_fmi_instance *c, double time);

int mbs_fmi_get(mbs_fmi_instance *c, const mbs_fmi_reference references[], size_t count, double values[]);
int mbs_fmi_set(mbs_fmi_instance *c, const mbs_fmi_reference references[], size_t count, const double values[]);
/* Multiply the derivatives of unknowns by knowns with a seed: of each known, or, of adjoints, of each unknown. */
int mbs_fmi_differentiate(mbs_fmi_instance *c, const mbs_fmi_reference unknowns[], size_t n_unknowns,
                          const mbs_fmi_reference knowns[], size_t n_knowns, const double seed[], double found[],
                          int is_adjoint);

size_t mbs_fmi_count_states(void);
int mbs_fmi_get_states(mbs_fmi_instance *c, double states[], size_t count);
int mbs_fmi_set_states(mbs_fmi_instance *c, const double states[], size_t count);
int mbs_fmi_get_rates(mbs_fmi_instance *c, double rates[], size_t count);

/* Close the loops as the independent joints stand and move, and compute everything. */
int mbs_fmi_initialise(mbs_fmi_instance *c);
/* Return whether the states have left the closed loops by more than an integrator should go on with. */
int mbs_fmi_has_drifted(mbs_fmi_instance *c);
/* Put the states back on the closed loops. */
int mbs_fmi_project(mbs_fmi_instance *c);
/* Take steps of the classical Runge-Kutta method from `time`; c->time is where they end. Driven joints go on with their
 * given accelerations. */
int mbs_fmi_advance(mbs_fmi_instance *c, double time, double size);

size_t mbs_fmi_count_bytes(void);
void mbs_fmi_restore(mbs_fmi_instance *c, const unsigned char *bytes);
/* Save to *state, or to new memory where it is NULL; copy a saved state to bytes, and back; free it. */
int mbs_fmi_take(mbs_fmi_instance *c, void **state);
int mbs_fmi_write(mbs_fmi_instance *c, const void *state, unsigned char bytes[], size_t size);
int mbs_fmi_read(mbs_fmi_instance *c, const unsigned char bytes[], size_t size, void **state);
void mbs_fmi_drop(void **state);

#endif

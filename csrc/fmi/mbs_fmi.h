/* The types of FMI 3.0 that a mechanism uses, and what its generated part gives: see mbs_fmi.c. */
#ifndef MBS_FMI_H
#define MBS_FMI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "mbs_abi.h"

#if defined(_WIN32)
#define FMI3_API __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI3_API __attribute__((visibility("default")))
#else
#define FMI3_API
#endif

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef bool fmi3Boolean;
typedef double fmi3Float64;
typedef const char *fmi3String;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                                       fmi3String message);

/* A function in CasADi's contract. */
typedef int (*mbs_fmi_function)(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem);

/* Places of a function's arguments and results among the numbers of an instance: the inputs (coordinates, velocities,
 * forces, wrenches, parameters, set-up), then the results (rates, accelerations, outputs, slopes). */
typedef struct {
    mbs_fmi_function function; /* NULL: none */
    int arguments, results;
    const int *argument, *result;
} mbs_fmi_call;

/* A mechanism: sizes, first values, functions, and the nonzeros of the derivatives of (rates, accelerations, outputs)
 * by (coordinates, velocities, forces and wrenches). */
typedef struct {
    fmi3String token;
    int coordinates, velocities, inputs, parameters, outputs;
    int size;                      /* of the numbers */
    int results;                   /* where rates begin; accelerations and outputs follow */
    int parameter;                 /* where parameters begin */
    const casadi_real *start;      /* of the numbers up to the set-up */
    int given;                     /* how many they are */
    casadi_real step;              /* the longest step of co-simulation [s] */
    mbs_fmi_call setup, rates, accelerations, places;
    int slopes;                    /* functions that write derivatives */
    const mbs_fmi_call *slope;
    int nonzeros;
    const int *row, *column, *place; /* of each nonzero; its place among the numbers, -1: it is 1 */
} mbs_fmi_mechanism;

extern const mbs_fmi_mechanism mbs_fmi_model;

#endif

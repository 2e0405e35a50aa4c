/* Evaluate the functions of the stages of a transcribed optimal control problem, from tables.
 *
 * A transcription applies a few functions (kernels, expressions) at many places. Per kind of stage there are three
 * scripts, which compute values, Jacobians and the Hessian of the Lagrangian in one vector W of numbers: sums and
 * products of entries, and calls. Tables are constant and shared; each instance has its own memory, so that
 * threads share nothing else. C99; no allocation. MBS_STAGES_FLOAT makes all numbers float, also in the functions. */
#ifndef MBS_PROGRAM_H
#define MBS_PROGRAM_H

#include "mbs_stages.h"

#if defined(MBS_STAGES_FLOAT) && !defined(MBS_PRIVATE_H) /* as in mbs_stages.h */
#define mbs_program_bytes mbs_program_bytes_float
#define mbs_program_create mbs_program_create_float
#define mbs_program_values mbs_program_values_float
#define mbs_program_jacobians mbs_program_jacobians_float
#define mbs_program_hessian mbs_program_hessian_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* A function in CasADi's contract; it returns 0, or anything else if it has no result. */
typedef int (*mbs_program_function)(const mbs_stages_real **arg, mbs_stages_real **res, long long int *iw,
                                    mbs_stages_real *w, int mem);

/* W[to] += coefficient * W[from], and with `by` also times W[by]. */
typedef struct {
    int count;
    const int *to, *from, *by; /* by: NULL for sums */
    const mbs_stages_real *coefficient;
} mbs_program_terms;

/* Call functions[function]: arguments and results begin at places in W; -1: NULL. */
typedef struct {
    int function, arguments, results;
    const int *argument, *result;
} mbs_program_call;

/* One after the other: terms, then a call, where there are any. */
typedef struct {
    mbs_program_terms terms;
    const mbs_program_call *call; /* NULL: none */
} mbs_program_step;

/* W begins with the given numbers: x, v, parameters, numbers of the stage, and for the Hessian the factor of f, ye, yd,
 * yg. Then come `constants`, which begin as `start`, of which the results are a part; then the results of calls. */
typedef struct {
    int steps;
    const mbs_program_step *step;
    int constants;
    const mbs_stages_real *start;
    int size;             /* of W */
    const int *result;    /* where results begin: f, e, d, g; or df and the nonzeros of de, dd, dg; or of the Hessian */
} mbs_program_script;

/* Stages that are alike; `size` has patterns. */
typedef struct {
    mbs_stages_size size;
    mbs_program_script values, jacobians, hessian;
} mbs_program_kind;

typedef struct {
    int stages, kinds;
    const int *kind_of_stage;
    const mbs_program_kind *kind;
    int parameters; /* of the whole problem, then inputs of kernels that are the same for all calls */
    int numbers;    /* of a stage: times of points, references */
    const mbs_program_function *functions;
    int arguments, results, integers, reals; /* the most that a call needs */
} mbs_program;

/* A function for several calls at once: number i of an argument or a result of call s is at place i * lanes + s. */
typedef struct {
    mbs_program_function function; /* NULL: there is none */
    const int *argument, *result;  /* how many numbers each has */
} mbs_program_abreast;

/* Functions for `lanes` calls at once, by their numbers among the functions of the program. They are used where
 * MBS_PROGRAM_LANES is defined. */
typedef struct {
    int lanes;
    const mbs_program_abreast *function;
    mbs_stages_real *room; /* for the numbers of one function's calls, aligned to a vector of them */
} mbs_program_lanes;

/* An instance: `context` of mbs_stages_problem. */
typedef struct {
    const mbs_program *program;
    const mbs_stages_real *parameters;
    const mbs_stages_real *numbers; /* stage by stage */
    const mbs_program_lanes *lanes; /* NULL: every call is made alone */
    mbs_stages_real *W, *reals;
    long long int *integers;
    const mbs_stages_real **arguments;
    mbs_stages_real **results;
} mbs_program_instance;

/* Return how many bytes of memory an instance needs. */
size_t mbs_program_bytes(const mbs_program *program);

/* Lay an instance out in memory that is aligned to 16 bytes; `parameters` and `numbers` are set by the caller. So are
 * `lanes`, where calls of one function that follow each other without terms between them do not read each other's
 * results. */
mbs_program_instance *mbs_program_create(const mbs_program *program, void *memory);

/* The callbacks of mbs_stages_problem; `instance` is its context. */
int mbs_program_values(void *instance, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *f,
                       mbs_stages_real *e, mbs_stages_real *d, mbs_stages_real *g);
int mbs_program_jacobians(void *instance, int k, const mbs_stages_real *x, const mbs_stages_real *v,
                          mbs_stages_real *df, mbs_stages_real *de, mbs_stages_real *dd, mbs_stages_real *dg);
int mbs_program_hessian(void *instance, int k, const mbs_stages_real *x, const mbs_stages_real *v,
                        mbs_stages_real factor, const mbs_stages_real *ye, const mbs_stages_real *yd,
                        const mbs_stages_real *yg, mbs_stages_real *h);

#ifdef __cplusplus
}
#endif

#endif

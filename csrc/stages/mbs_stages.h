/* Solve a nonlinear program in stages by a primal-dual interior-point method.
 *
 * Stages k = 0 .. N have states x and stage variables v (inputs, unknowns within an interval):
 *
 *     minimise  sum f(k, x, v)   such that   x of stage k + 1 = d(k, x, v),   e(k, x, v) = 0,
 *     least <= g(k, x, v) <= most,   lower <= (x, v) <= upper.
 *
 * The initial state is an unknown; fix it by equal bounds or by e. A parameter or a free horizon is a state with
 * d = x. C99, math.h and string.h alone; no allocation and no static state: solvers in several threads share
 * nothing. Define MBS_STAGES_FLOAT in every file for single precision, and MBS_STAGES_REALTIME for control in real time
 * alone: without `mbs_stages_solve`, in a quarter to a half of the memory. */
#ifndef MBS_STAGES_H
#define MBS_STAGES_H

#include <stddef.h>

/* Names in object files: single precision has separate ones, so that both precisions can be in one program, and a caller
 * in the other precision does not link. Generated folders name their functions by MBS_STAGES_OWN, which depends on the
 * precision, and by MBS_STAGES_NAME, which also depends on MBS_STAGES_REALTIME. */
#ifdef MBS_STAGES_FLOAT
#define MBS_STAGES_OWN(head, tail) head##_float##tail
#else
#define MBS_STAGES_OWN(head, tail) head##tail
#endif
#if defined(MBS_STAGES_FLOAT) && defined(MBS_STAGES_REALTIME)
#define MBS_STAGES_NAME(head, tail) head##_float_realtime##tail
#elif defined(MBS_STAGES_REALTIME)
#define MBS_STAGES_NAME(head, tail) head##_realtime##tail
#else
#define MBS_STAGES_NAME(head, tail) MBS_STAGES_OWN(head, tail)
#endif

#if defined(MBS_STAGES_FLOAT) && !defined(MBS_PRIVATE_H)
#define mbs_stages_adjoint mbs_stages_adjoint_float
#define mbs_stages_begin_anew mbs_stages_begin_anew_float
#define mbs_stages_bytes mbs_stages_bytes_float
#define mbs_stages_create mbs_stages_create_float
#define mbs_stages_default_options mbs_stages_default_options_float
#define mbs_stages_explain mbs_stages_explain_float
#define mbs_stages_feedback mbs_stages_feedback_float
#define mbs_stages_gain mbs_stages_gain_float
#define mbs_stages_iterate mbs_stages_iterate_float
#define mbs_stages_places mbs_stages_places_float
#define mbs_stages_prepare mbs_stages_prepare_float
#define mbs_stages_shift mbs_stages_shift_float
#define mbs_stages_solve mbs_stages_solve_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

#ifdef MBS_STAGES_FLOAT
typedef float mbs_stages_real;
#else
typedef double mbs_stages_real;
#endif

/* The nonzeros of a matrix with columns for x and v: column j has those from column[j] up to column[j + 1], and row
 * holds the row of each, increasing in a column. */
typedef struct {
    const int *column, *row;
} mbs_stages_pattern;

/* The patterns of a stage; h is the lower triangle of the Hessian. */
typedef struct {
    mbs_stages_pattern de, dd, dg, h;
} mbs_stages_patterns;

/* Numbers of a stage: states, stage variables, rows of e, rows of g. */
typedef struct {
    int nx, nv, ne, ng;
    int inner; /* as many of the first v are given by the first rows of e: unknowns within an interval; 0: none */
    const mbs_stages_patterns *patterns; /* NULL: matrices are dense */
} mbs_stages_size;

/* What an iteration begins with. */
typedef struct {
    int iteration, restoring;
    mbs_stages_real cost, violation, stationarity, barrier; /* scaled; in restoration the cost of restoration */
    mbs_stages_real step, curvature; /* length of the last step; what was added to its Hessian */
} mbs_stages_progress;

/* Work on stages from .. to - 1 by one worker. */
typedef void (*mbs_stages_task)(void *data, int from, int to, int worker);

/* Threads of the caller, that work on stages at once; it must live as long as the solver, and `workers` must stay.
 *
 * `spread` calls `task` for parts that together are the stages 0 .. count - 1, each of them once, and returns when all
 * of these calls have. Calls at the same time have different workers, from 0 to workers - 1. The solver calls it from
 * the thread that calls the solver. No number depends on how the stages are divided. */
typedef struct {
    int workers; /* at least 1 */
    void (*spread)(void *pool, int count, mbs_stages_task task, void *data);
    void *pool;            /* goes to `spread` */
    void *const *contexts; /* of values, jacobians and hessian, one for each worker; NULL: all get the problem's */
} mbs_stages_team;

/* A problem; it must live as long as its solver.
 *
 * Variables are stage by stage, x before v. Rows are stage by stage, e before d before g; the last stage has no d.
 * A bound that is not there is infinite (at least 1e19 in magnitude). Matrices have columns for x and v and are zero on
 * entry. Where a stage has patterns, a callback writes the nonzeros of de, dd, dg and h in the order of the pattern.
 * Otherwise matrices are dense, column by column, and of the Hessian only the lower triangle is read. The gradient df
 * is always dense.
 *
 * A callback returns 0, or anything else if it has no result; numbers that are not finite count as no result. */
typedef struct {
    int stages; /* N + 1, at least 1 */
    const mbs_stages_size *size;
    void *context; /* goes to every callback */
    int (*values)(void *context, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *f,
                  mbs_stages_real *e, mbs_stages_real *d, mbs_stages_real *g);
    int (*jacobians)(void *context, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *df,
                     mbs_stages_real *de, mbs_stages_real *dd, mbs_stages_real *dg);
    /* second derivatives of factor * f + ye . e + yd . d + yg . g */
    int (*hessian)(void *context, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real factor,
                   const mbs_stages_real *ye, const mbs_stages_real *yd, const mbs_stages_real *yg,
                   mbs_stages_real *h);
    void (*watch)(void *context, const mbs_stages_progress *progress); /* NULL: nobody watches */
    double (*clock)(void *context); /* seconds from any origin; NULL where there is no limit of time */
    const mbs_stages_real *lower, *upper; /* of the variables; NULL: none */
    const mbs_stages_real *least, *most;  /* of the rows of g, stage by stage; NULL: none */
    const mbs_stages_real *scale;         /* usual size of each variable, above 0; NULL: 1 */
    const mbs_stages_team *team;          /* NULL: the solver works in the caller's thread alone */
} mbs_stages_problem;

typedef enum {
    MBS_STAGES_SOLVED,
    MBS_STAGES_ACCEPTABLE,      /* to the acceptable tolerances, or small changes may lower the cost by more than 1e-4
                                 * of it (float: 0.1; the root of a loose tolerance); no further progress */
    MBS_STAGES_INFEASIBLE,      /* the violation is at a local minimum above 0; `clash` holds its rows */
    MBS_STAGES_ITERATION_LIMIT,
    MBS_STAGES_TIME_LIMIT,
    MBS_STAGES_OUT_OF_DIGITS,   /* steps make no progress in this precision */
    MBS_STAGES_UNBOUNDED,       /* variables grow beyond 1e20 of their scales */
    MBS_STAGES_CALLBACK_FAILED, /* `stage` holds where; the last iterate is kept */
    MBS_STAGES_BAD_PROBLEM,     /* bounds cross, bounds or measured states are not numbers, more bounds are equal than
                                 * when the solver was made, or a scale is not positive */
    MBS_STAGES_PREPARED,        /* a step is ready for feedback */
    MBS_STAGES_STEPPED,         /* a step was made */
    MBS_STAGES_NOT_PREPARED,    /* feedback without a preparation that succeeded */
    MBS_STAGES_DIVERGED         /* the plan is none any more: steps do not come back from its violation; solve anew */
} mbs_stages_status;

/* Options. Where IPOPT has the same, it has the same name there. */
typedef struct {
    mbs_stages_real tol;             /* of the scaled optimality conditions: 1e-8 (float: 1e-4); a larger one asks for
                                      * a quick end, and gets no further digits */
    mbs_stages_real constr_viol_tol; /* of rows and of complementarity, unscaled: 1e-4 (float: 1e-3) */
    mbs_stages_real acceptable_tol;  /* 1e-6 (float: 1e-3) ... */
    int acceptable_iter;             /* ... in as many iterations in a row: 15 */
    int max_iter;                    /* 3000 */
    double max_wall_time;            /* s by the clock; 0: no limit */
    mbs_stages_real mu_init;         /* the first barrier parameter; 0: 0.1 */
    mbs_stages_real mu_target;       /* solve for this barrier parameter, in units of the cost; 0: as low as the
                                      * tolerance asks for (in real time: 1e-4) */
    int adaptive;                    /* 1: choose the first barrier parameter by an affine step */
    int warm_start_init_point;       /* 1: the point holds multipliers too; start from all of it, with the scales of the
                                      * solve before, if there was one; 2: it is the solution of another problem, and
                                      * nothing else of solves before counts: scales are found anew, and the solution gets
                                      * all its digits, which one of a loop's samples does not */
    int by_stage;                    /* 1: add curvature only from the stage on that lacks it: 0 */
    int scaled;                      /* 1: scale the cost and rows by their first gradients: 1 */
    int scale_by_bounds;             /* 1: variables without given scales take the larger of two bounds: 0 */
    mbs_stages_real bound_push;      /* least relative distance of the first point from bounds: 0.01 */
    mbs_stages_real bound_relax_factor; /* bounds that are not equal give by this part of their size, or of 1, while a
                                         * solve goes on: 1e-8 (float: 1e-5) */
    int follow;                      /* 1: where a trial is refused, inner variables are solved for anew, as if they were
                                      * functions of the others: 0 */
    mbs_stages_real most_violation;  /* in real time: the violation of scaled rows from which on a plan has diverged; 0:
                                      * 10 times the largest of the plan that steps began with: its scaled numbers, its
                                      * own violation, 1 */

    /* the barrier problem, and scales */
    mbs_stages_real barrier_tol_factor; /* the barrier parameter falls where errors are below it times this: 10 */
    mbs_stages_real mu_linear_decrease_factor, mu_superlinear_decrease_power; /* 0.2, 1.5 */
    mbs_stages_real tau_min;            /* part of the way to a bound that a step may go: 0.99 */
    mbs_stages_real kappa_d;            /* price of the distance from a bound, beside the barrier parameter: 1e-5 */
    mbs_stages_real kappa_sigma;        /* how far a multiplier may be from barrier parameter / distance: 1e10 */
    mbs_stages_real s_max;              /* mean of multipliers beyond which errors are scaled: 100 */
    mbs_stages_real diverging_iterates_tol;   /* 1e20 */
    mbs_stages_real nlp_scaling_max_gradient; /* gradients that are not scaled down: 100 */
    mbs_stages_real nlp_scaling_min_value;    /* 1e-16 */

    /* the line search, and restoration */
    mbs_stages_real theta_max_fact, theta_min_fact; /* violations beside the first one: the most, 100 (with 1e4, as in
                                                     * the paper, searches leave for no return); small ones, 1e-4 */
    mbs_stages_real gamma_theta, gamma_phi;      /* margins of the filter: 1e-5, 1e-8 */
    mbs_stages_real delta, s_theta, s_phi;       /* the switching condition: 1, 1.1, 2.3 */
    mbs_stages_real eta_phi;                     /* Armijo's condition: 1e-8 */
    mbs_stages_real alpha_min_frac;              /* 0.05 */
    mbs_stages_real obj_max_inc;                 /* orders of magnitude that the barrier function may rise by: 5 */
    int max_soc;                                 /* second-order corrections: 4 */
    mbs_stages_real kappa_soc;                   /* of the violation, by each of them: 0.99 */
    int watchdog_shortened_iter_trigger, watchdog_trial_iter_max;     /* 10, 3 */
    int max_soft_resto_iters;                    /* steps that lower the errors alone, in a row: 10 */
    mbs_stages_real soft_resto_pderror_reduction_factor;              /* 0.9999 */
    mbs_stages_real required_infeasibility_reduction;                 /* of the largest violation: 0.9 */
    mbs_stages_real resto_penalty_parameter, bound_mult_reset_threshold; /* 1000, 1000 */

    /* curvature that is added, and refinement */
    mbs_stages_real first_hessian_perturbation, min_hessian_perturbation, max_hessian_perturbation; /* 1e-4, 1e-20, 1e20 */
    mbs_stages_real perturb_inc_fact_first, perturb_inc_fact;         /* 100, 6 */
    int max_refinement_steps;                    /* 8 */
} mbs_stages_options;

/* A row or a bound that stays violated. */
typedef enum { MBS_STAGES_EQUALITY, MBS_STAGES_DYNAMICS, MBS_STAGES_INEQUALITY } mbs_stages_kind;
typedef struct {
    int stage;
    mbs_stages_kind kind;
    int row; /* of e, d or g in this stage */
    mbs_stages_real violation;
} mbs_stages_clash;

#define MBS_STAGES_CLASHES 8

typedef struct {
    mbs_stages_status status;
    int stage; /* of a failed callback or a bad bound, or -1 */
    int iterations, restorations /* iterations within restoration */, evaluations /* of values */;
    int factorisations, refinements;
    int dependent; /* rows without a pivot in the last factorisation */
    int singular;  /* stages in it whose inner rows do not give their inner variables, or hardly do */
    mbs_stages_real cost;
    mbs_stages_real stationarity, violation, complementarity; /* largest, unscaled */
    mbs_stages_real barrier;                                  /* the last barrier parameter */
    int clashes;                                              /* rows that stay violated; the worst follow */
    mbs_stages_clash clash[MBS_STAGES_CLASHES];
} mbs_stages_result;

/* The iterate: initial guess and solution. They belong to the Lagrangian
 *     f + y . (e, d - next x, g) - below . (w - lower) + above . (w - upper). */
typedef struct {
    mbs_stages_real *w;             /* variables */
    mbs_stages_real *y;             /* multipliers of rows */
    mbs_stages_real *below, *above; /* multipliers of bounds of variables, at least 0 */
    int variables, rows;
} mbs_stages_point;

typedef struct mbs_stages mbs_stages;

/* Return how many bytes the workspace needs, 0 if no solver can be made of the problem. Equal bounds are counted
 * now: a later solve may have other bounds, but no further equal ones. */
size_t mbs_stages_bytes(const mbs_stages_problem *problem);

/* Lay the solver out in the workspace, which must be aligned to 16 bytes. Returns NULL if it is too small. */
mbs_stages *mbs_stages_create(const mbs_stages_problem *problem, void *workspace, size_t bytes);

mbs_stages_options mbs_stages_default_options(void);

/* The iterate in the workspace: write the guess before a solve, read the solution after it. All 0 at first. */
mbs_stages_point mbs_stages_iterate(const mbs_stages *solver);

/* Places of a stage in `w` and in `y`: of x, then v; of e, then d, then g. */
typedef struct {
    int x, v, e, d, g;
} mbs_stages_place;
mbs_stages_place mbs_stages_places(const mbs_stages *solver, int k);

#ifndef MBS_STAGES_REALTIME
/* Solve from the iterate. `options` may be NULL for the default. */
mbs_stages_result mbs_stages_solve(mbs_stages *solver, const mbs_stages_options *options);
#endif

/* Move the iterate one stage ahead: each stage takes the numbers of the next one, where their sizes are equal. */
void mbs_stages_shift(mbs_stages *solver);

/* Control in real time: a step of Newton's method for the problem with the barrier parameter `mu_target`, without a
 * line search, in two parts.
 *
 * `mbs_stages_prepare` does all that needs no measurement: it moves the iterate ahead if `shift` is not 0, calls the
 * callbacks, factorises, and finds the step for the first state of the iterate. Returns MBS_STAGES_PREPARED.
 * `mbs_stages_feedback` takes the measured first state, corrects the step for it, and makes the step.
 * Variables, slacks and multipliers stay strictly inside their bounds: each variable takes the whole step, or goes
 * almost to its own bound. Returns MBS_STAGES_STEPPED.
 *
 * First states with equal bounds are the measured ones; of `first`, which has nx numbers, the others are not read.
 * `v` gets the variables of stage 0. Where no step is made, the iterate stays as it is, and `v` gets its numbers.
 *
 * Steps can go wrong, after a blow for instance. Where the violation of the plan exceeds `most_violation`, the preparation
 * returns MBS_STAGES_DIVERGED, and no step is made until there is another plan: write a guess, and solve or begin anew.
 *
 * The first preparation after a solve starts from its solution, or from the caller's guess. Limits and
 * tolerances among the options are not read. `options` may be NULL for the default. */
typedef struct {
    mbs_stages_status status;
    int stage;          /* of a failed callback or a bad bound, or -1 */
    int factorisations; /* more than 1 where curvature was added */
    mbs_stages_real curvature; /* what was added */
    mbs_stages_real stationarity, violation, complementarity; /* before the step: largest, unscaled; the last one
                                                               * is |distance multiplier - barrier| */
    mbs_stages_real deviation;          /* largest difference of the measured first state and the iterate's, scaled */
    mbs_stages_real length, dual_length; /* of the step: the least part that a variable took; of multipliers */
} mbs_stages_realtime;

mbs_stages_realtime mbs_stages_prepare(mbs_stages *solver, const mbs_stages_options *options, int shift);
mbs_stages_realtime mbs_stages_feedback(mbs_stages *solver, const mbs_stages_real *first, mbs_stages_real *v);

/* Return the derivative of the variables, ordered as the iterate, by fixed first state j, in the step that was prepared
 * last: with the factors of the preparation, one sweep. It belongs to the barrier problem, whose parameter smooths it
 * where bounds begin or cease to bind. Returns NULL without a preparation since the last solve. Valid until the next
 * call of the solver; a state that is not fixed has zeros. */
const mbs_stages_real *mbs_stages_gain(mbs_stages *solver, int j);

#ifndef MBS_STAGES_REALTIME
/* The adjoint of the gains: `first`, of nx numbers, gets the derivatives of the sum of `weights` times variables, both
 * ordered as the iterate, by all fixed first states, with one sweep; 0 for states that are not fixed. Returns 0, or -1
 * where there is no gain. */
int mbs_stages_adjoint(mbs_stages *solver, const mbs_stages_real *weights, mbs_stages_real *first);
#endif

/* Let the next preparation take the iterate as a guess, as after a solve. */
void mbs_stages_begin_anew(mbs_stages *solver);

/* Return a sentence for a status. */
const char *mbs_stages_explain(mbs_stages_status status);

#ifdef __cplusplus
}
#endif

#endif

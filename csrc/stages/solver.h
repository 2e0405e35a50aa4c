/* What the parts of the solver share. */
#ifndef MBS_STAGES_SOLVER_H
#define MBS_STAGES_SOLVER_H

#include "recursion.h"

#define MBS_STAGES_RUNNING (-1) /* no status yet */
#define MBS_STAGES_RESTORED (-2)

/* Whether there is a bound. */
static inline int mbs_stages_has(real bound)
{
    return real_abs(bound) < MBS_STAGES_INFINITE;
}

static inline real mbs_stages_larger(real a, real b)
{
    return a > b ? a : b;
}

/* What a relative change of a bound refers to. */
static inline real mbs_stages_bound_size(real bound)
{
    return real_abs(bound) > 1 ? real_abs(bound) : 1;
}

/* Pairs (violation, barrier function) that no later iterate may be worse than in both. */
typedef struct {
    int count;
    real *theta, *phi; /* MBS_STAGES_ENTRIES each */
} mbs_stages_filter;

typedef struct {
    real *x, *zl, *zu, *y;
} mbs_stages_direction;

/* A point that the search goes back to if whole steps from it come to nothing. */
typedef struct {
    int shortened; /* iterations with short steps, in a row */
    int active, trials;
    real *x, *zl, *zu, *y, *c;
    mbs_stages_direction step;
    real cost, theta, phi, descent, alpha;
} mbs_stages_watchdog;

/* A barrier problem: the caller's, or the problem of least violation (elastic).
 *
 * Its variables lie in one vector x = (w, slacks s of g, and if elastic p, n of each row), with bounds
 * lower <= x <= upper. Its rows are c = (e, d - next x, g - s), and if elastic c - p + n. */
typedef struct {
    const mbs_stages_options *options; /* the solver's */
    int elastic, size;
    real *x, *trial, *lower, *upper, *zl, *zu, *y;
    real *gradient;           /* of the cost */
    real *lagrangian;         /* derivatives of cost and rows */
    real *slope;              /* of the Lagrangian without z, with the barrier's derivatives instead */
    real *sigma;              /* z / distance from bounds */
    real *c, *trial_c, *soc_c; /* rows at x, at the trial, for a second-order correction */
    real cost, trial_cost;
    real theta, phi;          /* violation and barrier function at x */
    real theta_before;        /* violation before the last step */
    real theta_most, theta_least;
    real mu, tau;
    real regular, added;      /* curvature that was added last where it lacked; in this step */
    int shortened;            /* steps in a row that had added curvature, and were cut short */
    int cautious;             /* inner variables get curvature too */
    int cut;                  /* steps in a row that the search cut short */
    real restraint;           /* curvature that steps begin with, while they are cut short again and again */
    int tiny, tiny_before;    /* steps below the last digit */
    int rejected;             /* iterations whose first trial the filter alone refused, in a row */
    int resets;
    int failing;              /* the last trial had no result */
    real alpha;               /* the last step length */
    int acceptable;           /* iterations in a row */
    int rounding;             /* iterations in a row that rows alone are above the tolerance, */
    real rounded;             /* by this much at first */
    mbs_stages_filter filter;
    mbs_stages_direction step, other;
    mbs_stages_watchdog watchdog; /* of the caller's problem alone */
    int soft;                     /* steps in a row that were accepted because they lower the errors alone */
} mbs_stages_phase;

/* Largest errors of the optimality conditions. `scaled` is the largest, of stationarity and complementarity over the size
 * of multipliers, which is `dual`, and of scaled rows. */
typedef struct {
    real stationarity, violation, complementarity, scaled, dual;
} mbs_stages_errors;

/* Whether hard rows are softened in factorisations: not yet, now, or no more. */
typedef enum { MBS_STAGES_HARD, MBS_STAGES_SOFTENED, MBS_STAGES_HARD_FOR_GOOD } mbs_stages_softening;

struct mbs_stages {
    const mbs_stages_problem *problem;
    mbs_stages_options options;
    mbs_stages_result result;
    mbs_stages_recursion recursion;
    int variables, rows, slacks;
    mbs_stages_point point;
    mbs_stages_phase main, least;
    real *slack, *slack_below, *slack_above; /* of rows of g and their multipliers, kept between steps in real time */
    mbs_stages_realtime realtime;
    int live;  /* the iterate is the one of a step in real time, its slacks too */
    int ready; /* a step is prepared */
    real usual; /* the largest number or violation, scaled, of the plan that steps began with, at least 1 */
    real *variable_scale, *row_scale, cost_scale;
    char *fixed;                  /* of (w, s), and of (p, n), which inner rows have none of */
    real *reference, *weight;     /* of w in restoration */
    real weight_factor;
    real *raw_w, *raw_rows, *raw; /* unscaled numbers for callbacks */
    real *rw, *rc, *dw, *dy, *residual_w, *residual_c, *best_w, *best_y;
    real left;     /* what its dependent rows lack to agree with the others */
    mbs_stages_softening softening;
    int softer; /* softened rows give more */
    char *softened; /* rows that the factorisation lets give, although they are hard */
    real *gives;    /* compliances of rows of the main problem: also of the rows that the factorisation takes as exact */
    real giving;    /* part of their size by which bounds give */
    int exact;      /* factorisations take rows that hardly give as exact */
    int unhelped;   /* steps without digits either way */
    int is_sharper; /* the solve goes on with a smaller tolerance */
    real asked;     /* the tolerance before, then */
    real cost_before; /* after a warm start: the largest scaled cost of the solves that followed each other, else 0 */
    double began;
    int failed_stage;
    int has_scales; /* of the last solve */
    real farther;   /* the barrier parameter of a warm start whose first step is short, or that finds none; then 0 */
    int has_units;  /* some variables have a scale other than 1 */
    char *failed; /* stages whose callback gave no result */
    real *costs;  /* of stages, unscaled */
};

/* Whether the caller asks for less than the default tolerance. */
static inline int mbs_stages_is_loose(const mbs_stages *s)
{
    return s->options.tol > MBS_STAGES_TOLERANCE;
}

/* evaluate.c: scaled callbacks; 0, or -1 where `failed_stage` failed */
int mbs_stages_values(mbs_stages *s, const real *w, real *cost, real *rows);
int mbs_stages_jacobians(mbs_stages *s, const real *w, real *gradient);
int mbs_stages_hessian(mbs_stages *s, const real *w, real factor, const real *y);

/* phase.c: the barrier problem */
int mbs_stages_phase_values(mbs_stages *s, const mbs_stages_phase *p, const real *x, real *cost, real *c);
int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p);
int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p);
real mbs_stages_sum(int n, const real *c);
real mbs_stages_largest(int n, const real *c);
real mbs_stages_barrier(const mbs_stages *s, const mbs_stages_phase *p, const real *x, real cost);
void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p);
void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out);
mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu);
real mbs_stages_rounding(const mbs_stages_phase *p);
real mbs_stages_boundary(const mbs_stages *s, const mbs_stages_phase *p, const real *x, const real *dx, real tau);
real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d);
real mbs_stages_descent(const mbs_stages *s, const mbs_stages_phase *p, const real *dx);
void mbs_stages_reweigh(mbs_stages *s, mbs_stages_phase *p);
real mbs_stages_mean_product(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d, real alpha,
                             real dual);
void mbs_stages_push_inside(real *x, real lower, real upper, real push);

/* newton.c: steps */
int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p);
void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d);
void mbs_stages_spread(const mbs_stages *s, const mbs_stages_phase *p, mbs_stages_direction *d);
void mbs_stages_bound_steps(const mbs_stages *s, const mbs_stages_phase *p, mbs_stages_direction *d);
void mbs_stages_estimate_multipliers(mbs_stages *s, mbs_stages_phase *p);

/* products.c: a longer step, if a bound would stop the one that is there */
void mbs_stages_correct_products(mbs_stages *s, mbs_stages_phase *p);

/* filter.c */
void mbs_stages_filter_clear(mbs_stages_filter *f);
void mbs_stages_filter_add(mbs_stages_filter *f, real theta, real phi);
int mbs_stages_filter_accepts(const mbs_stages_filter *f, real theta, real phi);
int mbs_stages_below(real a, real b, real base);

/* search.c: 0, or -1 where no step length will do */
int mbs_stages_search(mbs_stages *s, mbs_stages_phase *p);
int mbs_stages_search_without_step(mbs_stages *s, mbs_stages_phase *p);
int mbs_stages_search_softly(mbs_stages *s, mbs_stages_phase *p);
void mbs_stages_search_anew(mbs_stages_phase *p);

/* restoration.c */
int mbs_stages_restore(mbs_stages *s);
int mbs_stages_restored(mbs_stages *s);
real mbs_stages_worst_violation(const mbs_stages *s);

/* polish.c: a solution within bounds that give, put back on the bounds */
void mbs_stages_polish(mbs_stages *s, mbs_stages_phase *p);

/* finish.c */
int mbs_stages_is_solved(const mbs_stages *s, const mbs_stages_errors *e, real tolerance);
int mbs_stages_check(mbs_stages *s, mbs_stages_phase *p, const mbs_stages_errors *e);
int mbs_stages_settle(mbs_stages *s, mbs_stages_phase *p, int status);
void mbs_stages_report(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_errors *e);

/* solve.c: the first point; bounds of all variables and slacks; the iterate for the caller */
int mbs_stages_start(mbs_stages *s);
int mbs_stages_set_bounds(mbs_stages *s);
void mbs_stages_centre(mbs_stages_phase *p, int i);
void mbs_stages_write_point(mbs_stages *s);

/* Whether a warm start goes on with the solve before, as in a loop, and not with another problem's solution. */
static inline int mbs_stages_continues(const mbs_stages *s)
{
    return s->options.warm_start_init_point == 1;
}

/* Begin a warm start anew with its larger barrier parameter; 1: done, 0: it has no larger one, -1: no values. */
int mbs_stages_start_farther(mbs_stages *s, mbs_stages_phase *p);
real mbs_stages_least_barrier(const mbs_stages *s);

/* iterate.c: run a barrier problem until there is a status */
int mbs_stages_run(mbs_stages *s, mbs_stages_phase *p);
void mbs_stages_begin(mbs_stages *s, mbs_stages_phase *p);
void mbs_stages_mend_bounds(mbs_stages *s, mbs_stages_phase *p);

#endif

/* The Riccati recursion over stages, with equality constraints in them. */
#ifndef MBS_STAGES_RECURSION_H
#define MBS_STAGES_RECURSION_H

#include "complete.h"
#include "few.h"
#include "pivots.h"
#include "soft.h"

#ifdef MBS_STAGES_REALTIME
#define MBS_STAGES_SEARCHES 0 /* steps alone: no code and no memory for line searches, restoration and soft rows */
#else
#define MBS_STAGES_SEARCHES 1
#endif

/* A stage as the recursion sees it: dense matrices of outer variables, row by row. Zeros fill rows up to their width. */
typedef struct {
    int n, nv, ne, width; /* n = nx + nv */
    real *E, *F, *G, *H;  /* ne, next, ng, n rows; n columns each; the lower triangle of H */
    mbs_stages_few few;   /* numbers in rows of F */
} mbs_stages_dense;

/* Inner variables of a stage, which the first rows of e give; see condense.c. */
typedef struct {
    int n; /* 0: none */
    int capacity; /* the most nonzeros of both factors */
    int skip; /* first states that no inner equation reads, in whole lanes: V is 0 there */
    int curved; /* 1: H has nonzeros of inner variables */
    mbs_stages_pivots *pivots; /* of all stages of a kind */
    mbs_stages_factors factors; /* of a group of stages of a kind that follow each other */
    int lane;                   /* of this stage in them; 0: a group begins */
    real *V;        /* their variation with the outer ones, row by row; what is not `skip` begins with a line */
    int ld, shift;  /* numbers from row to row; before the first row */
    mbs_stages_few few; /* numbers in its rows, in columns from `skip` on */
    real *constant; /* of the inner variables, by the last right-hand side */
    int stale;      /* Jacobians are newer than V */
    int own;        /* pivots by the order were too small: complete pivoting, each time anew */
    int careful;    /* small pivots are left to the recursion */
    int missing;    /* inner variables without pivot */
    int poor;       /* the last factorisation that came to this stage found pivots by the order too small, and others */
    real left;      /* largest residual of rows without pivot, by the last right-hand side */
    int deferred, spare; /* as many of them are outer variables now; at most */
    int *variable, *row;  /* these, and the rows without pivot, as they are counted in the block */
} mbs_stages_inner;

/* Derivatives of a stage, and where its numbers are: w in variables, e, d and g in rows, s in slacks. */
typedef struct {
    int nx, nv, n, ne, ng, next; /* n = nx + nv; next: states of the next stage, 0 of the last one */
    int w, e, d, g, s;           /* where they begin */
    int equal;                   /* equal bounds that have room */
    int carried;                 /* first states that the next stage gets, each multiplied by a number, and that nothing
                                  * else here reads; in whole lanes */
    real curvature;              /* added to the cost of the recursion's variables */
    mbs_stages_matrix E, F, G, H; /* ne, next, ng, n rows; n columns each */
    mbs_stages_dense dense;       /* the same numbers without inner variables */
    mbs_stages_inner inner;
} mbs_stages_stage;

/* One step of the recursion: variables (x, v) with rows that hold exactly, reduced to what they cost x, and to rows
 * that x must meet. Matrices lie row by row, zeros fill rows up to the width of their columns: of (x, free) `width`. */
typedef struct {
    int nx, nv, n, capacity; /* the most rows */
    int rows, pivots, passed, reduced, width;
    int *row;                  /* the row that came to place i */
    int *column;               /* the column of the pivot of place i */
    int *order;                /* variables: x, free ones, pivots */
    real *lu;                  /* rows column by column, capacity apart; below pivots the factors of elimination */
    real *U, *T, *Y, *Q;       /* pivots = -(T (x, free) + t); U holds their rows, Q and Y what they cost */
    real *L;                   /* rows of the free ones: their coupling with x, and LT with the inverse of its diagonal */
    real *P, *C;               /* cost and rows of x: x.P x / 2 + p.x, C x + c = 0 */
    real *p, *c, *t, *l, *qp;  /* of the last right-hand side */
    int own;                   /* rows that are not conditions on the next state; they come first */
    real *linear;              /* the cost's derivatives by (x, v); then the step of these */
    real *constant;            /* of the rows; then their multipliers */
    real *ahead;               /* of d, where the step of (x, v) is 0 */
    real left;                 /* largest residual of rows without pivot */
    int lost;                  /* the last pivot of the free ones is as small as rounding */
} mbs_stages_step;

/* Memory of one worker. */
typedef struct {
    real *vector[8];               /* rows and variables of the largest stage */
    real *block, *right;           /* of inner variables: a block, rows of right-hand sides */
    real *together[3];             /* numbers of inner variables of several stages, in lanes */
    int *spots;
} mbs_stages_scratch;

/* Everything that one factorisation and its solutions share:
 *
 *     (H + diagonal + curvature) dw + JT dy = -rw,   J dw - compliance dy = -rc,   dw = 0 where fixed.
 *
 * The curvature is a number for each stage, of all variables but inner ones. J has the rows e, d, g. A row with compliance 0 holds exactly; inner rows of e do. The compliance of d is 0 in all rows, or in none. */
typedef struct {
    int stages, variables, rows;
    mbs_stages_stage *stage;
    mbs_stages_step *step, root;
    mbs_stages_soft *soft; /* from the prediction of stage k to the state of k + 1 */
    const char *fixed;
    real *diagonal, *compliance;
    int plain; /* 1: without H */
    int condensed; /* stages from here on are condensed, by the derivatives and the diagonal that are there */
    int dependent, soft_dynamics;
    int lost;     /* what failed last, a factorisation or refinement, may have failed for lost digits */
    int singular; /* stages whose inner equations do not determine the inner variables */
    real zero_pivot, small_pivot, zero_curvature, growth;
    real left; /* largest residual of dependent rows in the last sweep: 0 unless they contradict others */
    real *work[4];   /* blocks of the largest step */
    char *marks;     /* of a block of inner variables */
    const mbs_stages_team *team;
    mbs_stages_scratch *scratch; /* of each worker; the caller's thread has the first one between tasks */
} mbs_stages_recursion;

/* Do a task for all stages. */
void mbs_stages_for_all(const mbs_stages_recursion *r, mbs_stages_task task, void *data);

/* Factorise; returns -1, or the stage where the reduced Hessian is not positive definite. `again`: since the last call,
 * curvature and compliance alone have changed. */
int mbs_stages_factorise(mbs_stages_recursion *r, int again);

/* Solve once. */
void mbs_stages_sweep(mbs_stages_recursion *r, const real *rw, const real *rc, real *dw, real *dy);

/* How a solution changes where fixed first states change by `first`, an entry for each first state. The rows' right-hand
 * sides `zero` are 0. A sweep ahead alone; it needs hard dynamics. */
void mbs_stages_respond(mbs_stages_recursion *r, const real *first, const real *zero, real *dw, real *dy);

/* gradient += JT y */
void mbs_stages_add_transposed(const mbs_stages_recursion *r, const real *y, real *gradient);

/* The same for variables of stage k alone; and rows += J w for its rows. */
void mbs_stages_add_stage_both(const mbs_stages_recursion *r, int k, const real *w, real *rows, const real *y,
                               real *gradient);

#endif

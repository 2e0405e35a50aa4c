/* The Riccati recursion over stages, with equality constraints in them. */
#ifndef MBS_STAGES_RECURSION_H
#define MBS_STAGES_RECURSION_H

#include "matrix.h"
#include "soft.h"

/* The derivatives of a stage in dense matrices: what the recursion eliminates. */
typedef struct {
    real *E, *F, *G, *H; /* ne, next, ng, n rows; n columns each; the lower triangle of H */
} mbs_stages_dense;

/* Derivatives of a stage, and where its numbers are: w in variables, e, d and g in rows, s in slacks. */
typedef struct {
    int nx, nv, n, ne, ng, next; /* n = nx + nv; next: states of the next stage, 0 of the last one */
    int w, e, d, g, s;           /* where they begin */
    int equal;                   /* equal bounds that have room */
    mbs_stages_matrix E, F, G, H; /* ne, next, ng, n rows; n columns each */
    mbs_stages_dense dense;       /* the same numbers, or copies where there are patterns */
} mbs_stages_stage;

/* One step of the recursion: variables (x, v) with rows that hold exactly, reduced to what they cost x, and to rows
 * that x must meet. */
typedef struct {
    int nx, nv, n, capacity; /* the most rows */
    int rows, pivots, passed, reduced;
    int *row;                  /* the row that came to place i */
    int *column;               /* the column of the pivot of place i */
    int *order;                /* variables: pivots, free ones, x */
    real *lu;                  /* rows by n, capacity apart; below pivots the factors of elimination */
    real *U, *T, *Y, *Q;       /* pivots = -(T (free, x) + t); U holds their rows, Q and Y what they cost */
    real *L;                   /* Cholesky factor of the free ones, and below it the coupling with x */
    real *P, *C;               /* cost and rows of x: x.P x / 2 + p.x, C x + c = 0 */
    real *p, *c, *t, *l, *qp;  /* of the last right-hand side */
    real left;                 /* largest residual of rows without pivot */
} mbs_stages_step;

/* Everything that one factorisation and its solutions share:
 *
 *     (H + diagonal) dw + JT dy = -rw,   J dw - compliance dy = -rc,   dw = 0 where fixed.
 *
 * J has the rows e, d, g. A row with compliance 0 holds exactly. The compliance of d is 0 in all rows, or in none. */
typedef struct {
    int stages, variables, rows;
    mbs_stages_stage *stage;
    mbs_stages_step *step, root;
    mbs_stages_soft *soft; /* from the prediction of stage k to the state of k + 1 */
    const char *fixed;
    real *diagonal, *compliance;
    int plain; /* 1: without H */
    int dependent, soft_dynamics;
    real zero_pivot, zero_curvature;
    real left; /* largest residual of dependent rows in the last sweep: 0 unless they contradict others */
    real *work[4];   /* blocks of the largest step */
    real *vector[6]; /* its rows and variables */
} mbs_stages_recursion;

/* Factorise; returns -1, or the stage where the reduced Hessian is not positive definite. */
int mbs_stages_factorise(mbs_stages_recursion *r);

/* Solve once. */
void mbs_stages_sweep(mbs_stages_recursion *r, const real *rw, const real *rc, real *dw, real *dy);

/* How a solution changes where fixed first states change by `first`, an entry for each first state. The rows' right-hand
 * sides `zero` are 0. A sweep ahead alone; it needs hard dynamics. */
void mbs_stages_respond(mbs_stages_recursion *r, const real *first, const real *zero, real *dw, real *dy);

/* out += JT y, and out += J w */
void mbs_stages_add_transposed(const mbs_stages_recursion *r, const real *y, real *out);
void mbs_stages_add_rows(const mbs_stages_recursion *r, const real *w, real *out);

#endif

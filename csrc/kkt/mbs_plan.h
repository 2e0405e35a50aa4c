/* Plan the elimination of a sparse symmetric system: the order of the unknowns, and their fronts. */
#ifndef MBS_PLAN_H
#define MBS_PLAN_H

#define MBS_NONE (-1)

/* Unknowns with nearly the same neighbours are eliminated together, in a front: a dense system of their entries and of
 * the remainders of earlier fronts, its children (multifrontal: Duff and Reid, 1983). A front has its own unknowns
 * first, then their other neighbours. */
typedef struct {
    int holders; /* who may still use it; the last one frees it */
    int n, fronts;
    double expected; /* nanoseconds, about, to factorise a system if no unknown has to wait for a pivot */
    int *order;                      /* the unknown that is eliminated k-th; below, k is the number of an unknown */
    int *first;                      /* own unknowns of front f: first[f] .. first[f + 1] - 1 */
    int *begin;                      /* its others: rows[begin[f]] .. rows[begin[f + 1] - 1], ascending */
    int *rows, *place;               /* an other unknown of a front; where it is in the parent */
    int *parent;                     /* of a front: the one that takes what it leaves, a later one, or MBS_NONE */
    int *from;                       /* entries of front f: from[f] .. from[f + 1] - 1 */
    int *which, *at_row, *at_column; /* of an entry: which of the system's it is; where it goes in the lower triangle */
} mbs_plan;

/* Plan for a system of n unknowns. Its entries start[j] .. start[j + 1] - 1 lie in column j and the rows row[...]; of
 * each pair (i, j), (j, i) one is given. `weak` and `partner` are described in mbs_order.h. Returns NULL if memory runs
 * out. */
mbs_plan *mbs_make_plan(int n, const int *start, const int *row, const char *weak, const int *partner);
void mbs_release_plan(mbs_plan *plan);

#endif

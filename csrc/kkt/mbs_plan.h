/* Plan the elimination of a sparse symmetric system: what is eliminated when, and with what. */
#ifndef MBS_PLAN_H
#define MBS_PLAN_H

#define MBS_NONE (-1)

/* Unknowns that are joined with nearly the same others are eliminated together, in a front: a dense system of their
 * entries and of what fronts before, its children, left of theirs (multifrontal: Duff and Reid, 1983). A front has its
 * own unknowns first, then the others that these are joined with. */
typedef struct {
    int holders; /* who may still use it; the last one frees it */
    int n, fronts;
    int *order;                      /* the unknown that is eliminated k-th; below, unknowns go by k */
    int *first;                      /* own unknowns of front f: first[f] .. first[f + 1] - 1 */
    int *begin;                      /* its others: rows[begin[f]] .. rows[begin[f + 1] - 1], ascending */
    int *rows, *place;               /* an other unknown of a front; where it is in the parent */
    int *parent;                     /* of a front: the one that takes what it leaves, a later one, or MBS_NONE */
    int *from;                       /* entries of front f: from[f] .. from[f + 1] - 1 */
    int *which, *at_row, *at_column; /* of an entry: which of the system's it is; where it goes in the lower triangle */
} mbs_plan;

/* Plan for a system of n unknowns. Its entries start[j] .. start[j + 1] - 1 lie in column j and the rows row[...]; of
 * each pair (i, j), (j, i) one is told. `weak` and `partner` are those of mbs_order. Returns NULL if memory runs
 * out. */
mbs_plan *mbs_make_plan(int n, const int *start, const int *row, const char *weak, const int *partner);
void mbs_release_plan(mbs_plan *plan);

#endif

/* Order the unknowns of a sparse symmetric system so that its factors stay sparse. */
#ifndef MBS_ORDER_H
#define MBS_ORDER_H

/* Approximate minimum degree (Amestoy, Davis, Duff, 1996) for indefinite systems.
 *
 * `adjacent[start[i]] .. adjacent[start[i + 1] - 1]` are the neighbours of i, each edge told from both ends, i itself
 * not among them. An unknown is `weak` if it has no pivot of its own, as multipliers have none; then `partner[i]` is
 * another one, each other's, that it makes a pair with for a pivot, or -1. Weak ones without a partner wait until as
 * many that are not weak have been eliminated about them, which gives them pivots. order[k] becomes the unknown to be
 * eliminated k-th. Returns 0, or -1 if memory runs out. */
int mbs_order(int n, const int *start, const int *adjacent, const char *weak, const int *partner, int *order);

#endif

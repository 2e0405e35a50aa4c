/* Order the unknowns of a sparse symmetric system so that its factors stay sparse. */
#ifndef MBS_ORDER_H
#define MBS_ORDER_H

/* How many neighbours an unknown may have. Those with more, for example parameters of a whole trajectory, are eliminated
 * last: all others would meet them again and again. */
int mbs_most_neighbours(int n);

/* Approximate minimum degree (Amestoy, Davis, Duff, 1996) for indefinite systems.
 *
 * `adjacent[start[i]] .. adjacent[start[i + 1] - 1]` are the neighbours of i, each edge listed at both ends, without
 * i itself. An unknown is `weak` if it has no pivot by itself, as a multiplier; then `partner[i]` is its partner in a
 * pair with a pivot, mutually, or -1. A weak unknown without a partner waits until as many strong neighbours have been
 * eliminated, which gives it a pivot. order[k] becomes the unknown to be eliminated k-th. Returns 0, or -1 if memory
 * runs out. */
int mbs_order(int n, const int *start, const int *adjacent, const char *weak, const int *partner, int *order);

#endif

/* Find what gives unknowns of an optimality system their pivots. */
#ifndef MBS_PARTNERS_H
#define MBS_PARTNERS_H

/* The system is [H JT; J 0]: variables, then multipliers, of which no two are joined. A multiplier has no pivot of its
 * own, nor has a variable whose diagonal entry is 0, or nearly so: both are weak. Entries start[j] .. start[j + 1] - 1
 * lie in column j and the rows row[...], each once, with the values value[...]. */

/* Mark the weak unknowns; marks stay. Returns how many are new. `work` has room for 2 n. */
int mbs_mark_weak(int n, const int *start, const int *row, const double *value, char *weak, double *work);

/* Match each weak variable with a multiplier, and, if `all`, each other multiplier with a variable: partner[i] is the
 * other one, or -1. Returns 0, or -1 if memory runs out. */
int mbs_find_partners(int n, const int *start, const int *row, const double *value, const char *weak, int all,
                      int *partner);

#endif

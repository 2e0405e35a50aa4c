/* Small help for loops in C that call kernels: matrices from their nonzeros, and numbers that are finite. */
#ifndef MBS_ENTRIES_H
#define MBS_ENTRIES_H

#include "mbs_explicit.h"

/* Write a full matrix of `size` entries. */
static inline void mbs_fill_entries(mbs_entries entries, casadi_int size, casadi_real *full)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        full[k] = 0;
    for (k = 0; k < entries.entries; ++k)
        full[entries.place[k]] = entries.nonzeros[k];
}

static inline int mbs_is_finite(casadi_int size, const casadi_real *x)
{
    casadi_int i;
    for (i = 0; i < size; ++i)
        if (!(x[i] - x[i] == 0))
            return 0;
    return 1;
}

#endif

/* The callbacks of mbs_program.h, with the time that they take.
 *
 * Lies in a folder of csrc: compile with -I csrc/stages and -I csrc/program. */
#ifndef MBS_TIMED_PROGRAM_H
#define MBS_TIMED_PROGRAM_H

#include "mbs_program.h"

/* `context` of mbs_stages_problem. */
typedef struct {
    mbs_program_instance *instance;
    double seconds; /* in all callbacks so far */
} mbs_timed_program;

int mbs_timed_values(void *timed, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *f,
                     mbs_stages_real *e, mbs_stages_real *d, mbs_stages_real *g);
int mbs_timed_jacobians(void *timed, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real *df,
                        mbs_stages_real *de, mbs_stages_real *dd, mbs_stages_real *dg);
int mbs_timed_hessian(void *timed, int k, const mbs_stages_real *x, const mbs_stages_real *v, mbs_stages_real factor,
                      const mbs_stages_real *ye, const mbs_stages_real *yd, const mbs_stages_real *yg,
                      mbs_stages_real *h);

#endif

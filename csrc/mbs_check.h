/* Comparisons of kernels that must agree, for the check program that is generated beside them.
 *
 * Every comparison is made at the same pseudo-random states, prints a line, and returns 1 for a fault, else 0. Kernels
 * are called by their faces in CasADi's contract, since these can be treated alike, with the same numbers for inputs of
 * the same name. A number that is not a number, and a kernel that fails, are faults.
 */
#ifndef MBS_CHECK_H
#define MBS_CHECK_H

#include "mbs_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A kernel's face: what MBS_DECLARE_CASADI declares, and the kernel's name. */
typedef struct {
    const char *name;
    int (*call)(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem);
    casadi_int (*n_in)(void);
    casadi_int (*n_out)(void);
    const char *(*name_in)(casadi_int i);
    const casadi_int *(*sparsity_in)(casadi_int i);
    const casadi_int *(*sparsity_out)(casadi_int i);
    int (*diff_in)(casadi_int i);
} mbs_face;

#define MBS_FACE(name, f) {name, f, f##_n_in, f##_n_out, f##_name_in, f##_sparsity_in, f##_sparsity_out, f##_diff_in}

/* The run-time parameters, and what `setup` made of them: the inputs `p` (or `given_p`) and `h` of every kernel. To be
 * set before all comparisons.
 */
extern const casadi_real *mbs_check_p, *mbs_check_h;

/* The differentiated parameters: the input `theta` of every kernel that has it. To be set like these. */
extern const casadi_real *mbs_check_theta;

/* jac is the Jacobian of f, entries left out of its pattern included: against central differences. */
int mbs_check_jacobian(const mbs_face *f, const mbs_face *jac);

/* adj1 is the sum over the results of f of (d result / d input)^T adj_<result>: against the Jacobian. */
int mbs_check_adjoint(const mbs_face *f, const mbs_face *jac, const mbs_face *adj1);

/* f and g have the same first result. */
int mbs_check_equal(const mbs_face *f, const mbs_face *g);

/* The result of f is the end of the first result of g: sensors are the last of the frames. */
int mbs_check_tail(const mbs_face *f, const mbs_face *g);

/* M qdd, with M of semi, is what the residual of impl gains by qdd. */
int mbs_check_mass_matrix(const mbs_face *semi, const mbs_face *impl);

/* c of semi is the residual of impl without accelerations and inputs. */
int mbs_check_bias(const mbs_face *semi, const mbs_face *impl);

/* The residual of impl is zero at the accelerations that f gives. */
int mbs_check_accelerations(const mbs_face *f, const mbs_face *impl);

/* The results of f at the first state, one after the other, are as given: rounded from 50 digits. */
int mbs_check_results(const mbs_face *f, const double *results);

/* The same where the mass matrix is solved with. */
int mbs_check_solution(const mbs_face *f, const double *results);

/* f and g give the same accelerations. */
int mbs_check_same_accelerations(const mbs_face *f, const mbs_face *g);

#ifdef __cplusplus
}
#endif

#endif

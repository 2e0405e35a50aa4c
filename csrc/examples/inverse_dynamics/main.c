/* Inverse dynamics of the arm at one state: the joint forces that make it move so. */
#include <stdio.h>

#include "arm_pendulum.h"

enum { JOINTS = arm_pendulum_impl_NNZ_q, INPUTS = arm_pendulum_impl_NNZ_u };

int main(void)
{
    const mbs_real q[JOINTS] = {-0.3232, -0.1877, -0.6719, -0.4891, -0.2332, -0.1754};
    const mbs_real qd[JOINTS] = {-0.3975, -0.9778, 0.3483, -1.0947, -1.9585, -1.2008};
    const mbs_real qdd[JOINTS] = {-2.993, 2.5231, -0.6432, 1.7052, -2.4683, 2.0808};
    const mbs_real u[INPUTS] = {0};
    mbs_real Phi[JOINTS]; /* Phi(q, qd, qdd) - Q(q, qd, u): what u = 0 leaves open */
    int i;

    if (arm_pendulum_compute_impl(q, qd, qdd, u, Phi)) {
        fputs("the kernel failed\n", stderr);
        return 1;
    }
    for (i = 0; i < JOINTS; ++i)
        printf("joint %d: %.15g N m\n", i + 1, (double)Phi[i]);
    return 0;
}

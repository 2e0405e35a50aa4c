/* Inverse dynamics of a thousand arms, as many at once as the processor can. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "arm_pendulum.h"
#include "mbs_many.h"

MBS_DECLARE_MANY(2);
MBS_DECLARE_SEVERAL(arm_pendulum_impl, 2);
#if defined(__x86_64__)
MBS_DECLARE_MANY(4);
MBS_DECLARE_SEVERAL(arm_pendulum_impl, 4);
MBS_DECLARE_MANY(8);
MBS_DECLARE_SEVERAL(arm_pendulum_impl, 8);
#endif

enum { ARMS = 1000, JOINTS = arm_pendulum_impl_NNZ_q, INPUTS = arm_pendulum_impl_NNZ_u };

/* Compute all arms; returns how many were computed at once. */
static int compute(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out, int *status)
{
    int at_once = 2;
    void *room;
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        at_once = 8;
    else if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        at_once = 4;
    if (at_once == 8) {
        room = malloc(mbs_room_of_many_at_8(n_in, in, n_out, out));
        mbs_compute_many_at_8(arm_pendulum_impl, arm_pendulum_impl_at_8, ARMS, 0, ARMS, n_in, in, n_out, out, room, status);
    } else if (at_once == 4) {
        room = malloc(mbs_room_of_many_at_4(n_in, in, n_out, out));
        mbs_compute_many_at_4(arm_pendulum_impl, arm_pendulum_impl_at_4, ARMS, 0, ARMS, n_in, in, n_out, out, room, status);
    } else
#endif
    {
        room = malloc(mbs_room_of_many_at_2(n_in, in, n_out, out));
        mbs_compute_many_at_2(arm_pendulum_impl, arm_pendulum_impl_at_2, ARMS, 0, ARMS, n_in, in, n_out, out, room, status);
    }
    free(room);
    return at_once;
}

int main(void)
{
    static mbs_real q[ARMS][JOINTS], qd[ARMS][JOINTS], qdd[ARMS][JOINTS], Phi[ARMS][JOINTS];
    static const mbs_real u[INPUTS] = {0}; /* of all arms */
    static int status[ARMS];
    mbs_given in[4] = {{q[0], JOINTS, JOINTS, 0}, {qd[0], JOINTS, JOINTS, 0}, {qdd[0], JOINTS, JOINTS, 0}, {u, 0, INPUTS, 0}};
    mbs_found out[1] = {{Phi[0], JOINTS, 1, JOINTS, JOINTS, 0}};
    mbs_real alone[JOINTS], difference = 0;
    int arm, joint, failures = 0;

    for (arm = 0; arm < ARMS; ++arm)
        for (joint = 0; joint < JOINTS; ++joint) {
            q[arm][joint] = 0.001 * arm + 0.1 * joint;
            qd[arm][joint] = 1 - 0.001 * arm;
            qdd[arm][joint] = 0.5 * joint;
        }
    printf("%d arms at once\n", compute(4, in, 1, out, status));
    for (arm = 0; arm < ARMS; ++arm) {
        failures += status[arm] != 0;
        arm_pendulum_compute_impl(q[arm], qd[arm], qdd[arm], u, alone);
        for (joint = 0; joint < JOINTS; ++joint)
            difference = fmax(difference, fabs(alone[joint] - Phi[arm][joint]));
    }
    printf("%d failures, differences up to %.1e N m\n", failures, (double)difference);
    printf("the last arm: %.12g %.12g N m\n", (double)Phi[ARMS - 1][0], (double)Phi[ARMS - 1][JOINTS - 1]);
    return failures != 0;
}

/* Inverse dynamics of a thousand arms, as many at once as the processor can. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "arm_pendulum_many.h"

enum { ARMS = 1000, JOINTS = arm_pendulum_impl_NNZ_q, INPUTS = arm_pendulum_impl_NNZ_u };

int main(void)
{
    static mbs_real q[ARMS][JOINTS], qd[ARMS][JOINTS], qdd[ARMS][JOINTS], Phi[ARMS][JOINTS];
    static const mbs_real u[INPUTS] = {0}; /* of all arms */
    static int status[ARMS];
    const mbs_given in[] = {{q[0], JOINTS, JOINTS, 0}, {qd[0], JOINTS, JOINTS, 0}, {qdd[0], JOINTS, JOINTS, 0}, {u, 0, INPUTS, 0}};
    const mbs_found out[] = {{Phi[0], JOINTS, 1, JOINTS, JOINTS, 0}};
    void *room = malloc(arm_pendulum_room_of_many(arm_pendulum_many_impl_N_IN, in, arm_pendulum_many_impl_N_OUT, out));
    mbs_real alone[JOINTS], difference = 0;
    int arm, joint, failures;

    for (arm = 0; arm < ARMS; ++arm)
        for (joint = 0; joint < JOINTS; ++joint) {
            q[arm][joint] = 0.001 * arm + 0.1 * joint;
            qd[arm][joint] = 1 - 0.001 * arm;
            qdd[arm][joint] = 0.5 * joint;
        }
    failures = (int)arm_pendulum_many_impl(ARMS, 0, ARMS, in, out, room, status);
    free(room);
    printf("%d arms at once\n", arm_pendulum_states_at_once());
    for (arm = 0; arm < ARMS; ++arm) {
        arm_pendulum_compute_impl(q[arm], qd[arm], qdd[arm], u, alone);
        for (joint = 0; joint < JOINTS; ++joint)
            difference = fmax(difference, fabs(alone[joint] - Phi[arm][joint]));
    }
    printf("%d failures, differences up to %.1e N m\n", failures, (double)difference);
    printf("the last arm: %.12g %.12g N m\n", (double)Phi[ARMS - 1][0], (double)Phi[ARMS - 1][JOINTS - 1]);
    return failures != 0;
}

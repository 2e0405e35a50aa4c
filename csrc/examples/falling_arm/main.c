/* The arm falls: its equations of motion, qdd = nu(q, qd, Q) without any input, integrated by Runge and Kutta's method.
 *
 * Prints the state at every hundredth of a second as comma-separated values.
 */
#include <stdio.h>

#include "arm_pendulum.h"

enum { JOINTS = arm_pendulum_exp2_NNZ_q, INPUTS = arm_pendulum_exp2_NNZ_u, STATES = 2 * JOINTS };
enum { STEPS = 1000, PRINTED = 10 }; /* of a millisecond; every tenth is printed */

/* x = (q, qd); its derivative is (qd, qdd). Returns the status of the kernel. */
static int derive(const mbs_real *x, mbs_real *xd)
{
    const mbs_real u[INPUTS] = {0};
    int i;
    for (i = 0; i < JOINTS; ++i)
        xd[i] = x[JOINTS + i];
    return arm_pendulum_compute_exp2(x, x + JOINTS, u, xd + JOINTS);
}

/* Go on by the time h, with four derivatives: at the beginning, twice in the middle, and at the end. */
static int step(mbs_real *x, mbs_real h)
{
    static const mbs_real ahead[] = {0, 0.5, 0.5, 1}, weight[] = {1, 2, 2, 1};
    mbs_real at[STATES], slope[STATES] = {0}, sum[STATES] = {0};
    int i, k;
    for (k = 0; k < 4; ++k) {
        int status;
        for (i = 0; i < STATES; ++i)
            at[i] = x[i] + ahead[k] * h * slope[i];
        status = derive(at, slope);
        if (status)
            return status;
        for (i = 0; i < STATES; ++i)
            sum[i] += weight[k] * slope[i];
    }
    for (i = 0; i < STATES; ++i)
        x[i] += h / 6 * sum[i];
    return 0;
}

int main(void)
{
    const mbs_real h = 1e-3;
    mbs_real x[STATES] = {0, 0.3, -0.8, 0.2, 0.1, -0.1};
    int n, i;
    printf("t,q1,q2,q3,q4,q5,q6,qd1,qd2,qd3,qd4,qd5,qd6\n");
    for (n = 0; n <= STEPS; ++n) {
        const int status = n ? step(x, h) : 0;
        if (status) {
            fprintf(stderr, "the kernel failed at joint %d, t = %g s\n", status, n * (double)h);
            return 1;
        }
        if (n % PRINTED)
            continue;
        printf("%.3f", n * (double)h);
        for (i = 0; i < STATES; ++i)
            printf(",%.12g", (double)x[i]);
        printf("\n");
    }
    return 0;
}

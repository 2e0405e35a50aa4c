/* Swing the pendulum up, and print its motion. */
#include "pendulum.h"

#include <stdio.h>
#include <stdlib.h>

static void print_solution(const mbs_stages *solver, const mbs_stages_result *result)
{
    const mbs_stages_point point = mbs_stages_iterate(solver);
    int k;
    printf("%s\n%d iterations, effort %.6f\n", mbs_stages_explain(result->status), result->iterations,
           (double)result->cost);
    for (k = 0; k <= PENDULUM_INTERVALS; k += 10) {
        const mbs_stages_place place = mbs_stages_places(solver, k);
        printf("%5.2f s  angle %7.4f  rate %7.4f\n", (double)((mbs_stages_real)k * PENDULUM_STEP),
               (double)point.w[place.x], (double)point.w[place.x + 1]);
    }
}

int main(void)
{
    static pendulum p;
    mbs_stages_result result;
    mbs_stages *solver;
    void *workspace;
    size_t bytes;
    pendulum_describe(&p, 4);
    bytes = mbs_stages_bytes(&p.problem);
    workspace = malloc(bytes);
    solver = mbs_stages_create(&p.problem, workspace, bytes);
    if (solver == NULL)
        return 1;
    result = mbs_stages_solve(solver, NULL); /* from zeros */
    print_solution(solver, &result);
    free(workspace);
    return result.status == MBS_STAGES_SOLVED ? 0 : 2;
}

/* Swing the pendulum up on a bare machine: docs/microcontroller.md builds and runs this. */
#include "mbs_bare.h"
#include "pendulum.h"

/* Memory of the solver, aligned as it must be. */
static char workspace[400 * 1024] __attribute__((aligned(16)));
static pendulum problem;

int main(void)
{
    mbs_stages_options options = mbs_stages_default_options();
    mbs_stages_result result;
    mbs_stages *solver;
    unsigned long began;
    int k;
    pendulum_describe(&problem, 4);
    mbs_bare_print_integer("bytes", (long)mbs_stages_bytes(&problem.problem));
    solver = mbs_stages_create(&problem.problem, workspace, sizeof workspace);
    if (solver == NULL)
        return 1;
    options.max_iter = 100;
    began = mbs_bare_instructions();
    result = mbs_stages_solve(solver, &options);
    mbs_bare_print_integer("instructions", (long)(mbs_bare_instructions() - began));
    mbs_bare_print(mbs_stages_explain(result.status));
    mbs_bare_print("\n");
    mbs_bare_print_integer("iterations", result.iterations);
    mbs_bare_print_float("effort", (float)result.cost);
    for (k = 0; k <= PENDULUM_INTERVALS; k += 10)
        mbs_bare_print_float("angle", (float)mbs_stages_iterate(solver).w[mbs_stages_places(solver, k).x]);
    return result.status == MBS_STAGES_SOLVED ? 0 : 2;
}

/* MuJoCo's forward dynamics with soft loops, in CasADi's contract, and motions by its own steps.
 *
 * mjl_load(XML) comes first; forces u act on the joints whose numbers mjl_load is given. */
#include <mujoco/mujoco.h>
#include <string.h>
#include <time.h>

static mjModel *model;
static mjData *data;
static int actuated[256], inputs;

int mjl_load(const char *path, const int *joints, int size)
{
    char error[1000];
    int k;
    if (data) mj_deleteData(data);
    if (model) mj_deleteModel(model);
    data = NULL;
    model = mj_loadXML(path, NULL, error, sizeof error);
    if (!model || size > 256) return 1;
    data = mj_makeData(model);
    inputs = size;
    for (k = 0; k < size; ++k) actuated[k] = joints[k];
    return 0;
}

static void set(const double *q, const double *qd)
{
    memcpy(data->qpos, q, model->nq * sizeof *q);
    memcpy(data->qvel, qd, model->nv * sizeof *qd);
}

int mjl_exp1(const double **arg, double **res, long long *iw, double *w, int mem)
{
    int k;
    (void)iw, (void)w, (void)mem;
    set(arg[0], arg[1]);
    for (k = 0; k < inputs; ++k) data->qfrc_applied[actuated[k]] = arg[2][k];
    mj_forward(model, data);
    memcpy(res[0], data->qacc, model->nv * sizeof **res);
    return 0;
}

/* Take steps from q, qd, with constant forces on all joints, and write the state there. */
int mjl_simulate(int integrator, double step, long long steps, const double *forces, double *q, double *qd,
                 double *seconds)
{
    const clock_t begin = clock();
    long long k;
    mj_resetData(model, data);
    model->opt.timestep = step;
    model->opt.integrator = integrator;
    set(q, qd);
    memcpy(data->qfrc_applied, forces, model->nv * sizeof *forces);
    for (k = 0; k < steps; ++k) mj_step(model, data);
    *seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
    memcpy(q, data->qpos, model->nq * sizeof *q);
    memcpy(qd, data->qvel, model->nv * sizeof *qd);
    return 0;
}

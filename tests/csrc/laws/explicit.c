#include "laws.h"

#include "../../../csrc/mbs_explicit.c"
#include "../../../csrc/mbs_least.c"

/* One equation in two joints, J = (1, 2), whose decomposed J is off by a part of it. */
static casadi_real qd[2], hd[1], h[1], q[2];
static int calls;

static int find_rates(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    ++calls;
    hd[0] = qd[0] + 2 * qd[1];
    return 0;
}

/* Close velocities with a J that is off by `part`; return by how much they stay open. */
static casadi_real close_off(casadi_real part, casadi_real way, casadi_real a, casadi_real b)
{
    casadi_real B[1] = {1 + part}, volume, x[4], g[2];
    casadi_int depends[1] = {0}, row[1];
    mbs_explicit plant;
    mbs_manner manner;
    mbs_outcome outcome;
    mbs_run r;
    memset(&plant, 0, sizeof plant), memset(&manner, 0, sizeof manner), memset(&r, 0, sizeof r);
    memset(&outcome, 0, sizeof outcome);
    plant.n = plant.nq = 2, plant.e = 1, plant.q = q, plant.qd = qd, plant.h = h, plant.hd = hd, plant.rates.f = find_rates;
    manner.keeping = MBS_PARTITIONING;
    r.p = &plant, r.how = &manner, r.out = &outcome, r.B = B, r.row = row, r.depends = depends, r.x = x, r.g = g;
    mbs_lu_factorise(1, B, row, &volume);
    qd[0] = a, qd[1] = b, calls = 0;
    LAW("velocities can be closed", close_velocities(&r, way) == 0);
    LAW("dependent joints alone change", qd[1] == b);
    return fabs(qd[0] + 2 * qd[1]);
}

/* The largest entry is 5, of the second equation and joint; without that joint, the first equation moves the third by 3. */
static void choose_joints(void)
{
    casadi_real J[6] = {(casadi_real)0.1, 4, 3, -2, 5, 0}, B[6], volume;
    casadi_int moves[3] = {0, 1, 2}, best[3];
    mbs_explicit plant;
    mbs_run r;
    memset(&plant, 0, sizeof plant), memset(&r, 0, sizeof r);
    plant.n = 3, plant.e = 2, r.p = &plant, r.free = 3, r.moves = moves, r.best = best, r.J = J, r.B = B;
    volume = find_best(&r);
    LAW("the best dependent joints have the largest pivots", best[0] == 1 && best[1] == 2 && best[2] == 0);
    LAW("whose product is the determinant", fabs(volume - log(15)) < 1e-14);
    J[0] = 0, J[1] = 4, J[2] = 0, J[3] = 0;
    LAW("where equations repeat each other, there is one pivot", fabs(find_best(&r) - log(5)) < 1e-14 && best[0] == 1);
}

static casadi_real force[1], pull[1];

static int fall(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    pull[0] = force[0];
    return 0;
}

/* Three parts of a motion by Euler's method, each with two rows of inputs: of its stage, and of its end. */
static void read_parts(void)
{
    static const casadi_real A[1] = {0}, b[1] = {1}, c[1] = {0}, times[3] = {0, 1, 2}, lengths[3] = {0.5, 0.25, 1};
    static const casadi_real inputs[6] = {1, -7, 20, -7, 300, -7}, starts[6] = {0, 1, 0, 2, 0, 3};
    casadi_real ends[6], reals[64];
    casadi_int integers[16], k;
    mbs_explicit plant;
    mbs_manner manner;
    mbs_outcome outcome;
    memset(&plant, 0, sizeof plant), memset(&manner, 0, sizeof manner);
    plant.n = plant.nq = plant.m = 1, plant.q = q, plant.qd = qd, plant.v = force, plant.qdd = pull, plant.direct.f = fall;
    manner.stages = 1, manner.order = 1, manner.A = A, manner.b = b, manner.c = c;
    LAW("there is room", mbs_explicit_reals(&plant, 1) <= 64 && mbs_explicit_integers(&plant) <= 16);
    mbs_explicit_read(&plant, &manner, 3, times, lengths, inputs, NULL, starts, ends, reals, integers, &outcome);
    LAW("all parts are read", outcome.status == 0 && outcome.steps == 3);
    for (k = 0; k < 3; ++k) {
        LAW("each from its own start", ends[2 * k] == lengths[k] * starts[2 * k + 1]);
        LAW("with its own inputs", ends[2 * k + 1] == starts[2 * k + 1] + lengths[k] * inputs[2 * k]);
    }
}

int main(void)
{
    read_parts();
    choose_joints();
    LAW("one step is enough with the J of the place", close_off(0, 0, 5, 3) < 1e-14 && calls == 1);
    LAW("with another one, steps go on until they are rounding", close_off(1e-3, 1e-3, 5, 3) < 1e-14 && calls > 3);
    LAW("beside the velocities, which may be large", close_off(1e-3, 1e-3, 5e6, 3e6) < 1e-7 && calls > 3);
    LAW("or small", close_off(1e-3, 1e-3, 5e-3, 3e-3) < 1e-15 && calls > 2);
    return broken > 0;
}

/* Integrate a motion with steps of a fixed length, explicitly. */
#include "mbs_simulate.h"

#define RUNAWAY (-1)
#define LOST 1e3 /* a pivot below n LOST epsilon of its diagonal entry has lost its digits */

/* Solve M x = -x in place by M = L D L^T; of M the lower triangle is used, and overwritten. Returns 0, or j for a pivot of
 * joint j that has lost its digits. */
static int solve(casadi_int n, casadi_real *M, casadi_real *x)
{
    casadi_int i, j, k;
    for (j = 0; j < n; ++j) {
        const casadi_real scale = M[j * n + j];
        casadi_real pivot = scale;
        for (k = 0; k < j; ++k)
            pivot -= M[j * n + k] * M[j * n + k] * M[k * n + k];
        if (!(pivot > (casadi_real)n * MBS_THRESHOLD(LOST) * scale))
            return (int)(j + 1);
        M[j * n + j] = pivot;
        for (i = j + 1; i < n; ++i) {
            casadi_real entry = M[i * n + j];
            for (k = 0; k < j; ++k)
                entry -= M[i * n + k] * M[j * n + k] * M[k * n + k];
            M[i * n + j] = entry / pivot;
        }
    }
    for (i = 0; i < n; ++i) {
        x[i] = -x[i];
        for (k = 0; k < i; ++k)
            x[i] -= M[i * n + k] * x[k];
    }
    for (i = 0; i < n; ++i)
        x[i] /= M[i * n + i];
    for (i = n; i-- > 0;)
        for (k = i + 1; k < n; ++k)
            x[i] -= M[k * n + i] * x[k];
    return 0;
}

/* Compute the accelerations at plant's q, qd and v. */
static int accelerate(const mbs_plant *plant)
{
    casadi_int k;
    int status = plant->rate(plant->rate_arg, plant->rate_res, 0, 0, 0);
    if (status || !plant->mass)
        return status;
    status = plant->mass(plant->mass_arg, plant->mass_res, 0, 0, 0);
    if (status)
        return status;
    for (k = 0; k < plant->n * plant->n; ++k)
        plant->matrix[k] = 0;
    for (k = 0; k < plant->entries; ++k)
        plant->matrix[plant->place[k]] = plant->M[k];
    return solve(plant->n, plant->matrix, plant->qdd);
}

/* Write what the coordinates change by at plant's q and qd. */
static int move(const mbs_plant *plant, casadi_real *rate)
{
    casadi_int c;
    const int status = plant->change ? plant->change(plant->change_arg, plant->change_res, 0, 0, 0) : 0;
    for (c = 0; c < plant->nq; ++c)
        rate[c] = plant->change ? plant->qt[c] : plant->qd[c];
    return status;
}

static int is_finite(casadi_int size, const casadi_real *x)
{
    casadi_int i;
    for (i = 0; i < size; ++i)
        if (!(x[i] - x[i] == 0))
            return 0;
    return 1;
}

casadi_int mbs_simulate_rk(const mbs_plant *plant, casadi_int stages, const casadi_real *A, const casadi_real *b,
                           casadi_real h, casadi_int steps, const casadi_real *v, casadi_int v_step,
                           casadi_real *states, casadi_real *work, int *status)
{
    const casadi_int n = plant->n, nq = plant->nq, size = nq + n;
    casadi_int step, i, j, c;
    for (step = 0; step < steps; ++step) {
        const casadi_real *x = states + size * step;
        casadi_real *y = states + size * (step + 1);
        for (i = 0; i < stages; ++i) {
            casadi_real *rate = work + size * i;
            for (c = 0; c < size; ++c) {
                casadi_real sum = 0;
                for (j = 0; j < i; ++j)
                    sum += A[i * stages + j] * work[size * j + c];
                *(c < nq ? plant->q + c : plant->qd + (c - nq)) = x[c] + h * sum;
            }
            for (c = 0; c < plant->m; ++c)
                plant->v[c] = v[(step * stages + i) * v_step + c];
            *status = accelerate(plant);
            if (!*status)
                *status = move(plant, rate);
            if (*status)
                return step;
            for (c = 0; c < n; ++c)
                rate[nq + c] = plant->qdd[c];
        }
        for (c = 0; c < size; ++c) {
            casadi_real sum = 0;
            for (i = 0; i < stages; ++i)
                sum += b[i] * work[size * i + c];
            y[c] = x[c] + h * sum;
        }
        if (!is_finite(size, y)) {
            *status = RUNAWAY;
            return step;
        }
    }
    *status = 0;
    return steps;
}

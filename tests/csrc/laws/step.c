#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/step.c"

/* Two rows of two unknowns in room for three; the third row is of an earlier problem. */
static real lu[6], weight[3];
static int row[3], column[3];
static char used[2];
static mbs_stages_step step;

static void anew(real a, real b, real c, real d)
{
    const real numbers[6] = {a, b, 1000, c, d, 1000};
    int i;
    memset(&step, 0, sizeof step);
    step.n = 2, step.capacity = 3, step.rows = 2, step.lu = lu, step.row = row, step.column = column;
    memcpy(lu, numbers, sizeof lu);
    for (i = 0; i < 3; ++i)
        row[i] = i, column[i] = -1, weight[i] = 1000;
    used[0] = used[1] = 0;
    weigh_rows(&step, weight);
    weight[2] = 1;
}

/* --- steps of all sizes: the cost z.Q z / 2 + q.z of z = (x,
    v) with rows M z + m = 0 -------------------------------- */

enum { MOST = 48, ALL = MOST * MOST };
static unsigned seed = 5;
static real Q[MOST * MOST], q[MOST], M[MOST * MOST], m[MOST], z0[MOST];
static real rows_of[ALL], U[ALL], T[ALL], Y[ALL], QQ[ALL], L[ALL], P[ALL], C[ALL];
static real p[MOST], c[MOST], t[MOST], l[MOST], qp[MOST];
static real quadratic[ALL], first_work[ALL], second_work[ALL];
static int row_of[MOST], column_of[MOST], order[MOST];

static real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (real)(seed / 65536 % 2001) / 1000 - 1;
}

static void open_step(int nx, int nv, int rows)
{
    int i, j;
    const int n = nx + nv, width = mbs_stages_width(n);
    memset(&step, 0, sizeof step);
    step.nx = nx, step.nv = nv, step.n = n, step.capacity = MOST, step.rows = rows, step.row = row_of;
    step.column = column_of, step.order = order, step.lu = rows_of, step.U = U, step.T = T, step.Y = Y, step.Q = QQ;
    step.L = L, step.P = P, step.C = C, step.p = p, step.c = c, step.t = t, step.l = l, step.qp = qp;
    for (i = 0; i < ALL; ++i) /* nothing is read before it is written */
        U[i] = T[i] = Y[i] = QQ[i] = L[i] = P[i] = C[i] = first_work[i] = second_work[i] = rows_of[i] = (real)NAN;
    for (j = 0; j < n; ++j)
        for (i = 0; i < rows; ++i)
            rows_of[j * MOST + i] = M[i * MOST + j];
    memset(quadratic, 0, sizeof quadratic);
    for (i = 0; i < n; ++i)
        for (j = 0; j <= i; ++j)
            quadratic[i * width + j] = Q[i * MOST + j];
}

static int reduce(real zero_pivot, real zero_curvature)
{
    real *const work[2] = {first_work, second_work};
    return mbs_stages_reduce(&step, quadratic, work, zero_pivot, zero_curvature);
}

/* Draw a positive definite cost, and rows that hold at a point; some rows are of x alone, some repeat others. */
static void draw_step(int n, int nx, int rows, int kind)
{
    static real root[ALL];
    int i, j, k;
    for (i = 0; i < ALL; ++i)
        root[i] = draw(), M[i] = draw();
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            for (k = 0, Q[i * MOST + j] = i == j ? 1 : 0; k < n; ++k)
                Q[i * MOST + j] += root[i * MOST + k] * root[j * MOST + k];
    if (kind == 1 && rows > 0)
        for (j = nx; j < n; ++j)
            M[j] = 0;
    if (kind == 2 && rows > 2)
        for (j = 0; j < n; ++j)
            M[2 * MOST + j] = M[j] - 2 * M[MOST + j];
    for (i = 0; i < n; ++i)
        z0[i] = draw(), q[i] = draw();
    for (i = 0; i < rows; ++i)
        for (k = 0, m[i] = 0; k < n; ++k)
            m[i] -= M[i * MOST + k] * z0[k];
}

/* A step for the x of the point: all rows hold, the cost has no derivative by v,
 * and by x the one of its reduced form. */
static void meet(int nx, int nv, int rows, int kind)
{
    const int n = nx + nv, width = mbs_stages_width(nx);
    real z[MOST], y[MOST], passed[MOST], vector[4 * MOST], constant[MOST];
    int i, j;
    draw_step(n, nx, rows, kind);
    open_step(nx, nv, rows);
    LAW("a convex step is reduced", reduce((real)1e-9, (real)1e-12) == 0);
    for (i = 0; i < rows; ++i)
        passed[i] = draw(), constant[i] = m[i], y[i] = 77;
    mbs_stages_step_back(&step, q, constant, vector);
    LAW("rows that hold leave nothing", step.left < 1e-11);
    mbs_stages_step_ahead(&step, z0, passed, z, y, vector);
    for (i = 0; i < rows; ++i) {
        real sum = m[i];
        for (j = 0; j < n; ++j)
            sum += M[i * MOST + j] * z[j];
        LAW("rows hold", real_abs(sum) < 1e-10);
    }
    for (i = 0; i < step.passed; ++i) {
        real sum = c[i];
        for (j = 0; j < nx; ++j)
            sum += C[i * width + j] * z0[j];
        LAW("as do rows of x", real_abs(sum) < 1e-10);
    }
    for (j = 0; j < n; ++j) {
        real slope = q[j], reduced_slope = 0;
        for (i = 0; i < n; ++i)
            slope += Q[j * MOST + i] * z[i];
        for (i = 0; i < rows; ++i)
            slope += M[i * MOST + j] * y[i];
        for (i = 0; i < nx && j < nx; ++i)
            reduced_slope += P[j * width + i] * z0[i];
        for (i = 0; i < step.passed && j < nx; ++i)
            reduced_slope += C[i * width + j] * passed[i];
        LAW("the cost changes by x alone, as its reduced form does",
            real_abs(slope - reduced_slope - (j < nx ? p[j] : 0)) < 1e-9);
        LAW("x is kept", j >= nx || z[j] == z0[j]);
    }
    for (i = 0; i < nx; ++i) {
        for (j = 0; j < nx; ++j)
            LAW("the cost of x is symmetric", P[i * width + j] == P[j * width + i]);
        for (j = nx; j < width; ++j)
            LAW("zeros fill rows", P[i * width + j] == 0);
    }
}

static void steps(void)
{
    int turn, nx, nv, rows, kind, rank;
    for (turn = 0; turn < 3; ++turn)
        for (nx = 0; nx < 4; ++nx)
            for (nv = 1; nv < 5; ++nv)
                for (rows = 0; rows <= nx + nv && rows < 6 && !broken; ++rows)
                    for (kind = 0; kind < 3; ++kind) {
                        meet(nx, nv, rows, kind);
                        rank = rows - (kind == 2 && rows > 2);
                        if (kind == 1 && nx == 0 && rows > 0)
                            --rank;
                        LAW("rows that are independent have a pivot", step.pivots + step.passed == rank);
                        LAW("as many of v as there are", kind == 1 || step.pivots == (rank < nv ? rank : nv));
                    }
    for (nv = SMALL_BLOCK - 1; nv + 3 <= MOST; ++nv)
        for (nx = 0; nx < 4; nx += 3)
            meet(nx, nv, 0, 0), meet(nx, nv, 2, 0);
}

/* Rows that contradict each other by 0.5, beside one that is sound. */
static void contradictions(void)
{
    real constant[MOST], vector[4 * MOST];
    draw_step(3, 1, 3, 2);
    open_step(1, 2, 3), reduce((real)1e-9, (real)1e-12);
    memcpy(constant, m, sizeof constant), constant[2] += (real)0.5;
    mbs_stages_step_back(&step, q, constant, vector);
    LAW("what rows contradict is found", step.left > 0.1 && step.left < 2);
}

/* Two rows (1 1), (1 1+e), and costs (1 a; a 1). */
static void limits(void)
{
    int k;
    for (k = 0; k < 2; ++k) {
        memset(Q, 0, sizeof Q), Q[0] = Q[MOST + 1] = 1;
        M[0] = M[1] = M[MOST] = 1, M[MOST + 1] = 1 + (real)(k ? 1.1e-6 : 0.9e-6);
        open_step(0, 2, 2);
        LAW("a pivot is above a share of its row", reduce((real)1e-6, (real)1e-9) == 0 && step.pivots == 1 + k);
        Q[MOST] = Q[1] = real_sqrt((real)(k ? 0.49 : 0.51));
        open_step(0, 2, 0);
        LAW("curvature above a share of itself", reduce((real)1e-6, (real)0.5) == (k ? 0 : -1));
        Q[MOST] = Q[1] = real_sqrt((real)(k ? 1.49 : 1.51)), Q[MOST + 1] = -1;
        open_step(0, 2, 0);
        LAW("and no negative one", reduce((real)1e-6, (real)0.5) == -1);
    }
}

int main(void)
{
    anew(1, 8, 4, 10);
    LAW("a row's weight is the inverse of its largest entry",
        near(weight[0], (real)0.25) && near(weight[1], (real)0.1));
    LAW("all unknowns have a pivot", eliminate_clear(&step, weight, used, 0, 2) == 2 && used[0] && used[1]);
    LAW("the first one in the row where its share is largest", row[0] == 1 && row[1] == 0 && column[0] == 0);
    LAW("with the factor of elimination below", near(lu[1], (real)0.125) && near(lu[4], 4 - (real)1.25));
    LAW("other rows are left alone", lu[2] == 1000 && lu[5] == 1000 && row[2] == 2);
    anew(1, 1, 5, 5);
    LAW("a small share in its row is no clear pivot", eliminate_clear(&step, weight, used, 0, 1) == 0 && !used[0]);
    anew(0, 0, 0, 0);
    LAW("nor is nothing", weight[0] == 0 && eliminate_clear(&step, weight, used, 0, 2) == 0);
    anew(1, 8, 4, 32); /* the quarter of a row is clear */
    LAW("a quarter of its row is one", eliminate_clear(&step, weight, used, 0, 1) == 1 && row[0] == 0);
    steps(), contradictions(), limits();
    return broken > 0;
}

#include "laws.h"

#include "../../../csrc/stages/soft.c"

#define N 3
static real P[N * N], rows[N * N], p[N], own[N], sum[N];
static char fixed[N];

/* The least of (x + t).P (x + t) / 2 + q.(x + t) + sum of t_i^2 / (2 give_i) over t, of free states, by Gauss. */
static void solve(const real *H, const real *q, const real *give, const char *held, const real *x, real *t)
{
    real A[N][N + 1];
    int i, j, k;
    for (i = 0; i < N; ++i) {
        A[i][N] = -q[i];
        for (j = 0; j < N; ++j) {
            A[i][j] = held[i] || held[j] ? i == j : H[i * N + j] + (i == j ? 1 / give[i] : 0);
            A[i][N] -= H[i * N + j] * x[j];
        }
        A[i][N] = held[i] ? 0 : A[i][N];
    }
    for (k = 0; k < N; ++k)
        for (i = 0; i < N; ++i)
            for (j = N; i != k && j >= k; --j)
                A[i][j] -= A[i][k] / A[k][k] * A[k][j];
    for (i = 0; i < N; ++i)
        t[i] = A[i][N] / A[i][i];
}

static int alike(real a, real b)
{
    return real_abs(a - b) <= 1e-12;
}

int main(void)
{
    mbs_stages_soft s;
    const real H[N * N] = {4, 1, -0.5, 1, 3, 0.25, -0.5, 0.25, 2}, q[N] = {0.5, -1, 2}, give[N] = {0.25, 2, 0.5};
    const real level[N] = {0};
    real x[N] = {0.3, -0.7, 0.2}, moved[N], dy[N], t[N];
    char held[N] = {0, 1, 0};
    int i, j, round;
    memset(&s, 0, sizeof s);
    s.n = s.width = N;
    s.P = P, s.rows = rows, s.p = p, s.own = own, s.sum = sum, s.fixed = fixed;
    for (round = 0; round < 2; ++round) {
        memset(held, 0, sizeof held);
        held[1] = (char)round;
        LAW("a convex cost is softened", mbs_stages_soften(&s, H, give, held, 1e-8) == 0);
        mbs_stages_soften_linear(&s, q, give);
        memcpy(moved, x, sizeof x);
        mbs_stages_deviate(&s, give, moved, dy);
        LAW("a fixed state comes back", !round || (moved[1] == 0 && near(dy[1], x[1] / give[1])));
        x[1] = round ? 0 : x[1];
        solve(H, q, give, held, x, t);
        for (i = 0; i < N; ++i) {
            LAW("states deviate to the least cost", held[i] || alike(moved[i] - x[i], t[i]));
            LAW("with the price as multiplier", held[i] || alike(dy[i], -t[i] / give[i]));
        }
        for (j = 0; j < N; ++j) {
            real unit[N] = {0}, slope;
            unit[j] = 1;
            solve(H, level, give, held, unit, t);
            for (i = 0; i < N && !held[j]; ++i) { /* P of the least: H (e_j + t), of free states */
                slope = H[i * N] * (unit[0] + t[0]) + H[i * N + 1] * (unit[1] + t[1]) + H[i * N + 2] * (unit[2] + t[2]);
                LAW("the cost is what is left", held[i] || alike(P[i * N + j], slope));
            }
        }
    }
    LAW("a fixed state keeps its price alone", P[4] == 1 / give[1] && P[1] == 0 && P[3] == 0);
    {
        const real concave[N * N] = {-5, 0, 0, 0, 1, 0, 0, 0, 1};
        memset(held, 0, sizeof held);
        LAW("more curvature is needed than the price has", mbs_stages_soften(&s, concave, give, held, 1e-8) == -1);
        held[0] = 1;
        LAW("unless the state is fixed", mbs_stages_soften(&s, concave, give, held, 1e-8) == 0);
    }
    {
        const real level_out[N * N] = {-4 + 1e-9, 0, 0, 0, 1, 0, 0, 0, 1};
        memset(held, 0, sizeof held);
        LAW("what rounding leaves is no curvature", mbs_stages_soften(&s, level_out, give, held, 1e-8) == -1);
        LAW("but a tenth of a millionth is", mbs_stages_soften(&s, level_out, give, held, 1e-11) == 0);
    }
    {
        const real large[N * N] = {-1e6 + 1e-3, 0, 0, 0, 1, 0, 0, 0, 1}, rigid[N] = {1e-6, 2, 0.5};
        LAW("of numbers of any size", mbs_stages_soften(&s, large, rigid, held, 1e-8) == -1);
    }
    return broken > 0;
}

#include "laws.h"

#include <math.h>

#include "../../../csrc/mbs_least.c"

static unsigned seed = 3;

static casadi_real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (casadi_real)(seed / 65536 % 2001) / 1000 - 1;
}

static casadi_real total(casadi_int size, const casadi_real *a, casadi_int step, const casadi_real *b)
{
    casadi_real sum = 0;
    casadi_int k;
    for (k = 0; k < size; ++k)
        sum += a[k * step] * b[k];
    return sum;
}

static void sums(void)
{
    static const casadi_real a[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9}, b[9] = {1, 10, 100, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8};
    static const casadi_real wanted[10] = {0, 1, 21, 321, 4321, 54321, 654321, 7654321, 87654321, 987654321};
    casadi_int n;
    for (n = 0; n < 10; ++n)
        LAW("a product has all entries", dot(n, a, b) == wanted[n]);
}

enum { N = 6 };

/* What a decomposition was made of. */
typedef struct {
    casadi_real B[N * N], A[N * N], factor[N], size[2 * N], y[N];
    casadi_int column[N];
    mbs_least s;
} problem;

static void open_problem(problem *p, casadi_int n, casadi_int e)
{
    casadi_int k;
    const mbs_least s = {n, e, 0, p->A, p->factor, p->size, p->y, p->column};
    p->s = s;
    for (k = 0; k < n * e; ++k)
        p->A[k] = p->B[k];
    for (k = 0; k < N; ++k)
        p->column[k] = -1, p->y[k] = NAN;
}

/* Equations of many sizes: the least x is a sum of equations, by the weights that are written. */
static void solutions(void)
{
    casadi_real g[N], x[N + 1], weights[N], last;
    casadi_int n, e, i, k, turn;
    problem p;
    for (turn = 0; turn < 10; ++turn)
        for (n = 1; n <= N; ++n)
            for (e = 1; e <= n; ++e) {
                for (k = 0; k < n * e; ++k)
                    p.B[k] = draw() + (k / n == k % n ? 2 : 0);
                for (k = 0; k < e; ++k)
                    g[k] = draw();
                open_problem(&p, n, e);
                last = mbs_least_factorise(&p.s, 1e-10), x[n] = 77;
                LAW("equations have their rank", p.s.rank == e && last > 1e-6);
                LAW("pivots fall", fabs(fabs(p.A[(e - 1) * (n + 1)] / p.A[0]) - last) < 1e-15);
                for (k = 1; k < e; ++k)
                    LAW("each", fabs(p.A[k * (n + 1)]) <= fabs(p.A[(k - 1) * (n + 1)]) * (1 + 1e-12));
                LAW("and are solved", mbs_least_solve(&p.s, g, x) == 0 && x[n] == 77);
                for (i = 0; i < e; ++i)
                    LAW("each of them", fabs(total(n, p.B + i * n, 1, x) - g[i]) < 1e-12 / last);
                mbs_least_weigh(&p.s, x, weights);
                for (i = 0; i < n; ++i)
                    LAW("by a sum of equations, which is the least",
                        fabs(total(e, p.B + i, n, weights) - x[i]) < 1e-11 / last);
            }
}

/* Equations of which some are sums of others, or 0. */
static void ranks(void)
{
    const casadi_real g[3] = {1, 2, 8}, contradiction[3] = {1, 2, 8.5}, none[3] = {1, 2, NAN};
    casadi_real x[N], weights[3] = {9, 9, 9}, limit[2] = {1e-8 * 0.99, 1e-8 * 1.01};
    casadi_int k, i;
    problem p;
    for (k = 0; k < 3 * N; ++k)
        p.B[k] = draw();
    for (k = 0; k < N; ++k)
        p.B[2 * N + k] = 2 * p.B[k] + 3 * p.B[N + k];
    open_problem(&p, N, 3);
    LAW("equations that repeat others have no pivot", mbs_least_factorise(&p.s, 1e-10) == 0 && p.s.rank == 2);
    LAW("they hold by themselves", mbs_least_solve(&p.s, g, x) < 1e-13);
    for (i = 0; i < 3; ++i)
        LAW("all", fabs(total(N, p.B + i * N, 1, x) - g[i]) < 1e-13);
    LAW("or not", fabs(mbs_least_solve(&p.s, contradiction, x)) > 0.1);
    LAW("or are unknown", !(mbs_least_solve(&p.s, none, x) < 1e300));
    mbs_least_solve(&p.s, g, x), mbs_least_weigh(&p.s, x, weights);
    LAW("the one left out has no weight", weights[p.column[2]] == 0);
    for (i = 0; i < N; ++i)
        LAW("the others weigh", fabs(total(3, p.B + i, N, weights) - x[i]) < 1e-13);
    for (k = 0; k < 2; ++k) { /* 3 and 3e-8 */
        memset(p.B, 0, sizeof p.B), p.B[1] = 3, p.B[N + 4] = -3e-8;
        open_problem(&p, N, 2);
        mbs_least_factorise(&p.s, limit[k]);
        LAW("a pivot counts above a part of the first", p.s.rank == 2 - k);
    }
    memset(p.B, 0, sizeof p.B);
    open_problem(&p, N, 2);
    LAW("no equation has no pivot", mbs_least_factorise(&p.s, 1e-10) == 0 && p.s.rank == 0);
    LAW("and asks nothing", mbs_least_solve(&p.s, contradiction, x) == 2 && x[0] == 0 && x[N - 1] == 0);
    open_problem(&p, N, 0);
    LAW("without equations nothing is lost", mbs_least_factorise(&p.s, 1e-10) == 1 && p.s.rank == 0);
    open_problem(&p, N, 1), p.A[0] = NAN;
    LAW("an unknown equation has no pivot", mbs_least_factorise(&p.s, 0) == 0 && p.s.rank == 0);
}

/* The rest of an equation that has almost cancelled is computed anew: the order is by it. */
static void lengths(void)
{
    static const casadi_real part[4] = {1e-9, 8e-9, 2e-9, 4e-9};
    casadi_int k, i;
    problem p;
    for (k = 0; k < 5; ++k)
        for (i = 0; i < N; ++i)
            p.B[k * N + i] = (k == 0 ? 1.01 : 1) * (0.3 + 0.1 * (casadi_real)i) + (k > 0 && i == k ? part[k - 1] : 0);
    open_problem(&p, N, 5);
    LAW("rounding does not hide a rank", mbs_least_factorise(&p.s, 1e-12) > 1e-10 && p.s.rank == 5);
    LAW("nor the order",
        p.column[0] == 0 && p.column[1] == 2 && p.column[2] == 4 && p.column[3] == 3 && p.column[4] == 1);
}

/* The determinant by minors of the first row. */
static casadi_real determine(casadi_int n, const casadi_real *A)
{
    casadi_real minor[N * N], sum = 0;
    casadi_int i, j, k, at;
    for (k = 0; k < n && n > 1; ++k) {
        for (i = 1, at = 0; i < n; ++i)
            for (j = 0; j < n; ++j)
                if (j != k)
                    minor[at++] = A[i * n + j];
        sum += (k % 2 ? -1 : 1) * A[k] * determine(n - 1, minor);
    }
    return n > 1 ? sum : A[0];
}

static void systems(void)
{
    casadi_real A[N * N], factors[N * N], x[N], b[N], here[N], volume, found;
    casadi_int row[N], n, k, turn;
    for (turn = 0; turn < 20; ++turn)
        for (n = 1; n < N; ++n) {
            for (k = 0; k < n * n; ++k)
                A[k] = factors[k] = draw() * (turn % 3 ? 1 : 5);
            for (k = 0; k < n; ++k)
                b[k] = x[k] = draw();
            found = mbs_lu_factorise(n, factors, row, &volume);
            LAW("a determinant has its size", fabs(volume - log(fabs(determine(n, A)))) < 1e-9);
            mbs_lu_solve(n, factors, row, x, here);
            for (k = 0; k < n; ++k)
                LAW("equations are solved", fabs(total(n, A + k * n, 1, x) - b[k]) < 1e-13 / found);
            for (k = 0, volume = 0; k < n; ++k)
                volume = fmax(volume, fabs(factors[k * (n + 1)]));
            for (k = 0; k < n; ++k)
                LAW("the least pivot is relative to the largest",
                    fabs(factors[k * (n + 1)]) / volume >= found * (1 - 1e-15));
            for (k = 1; k < n * n; ++k)
                LAW("factors are at most 1", k / n <= k % n || fabs(factors[k]) <= 1);
        }
    A[0] = 3, A[1] = 0, A[2] = 0, A[3] = -0.75;
    LAW("pivots have no sign", mbs_lu_factorise(2, A, row, &volume) == 0.25 && fabs(volume - log(2.25)) < 1e-15);
    A[0] = 0.5, A[1] = 0, A[2] = 0, A[3] = -4;
    LAW("nor an order", mbs_lu_factorise(2, A, row, &volume) == 0.125);
    A[0] = 0, A[1] = 1, A[2] = 0, A[3] = 1;
    LAW("singular ones have none", mbs_lu_factorise(2, A, row, &volume) == 0);
    A[0] = 1, A[1] = 0, A[2] = 0, A[3] = 0;
    LAW("wherever it is missing", mbs_lu_factorise(2, A, row, &volume) == 0);
    A[0] = NAN;
    LAW("or unknown", mbs_lu_factorise(1, A, row, &volume) == 0);
    LAW("nothing is never singular", mbs_lu_factorise(0, A, row, &volume) == 1 && volume == 0);
}

static void roots(void)
{
    const casadi_real least = 3 * 1e3 * 2.220446049250313e-16;
    casadi_real L[N * N], M[N * N], x[N], y[N];
    casadi_int n, i, j, k;
    for (n = 1; n <= N; ++n) {
        for (i = 0; i < n; ++i)
            for (j = 0; j < n; ++j)
                L[i * n + j] = j < i ? draw() : j == i ? 1 + fabs(draw()) : 0;
        for (i = 0; i < n; ++i)
            for (j = 0; j < n; ++j)
                M[i * n + j] = j <= i ? total(n, L + i * n, 1, L + j * n) : NAN;
        LAW("a square has its root", mbs_cholesky(n, M) == 0);
        for (i = 0; i < n; ++i)
            for (j = 0; j <= i; ++j)
                LAW("by its lower triangle alone", fabs(M[i * n + j] - L[i * n + j]) < 1e-12);
        for (i = 0; i < n; ++i)
            x[i] = y[i] = draw();
        mbs_cholesky_forward(n, M, x);
        for (i = 0; i < n; ++i)
            LAW("which is solved from the first row", fabs(total(i + 1, L + i * n, 1, x) - y[i]) < 1e-12);
        for (i = 0; i < n; ++i)
            x[i] = y[i];
        mbs_cholesky_backward(n, M, x);
        for (i = 0; i < n; ++i)
            LAW("and, across, from the last", fabs(total(n - i, L + i * (n + 1), n, x + i) - y[i]) < 1e-11);
    }
    for (k = 0; k < 3; ++k)
        for (j = 0; j < k; ++j) { /* a pivot of 4 times the least, and less */
            memset(M, 0, sizeof M), M[0] = M[4] = M[8] = 1;
            M[4 * k] = 4, M[3 * k + j] = sqrt(4 - 4.2 * least);
            LAW("a small pivot keeps digits", mbs_cholesky(3, M) == 0);
            memset(M, 0, sizeof M), M[0] = M[4] = M[8] = 1;
            M[4 * k] = 4, M[3 * k + j] = sqrt(4 - 3.8 * least);
            LAW("a smaller one is named by its row", mbs_cholesky(3, M) == k + 1);
        }
    M[0] = 0;
    LAW("as no pivot", mbs_cholesky(1, M) == 1);
    M[0] = NAN;
    LAW("or an unknown one", mbs_cholesky(1, M) == 1);
}

int main(void)
{
    sums(), solutions(), ranks(), lengths(), systems(), roots();
    return broken > 0;
}

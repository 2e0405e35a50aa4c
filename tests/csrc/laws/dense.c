/* Factors of several systems at once: solutions and determinants, and which ones are singular. */
#include "laws.h"

#include <math.h>

#include "../../../csrc/mbs_dense.c"

enum { N = 5, SYSTEMS = 3, SIDES = 3 };

static unsigned seed = 9;

static double draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (double)(seed / 65536 % 2001) / 1000 - 1;
}

/* The product of L and U, with rows exchanged back, is A; no entry of L is above 1. */
static void factors(casadi_int n, const double *A, const double *F, const casadi_int *pivot)
{
    double PA[N * N];
    casadi_int i, j, k;
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j) {
            PA[i * n + j] = i <= j ? (i == j ? 1 / F[i * n + i] : F[i * n + j]) : 0;
            for (k = 0; k < i && k <= j; ++k)
                PA[i * n + j] += F[i * n + k] * (k == j ? 1 / F[k * n + k] : F[k * n + j]);
            LAW("no entry of L is above 1", j >= i || fabs(F[i * n + j]) <= 1);
        }
    for (i = n; i-- > 0;) {
        LAW("a row is exchanged with a later one", pivot[i] >= i && pivot[i] < n);
        for (j = 0; j < n; ++j) {
            const double t = PA[i * n + j];
            PA[i * n + j] = PA[pivot[i] * n + j];
            PA[pivot[i] * n + j] = t;
        }
    }
    for (i = 0; i < n * n; ++i)
        LAW("L U is the matrix, with its rows exchanged", fabs(PA[i] - A[i]) < 1e-13);
}

static double multiply(casadi_int n, const double *a, casadi_int step, const double *x, casadi_int apart)
{
    double sum = 0;
    casadi_int k;
    for (k = 0; k < n; ++k)
        sum += a[k * step] * x[k * apart];
    return sum;
}

static void solutions(casadi_int n)
{
    double A[SYSTEMS * N * N], F[SYSTEMS * N * N + 1], b[SYSTEMS * N * SIDES], x[SYSTEMS * N * SIDES + 1], least;
    casadi_int pivot[SYSTEMS * N + 1], s, i, j, k;
    for (i = 0; i < SYSTEMS * n * n; ++i)
        A[i] = F[i] = draw() + (i / n % n == (i + 1) % n ? 2 : 0);
    F[SYSTEMS * n * n] = 77, pivot[SYSTEMS * n] = 77;
    LAW("regular systems are", mbs_factorise(SYSTEMS, n, F, pivot) == 0);
    LAW("within their memory", F[SYSTEMS * n * n] == 77 && pivot[SYSTEMS * n] == 77);
    for (s = 0, least = 1; s < SYSTEMS; ++s) {
        factors(n, A + s * n * n, F + s * n * n, pivot + s * n);
        for (i = 0; i < n; ++i)
            least = fmin(least, 1 / fabs(F[s * n * n + i * (n + 1)]));
    }
    for (k = 1; k <= SIDES; ++k) {
        for (i = 0; i < SYSTEMS * n * k; ++i)
            b[i] = x[i] = draw();
        x[SYSTEMS * n * k] = 77;
        mbs_solve(SYSTEMS, n, F, pivot, k, x);
        for (s = 0; s < SYSTEMS; ++s)
            for (i = 0; i < n; ++i)
                for (j = 0; j < k; ++j)
                    LAW("A x = b, for each column of b",
                        fabs(multiply(n, A + (s * n + i) * n, 1, x + s * n * k + j, k) - b[(s * n + i) * k + j])
                            < 1e-12 / least);
        LAW("and nothing else is written", x[SYSTEMS * n * k] == 77);
    }
    for (i = 0; i < SYSTEMS * n; ++i)
        b[i] = x[i] = draw();
    x[SYSTEMS * n] = 77;
    mbs_solve_transposed(SYSTEMS, n, F, pivot, x);
    for (s = 0; s < SYSTEMS; ++s)
        for (i = 0; i < n; ++i)
            LAW("the transposed ones are solved by the same factors",
                fabs(multiply(n, A + s * n * n + i, n, x + s * n, 1) - b[s * n + i]) < 1e-12 / least);
    LAW("within their memory", x[SYSTEMS * n] == 77);
}

/* One of three systems is singular, at each of its pivots. */
static void singular(void)
{
    double A[3 * 9], F[3 * 9], x[9];
    casadi_int pivot[9], missing, i;
    for (missing = 0; missing < 3; ++missing) {
        memset(A, 0, sizeof A);
        for (i = 0; i < 9; ++i)
            A[9 * (i / 3) + 4 * (i % 3)] = 2;
        A[9 + 4 * missing] = 0;
        memcpy(F, A, sizeof A);
        LAW("a singular system is counted once", mbs_factorise(3, 3, F, pivot) == 1);
        for (i = 0; i < 9; ++i)
            x[i] = 6;
        mbs_solve(3, 3, F, pivot, 1, x);
        LAW("its solution is no number", isnan(x[3 + missing]));
        for (i = 0; i < 3; ++i)
            LAW("and the other systems are solved", x[i] == 3 && x[6 + i] == 3);
    }
    memset(A, 0, sizeof A);
    LAW("each singular one counts", mbs_factorise(3, 3, A, pivot) == 3);
    A[0] = NAN;
    LAW("and unknown ones", mbs_factorise(1, 1, A, pivot) == 1);
}

int main(void)
{
    casadi_int n, turn;
    for (turn = 0; turn < 5; ++turn)
        for (n = 1; n <= N; ++n)
            solutions(n);
    singular();
    return broken > 0;
}

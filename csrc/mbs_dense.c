/* Many small dense systems of linear equations: see mbs_dense.h. */
#include "mbs_dense.h"

#include <math.h>

/* b -= x a, of n numbers */
static void subtract(casadi_int n, double x, const double *MBS_RESTRICT a, double *MBS_RESTRICT b)
{
    casadi_int i;
    for (i = 0; i < n; ++i)
        b[i] -= x * a[i];
}

static void exchange(casadi_int n, double *MBS_RESTRICT a, double *MBS_RESTRICT b)
{
    casadi_int i;
    for (i = 0; i < n; ++i) {
        const double t = a[i];
        a[i] = b[i];
        b[i] = t;
    }
}

casadi_int mbs_factorise(casadi_int systems, casadi_int n, double *matrix, casadi_int *pivot)
{
    casadi_int s, i, k, singular = 0;
    for (s = 0; s < systems; ++s, matrix += n * n, pivot += n) {
        int failed = 0;
        for (k = 0; k < n; ++k) {
            double *row = matrix + k * n, largest = fabs(row[k]);
            pivot[k] = k;
            for (i = k + 1; i < n; ++i)
                if (fabs(matrix[i * n + k]) > largest) {
                    largest = fabs(matrix[i * n + k]);
                    pivot[k] = i;
                }
            if (pivot[k] != k)
                exchange(n, row, matrix + pivot[k] * n);
            failed |= !(largest > 0);
            row[k] = largest > 0 ? 1 / row[k] : NAN;
            for (i = k + 1; i < n; ++i) {
                double *below = matrix + i * n;
                below[k] *= row[k];
                subtract(n - k - 1, below[k], row + k + 1, below + k + 1);
            }
        }
        singular += failed;
    }
    return singular;
}

void mbs_solve(casadi_int systems, casadi_int n, const double *factors, const casadi_int *pivot, casadi_int k,
               double *b)
{
    casadi_int s, i, j;
    for (s = 0; s < systems; ++s, factors += n * n, pivot += n, b += n * k) {
        for (i = 0; i < n; ++i)
            if (pivot[i] != i)
                exchange(k, b + i * k, b + pivot[i] * k);
        for (i = 0; i < n; ++i)
            for (j = 0; j < i; ++j)
                subtract(k, factors[i * n + j], b + j * k, b + i * k);
        for (i = n - 1; i >= 0; --i) {
            for (j = i + 1; j < n; ++j)
                subtract(k, factors[i * n + j], b + j * k, b + i * k);
            for (j = 0; j < k; ++j)
                b[i * k + j] *= factors[i * n + i];
        }
    }
}

void mbs_solve_transposed(casadi_int systems, casadi_int n, const double *factors, const casadi_int *pivot, double *b)
{
    casadi_int s, i;
    for (s = 0; s < systems; ++s, factors += n * n, pivot += n, b += n) {
        for (i = 0; i < n; ++i) {
            b[i] *= factors[i * n + i];
            subtract(n - i - 1, b[i], factors + i * n + i + 1, b + i + 1);
        }
        for (i = n - 1; i > 0; --i)
            subtract(i, b[i], factors + i * n, b);
        for (i = n - 1; i >= 0; --i)
            if (pivot[i] != i)
                exchange(1, b + i, b + pivot[i]);
    }
}

/* Small dense systems: Cholesky's decomposition, LU, and least solutions of equations B x = g. */
#include "mbs_least.h"

#include <math.h>

#define LOST 1e3   /* a pivot below n LOST epsilon of its diagonal entry has lost its digits */
#define STALE 1e-3 /* a squared length that has shrunk to this part is computed anew */

static casadi_real dot(casadi_int n, const casadi_real *a, const casadi_real *b)
{
    casadi_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    casadi_int k = 0;
    for (; k + 4 <= n; k += 4) { /* four sums at a time: one sum would wait for itself */
        s0 += a[k] * b[k];
        s1 += a[k + 1] * b[k + 1];
        s2 += a[k + 2] * b[k + 2];
        s3 += a[k + 3] * b[k + 3];
    }
    for (; k < n; ++k)
        s0 += a[k] * b[k];
    return (s0 + s1) + (s2 + s3);
}

static void subtract(casadi_int n, casadi_real factor, const casadi_real *a, casadi_real *b)
{
    casadi_int k;
    for (k = 0; k < n; ++k)
        b[k] -= factor * a[k];
}

/* --- least solutions ----------------------------------------------------------------------------------------------- */

static void exchange(const mbs_least *s, casadi_int i, casadi_int j)
{
    casadi_real *a = s->A + i * s->n, *b = s->A + j * s->n;
    const casadi_int column = s->column[i];
    casadi_int k;
    for (k = 0; k < s->n; ++k) {
        const casadi_real x = a[k];
        a[k] = b[k];
        b[k] = x;
    }
    s->column[i] = s->column[j];
    s->column[j] = column;
    s->size[j] = s->size[i]; /* of column i nobody asks again */
    s->size[s->e + j] = s->size[s->e + i];
}

casadi_real mbs_least_factorise(mbs_least *s, casadi_real tolerance)
{
    const casadi_int n = s->n, e = s->e;
    casadi_real first = 0, last = 0;
    casadi_int i, j;
    for (j = 0; j < e; ++j) {
        s->column[j] = j;
        s->size[j] = s->size[e + j] = dot(n, s->A + j * n, s->A + j * n);
    }
    for (i = 0; i < e; ++i) {
        casadi_int best = i;
        casadi_real *a, pivot, scale;
        for (j = i + 1; j < e; ++j)
            if (s->size[j] > s->size[best])
                best = j;
        if (best != i)
            exchange(s, i, best);
        a = s->A + i * n + i;
        pivot = sqrt(dot(n - i, a, a));
        if (i == 0)
            first = pivot;
        if (!(pivot > tolerance * first))
            break;
        last = pivot;
        if (a[0] > 0)
            pivot = -pivot;
        scale = a[0] - pivot; /* the reflection is 1 - factor w w^T with w = (1, a / scale) */
        s->factor[i] = -scale / pivot;
        for (j = 1; j < n - i; ++j)
            a[j] /= scale;
        a[0] = pivot;
        for (j = i + 1; j < e; ++j) {
            casadi_real *b = s->A + j * n + i;
            const casadi_real part = s->factor[i] * (b[0] + dot(n - i - 1, a + 1, b + 1));
            b[0] -= part;
            subtract(n - i - 1, part, a + 1, b + 1);
            s->size[j] -= b[0] * b[0];
            if (!(s->size[j] > STALE * s->size[e + j]))
                s->size[j] = s->size[e + j] = dot(n - i - 1, b + 1, b + 1);
        }
    }
    s->rank = i;
    return i == e && first > 0 ? last / first : e ? 0 : 1;
}

casadi_real mbs_least_solve(const mbs_least *s, const casadi_real *g, casadi_real *x)
{
    const casadi_int n = s->n;
    casadi_real worst = 0;
    casadi_int i, k;
    for (i = 0; i < s->e; ++i) { /* R^T y = P^T g, of which the columns of R stand in a row */
        const casadi_real *column = s->A + i * n;
        const casadi_int known = i < s->rank ? i : s->rank;
        const casadi_real rest = g[s->column[i]] - dot(known, column, s->y);
        if (i < s->rank)
            s->y[i] = rest / column[i];
        else if (fabs(rest) > worst || rest != rest)
            worst = fabs(rest);
    }
    for (k = 0; k < n; ++k)
        x[k] = k < s->rank ? s->y[k] : 0;
    for (i = s->rank; i-- > 0;) {
        const casadi_real *w = s->A + i * n + i;
        const casadi_real part = s->factor[i] * (x[i] + dot(n - i - 1, w + 1, x + i + 1));
        x[i] -= part;
        subtract(n - i - 1, part, w + 1, x + i + 1);
    }
    return worst;
}

void mbs_least_weigh(const mbs_least *s, const casadi_real *x, casadi_real *lam)
{
    const casadi_int n = s->n;
    casadi_int i, j;
    for (i = 0; i < n; ++i)
        s->y[i] = x[i];
    for (i = 0; i < s->rank; ++i) {
        const casadi_real *w = s->A + i * n + i;
        const casadi_real part = s->factor[i] * (s->y[i] + dot(n - i - 1, w + 1, s->y + i + 1));
        s->y[i] -= part;
        subtract(n - i - 1, part, w + 1, s->y + i + 1);
    }
    for (i = s->rank; i-- > 0;) {
        casadi_real sum = s->y[i];
        for (j = i + 1; j < s->rank; ++j)
            sum -= s->A[j * n + i] * s->y[j];
        s->y[i] = sum / s->A[i * n + i];
    }
    for (i = 0; i < s->e; ++i)
        lam[s->column[i]] = i < s->rank ? s->y[i] : 0;
}

/* --- LU ------------------------------------------------------------------------------------------------------------ */

casadi_real mbs_lu_factorise(casadi_int n, casadi_real *A, casadi_int *row, casadi_real *volume)
{
    casadi_real least = 1, most = 0;
    casadi_int i, j, k;
    *volume = 0;
    for (k = 0; k < n; ++k) {
        casadi_int best = k;
        casadi_real size;
        for (i = k + 1; i < n; ++i)
            if (fabs(A[i * n + k]) > fabs(A[best * n + k]))
                best = i;
        row[k] = best;
        for (j = 0; j < n && best != k; ++j) {
            const casadi_real x = A[k * n + j];
            A[k * n + j] = A[best * n + j];
            A[best * n + j] = x;
        }
        size = fabs(A[k * n + k]);
        if (!(size > 0))
            return 0;
        *volume += log(size);
        most = size > most ? size : most;
        least = k == 0 || size < least ? size : least;
        for (i = k + 1; i < n; ++i) {
            A[i * n + k] /= A[k * n + k];
            if (A[i * n + k] != 0)
                subtract(n - k - 1, A[i * n + k], A + k * n + k + 1, A + i * n + k + 1);
        }
    }
    return n ? least / most : 1;
}

void mbs_lu_solve(casadi_int n, const casadi_real *A, const casadi_int *row, casadi_real *x, casadi_real *room)
{
    casadi_int k;
    for (k = 0; k < n; ++k)
        room[k] = x[k];
    for (k = 0; k < n; ++k) {
        const casadi_real value = room[row[k]];
        room[row[k]] = room[k];
        room[k] = value;
    }
    for (k = 0; k < n; ++k)
        room[k] -= dot(k, A + k * n, room);
    for (k = n; k-- > 0;)
        room[k] = (room[k] - dot(n - k - 1, A + k * n + k + 1, room + k + 1)) / A[k * n + k];
    for (k = 0; k < n; ++k)
        x[k] = room[k];
}

/* --- Cholesky ------------------------------------------------------------------------------------------------------ */

int mbs_cholesky(casadi_int n, casadi_real *M)
{
    casadi_int i, j;
    for (i = 0; i < n; ++i) {
        casadi_real *row = M + i * n;
        const casadi_real scale = row[i];
        casadi_real pivot;
        for (j = 0; j < i; ++j)
            row[j] = (row[j] - dot(j, row, M + j * n)) / M[j * n + j];
        pivot = scale - dot(i, row, row);
        if (!(pivot > (casadi_real)n * MBS_THRESHOLD(LOST) * scale))
            return (int)(i + 1);
        row[i] = sqrt(pivot);
    }
    return 0;
}

void mbs_cholesky_forward(casadi_int n, const casadi_real *L, casadi_real *x)
{
    casadi_int i;
    for (i = 0; i < n; ++i)
        x[i] = (x[i] - dot(i, L + i * n, x)) / L[i * n + i];
}

void mbs_cholesky_backward(casadi_int n, const casadi_real *L, casadi_real *x)
{
    casadi_int i;
    for (i = n; i-- > 0;) {
        x[i] /= L[i * n + i];
        subtract(i, x[i], L + i * n, x);
    }
}

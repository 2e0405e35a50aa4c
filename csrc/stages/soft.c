/* Dynamics that give, one state after the other.
 *
 * With one deviation t of state i, the least of (x + t e).P (x + t e) / 2 + p.(x + t e) + W t^2 / 2 is at
 * t = -(P_i x + p_i) / (P_ii + W). Row i of the cost is then W / (P_ii + W) times what it was, and the others lose
 * P_ji P_ik / (P_ii + W). Products in row i lose no digits, however far apart P and W are. */
#include "soft.h"

#include <string.h>

/* Row and column i: all of the price for a fixed state, else the share of it. */
static void scale_row(mbs_stages_soft *s, int i, real price)
{
    const size_t n = (size_t)s->n, width = (size_t)s->width, at = (size_t)i;
    const real share = s->fixed[i] ? 0 : price / s->sum[i];
    size_t j;
    for (j = 0; j < n; ++j)
        s->P[j * width + at] = s->P[at * width + j] = s->rows[at * n + j] * share;
    if (s->fixed[i])
        s->P[at * width + at] = price;
}

static void lower_others(mbs_stages_soft *s, int i)
{
    const size_t n = (size_t)s->n, width = (size_t)s->width;
    const real *row = s->rows + (size_t)i * n;
    size_t j, k;
    for (j = 0; j < n; ++j) {
        const real factor = row[j] / s->sum[i];
        for (k = 0; k < n; ++k)
            s->P[j * width + k] -= factor * row[k];
    }
}

int mbs_stages_soften(mbs_stages_soft *s, const real *P, const real *give, const char *fixed, real zero_curvature)
{
    const size_t n = (size_t)s->n, width = (size_t)s->width;
    int i;
    memcpy(s->P, P, n * width * sizeof *P);
    memcpy(s->fixed, fixed, n);
    for (i = 0; i < s->n; ++i) {
        const real price = 1 / give[i], own = s->P[(size_t)i * width + (size_t)i];
        memcpy(s->rows + (size_t)i * n, s->P + (size_t)i * width, n * sizeof *P);
        s->sum[i] = own + price;
        if (!s->fixed[i] && !(s->sum[i] > zero_curvature * (price + real_abs(own))))
            return -1;
        if (!s->fixed[i])
            lower_others(s, i);
        scale_row(s, i, price);
    }
    return 0;
}

void mbs_stages_soften_linear(mbs_stages_soft *s, const real *p, const real *give)
{
    int i, j;
    memcpy(s->p, p, (size_t)s->n * sizeof *p);
    for (i = 0; i < s->n; ++i) {
        const real own = s->p[i], *row = s->rows + (size_t)i * (size_t)s->n;
        s->own[i] = own;
        for (j = 0; j < s->n && !s->fixed[i]; ++j)
            s->p[j] -= row[j] * (own / s->sum[i]);
        s->p[i] = s->fixed[i] ? 0 : own / (give[i] * s->sum[i]);
    }
}

void mbs_stages_deviate(const mbs_stages_soft *s, const real *give, real *x, real *dy)
{
    int i, j;
    for (i = s->n - 1; i >= 0; --i) {
        const real *row = s->rows + (size_t)i * (size_t)s->n;
        real force = s->own[i], t = -x[i];
        for (j = 0; j < s->n; ++j)
            force += row[j] * x[j];
        if (!s->fixed[i])
            t = -force / s->sum[i];
        dy[i] = -t / give[i];
        x[i] += t;
    }
}

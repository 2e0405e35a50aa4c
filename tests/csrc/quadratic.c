/* Callbacks of stages with quadratic costs and linear rows. For each stage `data` holds H, q, F, b, E, e, G. */
#include "mbs_stages.h"

typedef mbs_stages_real real;

typedef struct {
    const mbs_stages_size *size; /* one more than stages, of zeros */
    const long *start;           /* of the stage's numbers in `data` */
    const real *data;
} quadratic;

typedef struct {
    int n, next, ne, ng;
    const real *H, *q, *F, *b, *E, *e, *G;
} stage;

int quadratic_values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g);
int quadratic_jacobians(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g);
int quadratic_hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                      const real *yg, real *h);

static stage find(const void *context, int k)
{
    const quadratic *p = context;
    stage s;
    s.n = p->size[k].nx + p->size[k].nv;
    s.next = p->size[k + 1].nx;
    s.ne = p->size[k].ne;
    s.ng = p->size[k].ng;
    s.H = p->data + p->start[k];
    s.q = s.H + s.n * s.n;
    s.F = s.q + s.n;
    s.b = s.F + s.next * s.n;
    s.E = s.b + s.next;
    s.e = s.E + s.ne * s.n;
    s.G = s.e + s.ne;
    return s;
}

/* out += A (x, v) */
static void add(int m, int n, int nx, const real *A, const real *x, const real *v, real *out)
{
    int i, j;
    for (j = 0; j < n; ++j)
        for (i = 0; i < m; ++i)
            out[i] += A[j * m + i] * (j < nx ? x[j] : v[j - nx]);
}

static void copy(int n, const real *from, real *to)
{
    int i;
    for (i = 0; i < n; ++i)
        to[i] = from[i];
}

/* The entries of A that the pattern has, or all of them. */
static void write(int m, int n, const real *A, const mbs_stages_pattern *pattern, real factor, real *out)
{
    int j, l;
    for (l = 0; pattern == NULL && l < m * n; ++l)
        out[l] = factor * A[l];
    for (j = 0; pattern != NULL && j < n; ++j)
        for (l = pattern->column[j]; l < pattern->column[j + 1]; ++l)
            out[l] = factor * A[j * m + pattern->row[l]];
}

int quadratic_values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    const stage s = find(context, k);
    const int nx = ((const quadratic *)context)->size[k].nx;
    int i, j;
    for (j = 0; j < s.n; ++j) {
        const real w = j < nx ? x[j] : v[j - nx];
        *f += s.q[j] * w;
        for (i = 0; i < s.n; ++i)
            *f += s.H[j * s.n + i] * w * (i < nx ? x[i] : v[i - nx]) / 2;
    }
    copy(s.ne, s.e, e);
    copy(s.next, s.b, d);
    add(s.ne, s.n, nx, s.E, x, v, e);
    add(s.next, s.n, nx, s.F, x, v, d);
    add(s.ng, s.n, nx, s.G, x, v, g);
    return 0;
}

int quadratic_jacobians(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    const stage s = find(context, k);
    const mbs_stages_patterns *p = ((const quadratic *)context)->size[k].patterns;
    copy(s.n, s.q, f);
    add(s.n, s.n, ((const quadratic *)context)->size[k].nx, s.H, x, v, f);
    write(s.ne, s.n, s.E, p ? &p->de : NULL, 1, e);
    write(s.next, s.n, s.F, p ? &p->dd : NULL, 1, d);
    write(s.ng, s.n, s.G, p ? &p->dg : NULL, 1, g);
    return 0;
}

int quadratic_hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                      const real *yg, real *h)
{
    const stage s = find(context, k);
    const mbs_stages_patterns *p = ((const quadratic *)context)->size[k].patterns;
    (void)x, (void)v, (void)ye, (void)yd, (void)yg;
    write(s.n, s.n, s.H, p ? &p->h : NULL, factor, h);
    return 0;
}

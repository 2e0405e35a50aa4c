#include "laws.h"

#include "../../../csrc/stages/solve.c"

static struct {
    int fails;
    real before, after;
} given;

int mbs_stages_phase_derivatives(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return given.fails == 2;
}

int mbs_stages_phase_hessian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
    return 0;
}

int mbs_stages_newton_factorise(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s;
    return given.fails || p->mu > 0; /* its step aims at 0 */
}

void mbs_stages_find_lagrangian(mbs_stages *s, mbs_stages_phase *p)
{
    (void)s, (void)p;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p, (void)barrier, (void)out;
}

void mbs_stages_newton_solve(mbs_stages *s, mbs_stages_phase *p, const real *c, mbs_stages_direction *d)
{
    (void)s, (void)p, (void)c, (void)d;
}

real mbs_stages_boundary(const mbs_stages *s, const mbs_stages_phase *p, const real *x, const real *dx, real tau)
{
    (void)s, (void)p, (void)x, (void)dx;
    return tau;
}

real mbs_stages_dual_boundary(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d)
{
    (void)s, (void)p, (void)d;
    return 1;
}

real mbs_stages_mean_product(const mbs_stages *s, const mbs_stages_phase *p, const mbs_stages_direction *d, real alpha,
                             real alpha_dual)
{
    (void)s, (void)p, (void)alpha, (void)alpha_dual;
    return d ? given.after : given.before;
}

/* The first barrier parameter, for means of distance z before and after a step that aims at 0. */
static real choose(int fails, real before, real after)
{
    mbs_stages s;
    mbs_stages_phase p;
    memset(&s, 0, sizeof s);
    memset(&p, 0, sizeof p);
    p.mu = 7;
    given.fails = fails, given.before = before, given.after = after;
    return choose_barrier(&s, &p) ? -1 : p.mu;
}

int main(void)
{
    LAW("the cube of the ratio", near(choose(0, 2, 1), 0.25));
    LAW("of the mean before", near(choose(0, 8, 4), 1));
    LAW("100 at most", choose(0, 1e6, 1e6) == 100);
    LAW("no lower than a warm start's", choose(0, 1, 1e-6) == MBS_STAGES_LOW);
    LAW("0.1 without bounds", near(choose(0, 0, 0), (real)0.1));
    LAW("0.1 without a step", near(choose(1, 2, 1), (real)0.1));
    LAW("no derivatives, none", choose(2, 2, 1) == -1);
    return broken > 0;
}

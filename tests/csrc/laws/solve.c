#include "laws.h"

#include "../../../csrc/stages/solve.c"

static struct {
    int fails;
    real before, after;
    const real *slope; /* of the Lagrangian */
    mbs_stages_errors errors;
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
    memcpy(p->slope, given.slope, (size_t)s->variables * sizeof *p->slope);
}

mbs_stages_errors mbs_stages_measure_errors(mbs_stages *s, mbs_stages_phase *p, real mu)
{
    (void)s;
    LAW("errors are of the solution, at its slopes", mu == 0 && p->slope[0] == given.slope[0]);
    return given.errors;
}

void mbs_stages_stationarity(mbs_stages *s, mbs_stages_phase *p, int barrier, real *out)
{
    (void)s, (void)p, (void)out;
    LAW("the step is of the barrier's slopes", barrier == 1);
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
    (void)s, (void)p, (void)alpha_dual;
    LAW("a step that aims at 0 stays inside of bounds", alpha <= 1);
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

/* A warm start of two variables without bounds, the second of them fixed, and a row with its slack. */
static void take_multipliers(void)
{
    mbs_stages_problem problem;
    mbs_stages s;
    mbs_stages_phase p;
    mbs_stages_stage stage;
    real below[2] = {5, 7}, above[2] = {6, 8}, y[1] = {-3}, scale[2] = {(real)0.5, (real)0.5}, row_scale[1] = {4};
    real x[3] = {0, 0, 0}, lower[3] = {-NONE, -NONE, -NONE}, upper[3] = {NONE, NONE, NONE};
    real got[1], zl[3] = {1, 1, 1}, zu[3] = {1, 1, 1};
    char fixed[3] = {0, 1, 0};
    memset(&problem, 0, sizeof problem);
    memset(&s, 0, sizeof s);
    memset(&p, 0, sizeof p);
    memset(&stage, 0, sizeof stage);
    problem.stages = 1, stage.ng = 1, s.problem = &problem, s.recursion.stage = &stage;
    s.variables = 2, s.rows = 1, s.cost_scale = 4, s.variable_scale = scale, s.row_scale = row_scale, s.fixed = fixed;
    s.point.y = y, s.point.below = below, s.point.above = above;
    p.size = 3, p.mu = 1, p.x = x, p.lower = lower, p.upper = upper, p.y = got, p.zl = zl, p.zu = zu;
    start_warm(&s, &p);
    LAW("a row's multiplier counts cost over the row's unit", near(got[0], -3));
    LAW("a bound's multiplier counts cost over the variable's unit", near(zl[0], 10) && near(zu[0], 12));
    LAW("a fixed variable has no multipliers of bounds", zl[1] == 0 && zu[1] == 0);
    LAW("a slack's lower bound has the negative part", near(zl[2], 3) && zu[2] == 0);
    y[0] = 6, row_scale[0] = 2;
    start_warm(&s, &p);
    LAW("a slack's upper bound has the positive part", zl[2] == 0 && near(zu[2], 12) && near(got[0], 12));
}

static void scale_by_slopes(void)
{
    const mbs_stages_options o = mbs_stages_default_options();
    mbs_stages s;
    real scale[2] = {8, (real)1e-6};
    memset(&s, 0, sizeof s);
    s.variables = 2, s.variable_scale = scale;
    LAW("without units the finest one is 1", finest_unit(&s) == 1);
    s.has_units = 1;
    LAW("else the smallest", finest_unit(&s) == (real)1e-6);
    scale[1] = (real)0.01;
    LAW("but a hundredth is not small", finest_unit(&s) == 1);
    scale[1] = 2;
    LAW("or 1", finest_unit(&s) == 1);
    LAW("a steep row is divided", near(scale_row(&o, 4000, 1), (real)0.025) && near(scale_row(&o, 4000, (real)1e-6), (real)0.025));
    LAW("a flat one stays", scale_row(&o, (real)1e-5, 1) == 1);
    LAW("but where units are small", near(scale_row(&o, (real)1e-5, (real)1e-6), (real)1e5));
    LAW("by its slope, down to a product of two units",
        near(scale_row(&o, (real)1e-8, (real)1e-6), (real)1e8) && near(scale_row(&o, (real)1e-13, (real)1e-6), (real)1e12));
    LAW("by no more than the finest", near(scale_row(&o, 0, (real)1e-6), (real)1e6));
    LAW("a usual one stays", scale_row(&o, (real)0.02, (real)1e-6) == 1);
}

/* The defaults that the header states. */
static void list_defaults(void)
{
    const mbs_stages_options o = mbs_stages_default_options();
    LAW("tolerances", o.tol == 1e-8 && o.constr_viol_tol == 1e-4 && o.acceptable_tol == 1e-6 && o.acceptable_iter == 15);
    LAW("limits", o.max_iter == 3000 && o.max_wall_time == 0 && o.diverging_iterates_tol == 1e20);
    LAW("starts", o.mu_init == 0 && o.mu_target == 0 && !o.adaptive && !o.warm_start_init_point && !o.by_stage);
    LAW("scales", o.scaled == 1 && !o.scale_by_bounds && o.nlp_scaling_max_gradient == 100 && o.nlp_scaling_min_value == 1e-16);
    LAW("bounds", o.bound_push == 0.01 && o.bound_relax_factor == 1e-8 && !o.follow && o.most_violation == 0);
    LAW("the barrier parameter", o.barrier_tol_factor == 10 && o.mu_linear_decrease_factor == 0.2);
    LAW("near the end", o.mu_superlinear_decrease_power == 1.5 && o.tau_min == 0.99 && o.kappa_d == 1e-5);
    LAW("multipliers", o.kappa_sigma == 1e10 && o.s_max == 100 && o.bound_mult_reset_threshold == 1000);
    LAW("the filter", o.theta_max_fact == 100 && o.theta_min_fact == 1e-4 && o.gamma_theta == 1e-5 && o.gamma_phi == 1e-8);
    LAW("acceptance", o.delta == 1 && o.s_theta == 1.1 && o.s_phi == 2.3 && o.eta_phi == 1e-8 && o.obj_max_inc == 5);
    LAW("lengths", o.alpha_min_frac == 0.05 && o.max_soc == 4 && o.kappa_soc == 0.99);
    LAW("watchdogs", o.watchdog_shortened_iter_trigger == 10 && o.watchdog_trial_iter_max == 3);
    LAW("soft steps", o.max_soft_resto_iters == 10 && o.soft_resto_pderror_reduction_factor == 0.9999);
    LAW("restoration", o.required_infeasibility_reduction == 0.9 && o.resto_penalty_parameter == 1000);
    LAW("curvature", o.first_hessian_perturbation == 1e-4 && o.min_hessian_perturbation == 1e-20);
    LAW("more of it", o.max_hessian_perturbation == 1e20 && o.perturb_inc_fact_first == 100 && o.perturb_inc_fact == 6);
    LAW("refinement", o.max_refinement_steps == 8);
}

static void find_gentle_scales(void)
{
    const mbs_stages_options o = mbs_stages_default_options();
    LAW("gradients to 100 stay", gentle(&o, 0) == 1 && gentle(&o, 100) == 1);
    LAW("steeper ones are scaled to it", near(gentle(&o, 400), 0.25));
    LAW("to a limit", gentle(&o, 1e19) == 1e-16);
    LAW("bounds give by their size", real_abs(relaxed(-50, 1e-8) + 50 - 5e-7) < 1e-13);
    LAW("which is 1 at least", relaxed(0.5, -1e-2) == 0.49 && relaxed(0.5, 1e-2) == 0.51);
    LAW("where there is none, none gives", relaxed(NONE, 1) == NONE && relaxed(-NONE, 1) == -NONE);
    LAW("bounds are scaled", bound(NULL, 0, NONE, 3) == NONE && bound(&o.delta, 0, NONE, 3) == 3);
}

/* Figures of the result are in the caller's units. */
static void write_figures(void)
{
    static const real slopes[3] = {-6, 4, 1}, scales[3] = {4, 0.5, 1};
    real slope[3] = {9, 9, 9}, scale[3];
    mbs_stages s;
    memset(&s, 0, sizeof s);
    memcpy(scale, scales, sizeof scale);
    s.variables = 3, s.cost_scale = 0.25, s.variable_scale = scale, s.main.slope = slope, s.main.cost = 3, s.main.mu = 1e-7;
    given.slope = slopes, given.errors.violation = 5, given.errors.complementarity = 7;
    write_result(&s);
    LAW("the cost", s.result.cost == 12 && s.result.violation == 5 && s.result.complementarity == 28);
    LAW("the largest slope", s.result.stationarity == 32 && s.result.barrier == (real)1e-7);
}

int main(void)
{
    list_defaults();
    write_figures();
    find_gentle_scales();
    take_multipliers();
    scale_by_slopes();
    LAW("the cube of the ratio", near(choose(0, 2, 1), 0.25));
    LAW("of the mean before", near(choose(0, 8, 4), 1));
    LAW("100 at most", choose(0, 1e6, 1e6) == 100);
    LAW("no lower than a warm start's", choose(0, 1, 1e-6) == MBS_STAGES_LOW);
    LAW("0.1 without bounds", near(choose(0, 0, 0), (real)0.1));
    LAW("0.1 without a step", near(choose(1, 2, 1), (real)0.1));
    LAW("no derivatives, none", choose(2, 2, 1) == -1);
    return broken > 0;
}

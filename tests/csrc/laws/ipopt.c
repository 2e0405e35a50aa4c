/* IPOPT's face: when it plans, takes another plan, plans anew, and what it reports. Plans, factors and solutions are
 * stand-ins. */
#include "laws.h"

#include "../../../csrc/kkt/mbs_ipopt.c"

enum { N = 10, PLANS = 9, ENTRIES = 12 };

struct mbs_factors {
    mbs_plan *plan;
};

static mbs_plan plans[PLANS];
static double expected[PLANS];
static int made, released[PLANS], every[PLANS], lacking; /* plans; those given back; for all; the one without memory */
static int marked, no_partners, no_factors, opened, freed, solved;
static double *solutions[3];
static mbs_met met;
static mbs_pivoting pivots;

int mbs_mark_weak(int n, const int *start, const int *row, const double *value, char *weak, double *work)
{
    int k;
    (void)start, (void)row, (void)value;
    for (k = 0; k < 2 * n; ++k)
        work[k] = k;
    for (k = 0; k < n; ++k)
        weak[k] = (char)(weak[k] + 1);
    ++marked;
    LAW("weak unknowns keep their marks", weak[n - 1] == marked);
    return 0;
}

int mbs_find_partners(int n, const int *start, const int *row, const double *value, const char *weak, int all, int *partner)
{
    int k;
    (void)value, (void)weak;
    LAW("entries are counted from 0", start[0] == 0 && start[n] == ENTRIES && row[0] == 0 && row[ENTRIES - 1] == n - 1);
    for (k = 0; k < n; ++k)
        partner[k] = -1;
    every[made] = all;
    return no_partners ? -1 : 0;
}

mbs_plan *mbs_make_plan(int n, const int *start, const int *row, const char *weak, const int *partner)
{
    (void)n, (void)start, (void)row, (void)weak, (void)partner;
    plans[made].expected = expected[made];
    return made == lacking ? 0 : &plans[made++];
}

void mbs_release_plan(mbs_plan *plan)
{
    if (plan)
        ++released[plan - plans];
}

mbs_factors *mbs_make_factors(mbs_plan *plan)
{
    mbs_factors *f = no_factors ? 0 : malloc(sizeof *f);
    if (f)
        f->plan = plan, ++opened;
    return f;
}

const mbs_plan *mbs_plan_of(const mbs_factors *f)
{
    return f->plan;
}

void mbs_free_factors(mbs_factors *f)
{
    freed += f != 0;
    free(f);
}

mbs_met mbs_factorise(mbs_factors *f, const double *value, const mbs_pivoting *pivoting)
{
    (void)f, (void)value;
    pivots = *pivoting;
    return met;
}

void mbs_solve(const mbs_factors *f, double *x)
{
    (void)f;
    solutions[solved++ % 3] = x;
}

static void *kept, *factors;
static ipopt_settings settings;
static ipopt_report report;

/* Keep a pattern, whose first number is `base`, of diagonal entries and two more of the first column. */
static void open_pattern(int base)
{
    int *start = malloc((N + 1) * sizeof *start), *row = malloc(ENTRIES * sizeof *row), k;
    ma97_finalise_d(&kept, &factors);
    LAW("nothing is kept at the end", !kept && !factors && opened == freed);
    memset(released, 0, sizeof released), memset(expected, 0, sizeof expected), memset(&met, 0, sizeof met);
    made = marked = no_partners = no_factors = opened = freed = solved = 0, lacking = -1;
    for (k = 0; k < ENTRIES; ++k)
        row[k] = base + (k < 3 ? k : k - 2);
    for (k = 0; k <= N; ++k)
        start[k] = base + (k ? k + 2 : 0);
    memset(&settings, 7, sizeof settings), ma97_default_control_d(&settings);
    LAW("settings are none before they are set", !settings.one_based && settings.zero == 0 && settings.spare_numbers[9] == 0);
    settings.one_based = base, settings.threshold = 0.25, settings.zero = 1e-9;
    memset(&report, 7, sizeof report);
    ma97_analyse_d(0, N, start, row, 0, &kept, &settings, &report, 0);
    LAW("a pattern is kept", report.flag == 0 && kept && report.negative == 0 && report.spare_numbers[9] == 0);
    free(start), free(row);
}

static int factor(void)
{
    memset(&report, 7, sizeof report);
    ma97_factor_d(4, 0, 0, 0, &kept, &factors, &settings, &report, 0);
    return report.flag;
}

/* Where a plan for all takes `first` and the other `second` nanoseconds: the plan that is taken, of how many. */
static int take(double first, double second)
{
    int plan;
    open_pattern(0);
    expected[0] = first, expected[1] = second;
    LAW("a system is factorised", factor() == 0 && every[0] == 1 && (made < 2 || every[1] == 0));
    plan = (int)(((factorisation *)factors)->factors->plan - plans);
    LAW("the plan that is not taken is given back", !released[plan] && (made < 2 || released[1 - plan] == 1));
    return 10 * made + plan;
}

static void choices(void)
{
    LAW("one plan is enough that takes little", take(2000, 1) == 10);
    LAW("beyond it another is tried", take(2001, 1) == 21);
    LAW("and taken where it is much better", take(4000, 2999) == 21);
    LAW("but not by a quarter alone", take(4000, 3000) == 20);
    open_pattern(1), expected[0] = 1e9, lacking = 1;
    LAW("without memory for another the first one stays", factor() == 0 && made == 1 && !released[0]);
}

static void renewals(void)
{
    int k;
    open_pattern(1);
    met.delayed = 1;
    LAW("a tenth may wait for pivots", factor() == 0 && factor() == 0 && made == 1 && marked == 1 && opened == 1);
    met.delayed = 2;
    LAW("if more do, this plan serves once more", factor() == 0 && made == 1);
    for (k = 2; k < 6; ++k)
        LAW("and is renewed, twice", factor() == 0 && made == (k < 3 ? k : 3) && marked == made);
    LAW("the former ones are given back", released[0] == 1 && released[1] == 1 && released[2] == 0);
    LAW("and so are their factors", opened == 3 && freed == 2);
    open_pattern(1), met.delayed = 9, met.failed = 1;
    LAW("what failed renews nothing", factor() == -1 && factor() == -1 && made == 1);
}

static void reports(void)
{
    double x[20];
    open_pattern(0);
    met.negative = 3, met.delayed = 1, met.front = 5, met.entries = 77;
    LAW("pivots are as they are set", factor() == 0 && pivots.threshold == 0.25 && pivots.zero == 1e-9);
    LAW("signs are reported", report.negative == 3 && report.rank == N && report.delayed == 1);
    LAW("and sizes", report.front == 5 && report.entries == 77 && report.spare_numbers[9] == 0);
    memset(&report, 7, sizeof report);
    ma97_solve_d(0, 3, x, 6, &kept, &factors, &settings, &report);
    LAW("right sides are solved, a stride apart", solved == 3 && solutions[0] == x && solutions[1] == x + 6 && solutions[2] == x + 12);
    LAW("with the signs of their factors", report.flag == 0 && report.negative == 3 && report.entries == 0);
    ma97_factor_solve_d(4, 0, 0, 0, 2, x, 7, &kept, &factors, &settings, &report, 0);
    LAW("both at once", solved == 5 && solutions[1] == x + 7 && report.flag == 0 && report.negative == 3);
    met.zeros = 2;
    ma97_factor_solve_d(4, 0, 0, 0, 2, x, 7, &kept, &factors, &settings, &report, 0);
    LAW("a singular system is not solved", solved == 5 && report.flag == -7 && report.rank == N - 2);
}

static void memory(void)
{
    open_pattern(0), no_partners = 1;
    LAW("partners need memory", factor() == -1 && made == 0 && report.entries == 0);
    open_pattern(0), lacking = 0;
    LAW("and a plan", factor() == -1 && !factors);
    lacking = -1, no_factors = 1;
    LAW("and factors", factor() == -1 && made == 1);
    no_factors = 0;
    LAW("which may be there later", factor() == 0 && made == 1 && opened == 1);
    ma97_free_akeep_d(&kept), ma97_free_akeep_d(&kept);
    LAW("a pattern gives its plan back, once", released[0] == 1 && factors);
}

int main(void)
{
    choices(), renewals(), reports(), memory(), open_pattern(0);
    ma97_finalise_d(&kept, &factors);
    return broken > 0;
}

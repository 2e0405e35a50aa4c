/* The comparisons of the check program in single precision: bounds of roundings are numbers of doubles, and are left. */
#define MBS_REAL float

#include <stdio.h>
#include <string.h>

static int reports, left;

static int say(const char *format, ...)
{
    ++reports, left += !strncmp(format, "left", 4);
    return 0;
}

#define printf say
#include "../../../csrc/mbs_check.c"
#undef printf

static int broken;

#define LAW(text, condition) ((condition) ? (void)0 : (void)(++broken, printf("%s: %s\n", text, #condition)))

static const char *names[2];

static int bounds(const float **arg, float **res, casadi_int *iw, float *w, int mem)
{
    (void)iw, (void)w, (void)mem;
    res[0][0] = arg[0][0] * arg[1][0];
    return 0;
}

static casadi_int bounds_n_in(void)
{
    return 2;
}

static casadi_int bounds_n_out(void)
{
    return 1;
}

static const char *bounds_name_in(casadi_int i)
{
    return names[i];
}

static const casadi_int *pattern(casadi_int i)
{
    static const casadi_int one[] = {1, 1, 1};
    (void)i;
    return one;
}

#define bounds_sparsity_in pattern
#define bounds_sparsity_out pattern

static int bounds_diff_in(casadi_int i)
{
    (void)i;
    return 0;
}

int main(void)
{
    const mbs_face face = MBS_FACE("bounds", bounds);
    const double wrong[1] = {7};
    names[0] = "unit", names[1] = "q";
    LAW("bounds are left", mbs_check_results(&face, wrong) == 0 && reports == 1 && left == 1);
    names[0] = "q", names[1] = "unit";
    LAW("whichever input is the unit of rounding", mbs_check_results(&face, wrong) == 0 && reports == 2 && left == 2);
    names[1] = "u";
    LAW("other results are compared", mbs_check_results(&face, wrong) == 1 && reports == 4 && left == 2);
    LAW("the unit is the float's", find_given("unit")[0] * 2 == MBS_EPSILON);
    return broken > 0;
}

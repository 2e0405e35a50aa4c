#define MBS_PROGRAM_LANES
#include "laws.h"

#include <math.h>
#include <stdlib.h>

#define real own_real /* the file names it again */
#include "../../../csrc/program/mbs_program.c"

/* Two kinds of stages: A has x, two v, two rows e, one g; B has two x and nothing else. Stages are A, B, A. */
static const int stage_kinds[3] = {0, 1, 0}, columns[4] = {0, 1, 2, 3};
static const mbs_stages_pattern pattern = {columns, columns};
static const mbs_stages_patterns patterns = {pattern, pattern, pattern, pattern};
static const real parameters[2] = {0.5, 0.25}, numbers[6] = {10, 11, 20, 21, 30, 31};
static mbs_program_kind kinds[2];
static mbs_program program;
static mbs_program_instance *instance;
static char *memory;
static size_t bytes;
static int fails;

/* Write the product of the first two arguments and their sum; an argument that is not there is 0. */
static int combine(const real **arg, real **res, long long int *iw, real *w, int mem)
{
    const real a = arg[0] ? *arg[0] : 0, b = arg[1] ? *arg[1] : 0;
    int k;
    LAW("functions have no memory", mem == 0);
    for (k = 0; k < program.integers; ++k)
        iw[k] = -1;
    for (k = 0; k < program.reals; ++k)
        w[k] = NAN;
    if (res[0])
        *res[0] = a * b;
    if (res[1])
        *res[1] = a + b;
    return fails;
}

static int refuse(const real **arg, real **res, long long int *iw, real *w, int mem)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)mem;
    return 1;
}

static const mbs_program_function functions[2] = {refuse, combine};

/* W of A's values: x, v, v, two parameters, two numbers, then from 7 constants 3 4 5 6,
    and from 11 results of calls. */
static const int sum_to[2] = {7, 8}, sum_from[2] = {0, 3}, product_to[2] = {9, 9}, product_from[2] = {1, 11},
    product_by[2] = {2, 6};
static const real sum_by[2] = {2, -4}, product_times[2] = {0.5, 1};
static const int argument[2] = {7, 8}, result[2] = {11, 12}, one[2] = {5, -1}, result_of_one[2] = {-1, 13};
static const mbs_program_call calls[2] = {{1, 2, 2, argument, result}, {1, 2, 2, one, result_of_one}};
static const mbs_program_step steps[3] = {{{2, sum_to, sum_from, NULL, sum_by}, &calls[0]},
                                          {{2, product_to, product_from, product_by, product_times}, NULL},
                                          {{0, NULL, NULL, NULL, NULL}, &calls[1]}};
static const real start[4] = {3, 4, 5, 6}, ones[3] = {1, 2, 3};
static const int values_of[4] = {9, 11, 7, 13}, jacobians_of[4] = {7, 8, 6, 5}, begins[4] = {6, 7, 8, 7},
    nothing[4] = {0, 0, 0, 0};

static void open_instance(void)
{
    static const mbs_program_kind none = {{0}, {0}, {0}, {0}};
    size_t k;
    fails = 0;
    kinds[0] = kinds[1] = none;
    kinds[0].size.nx = 1, kinds[0].size.nv = 2, kinds[0].size.ne = 2, kinds[0].size.ng = 1,
        kinds[0].size.patterns = &patterns;
    kinds[1].size.nx = 2, kinds[1].size.patterns = &patterns;
    kinds[0].values = (mbs_program_script){3, steps, 4, start, 14, values_of};
    kinds[0].jacobians = (mbs_program_script){1, steps, 4, start, 15, jacobians_of};
    kinds[0].hessian = (mbs_program_script){0, NULL, 0, NULL, 20, begins};
    kinds[1].values = (mbs_program_script){0, NULL, 3, ones, 9, nothing};
    kinds[1].jacobians = kinds[1].hessian = (mbs_program_script){0, NULL, 0, NULL, 8, nothing};
    program = (mbs_program){3, 2, stage_kinds, kinds, 2, 2, functions, 2, 2, 3, 5};
    free(memory);
    bytes = mbs_program_bytes(&program), memory = malloc(bytes);
    for (k = 0; k < bytes; ++k)
        memory[k] = (char)0xa5;
    instance = mbs_program_create(&program, memory);
    LAW("an instance is given its numbers later",
        !instance->parameters && !instance->numbers && instance->program == &program);
    instance->parameters = parameters, instance->numbers = numbers;
}

static void rooms(void)
{
    const char *ends[7];
    int k;
    open_instance();
    LAW("memory is rounded up to 16 bytes",
        round_up(0) == 0 && round_up(1) == 16 && round_up(16) == 16 && round_up(17) == 32);
    LAW("the largest vector is of any script", largest_vector(&program) == 20);
    kinds[1].values.size = 21;
    LAW("of any kind", largest_vector(&program) == 21);
    kinds[0].jacobians.size = 22;
    LAW("each", largest_vector(&program) == 22);
    kinds[0].jacobians.size = 15, kinds[1].values.size = 9;
    ends[0] = (char *)instance, ends[1] = (char *)instance->W, ends[2] = (char *)instance->reals;
    ends[3] = (char *)instance->integers, ends[4] = (char *)instance->arguments, ends[5] = (char *)instance->results;
    ends[6] = memory + bytes;
    LAW("an instance begins its memory", ends[0] == memory);
    LAW("arrays have room", (size_t)(ends[1] - ends[0]) == round_up(sizeof *instance));
    LAW("of their own", ends[2] - ends[1] == 160 && ends[3] - ends[2] == 48 && ends[4] - ends[3] == 32);
    LAW("to the end", ends[5] - ends[4] == 16 && ends[6] - ends[5] == 16);
    for (k = 0; k < 6; ++k)
        LAW("and are aligned", (size_t)(ends[k] - memory) % 16 == 0);
}

static void values(void)
{
    const real x[2] = {7, 8}, v[2] = {2, 3};
    real f[2] = {77, 77}, e[3] = {77, 77, 77}, d[3] = {77, 77, 77}, g[2] = {77, 77};
    open_instance();
    LAW("values are computed", mbs_program_values(instance, 0, x, v, f, e, d, g) == 0);
    /* 3 + 2 7 = 17, 4 - 4/2 = 2: product 34, sum 19; 5 + 2 3/2 + 34 11 = 382; the number 10 and nothing: 10 */
    LAW("terms are sums and products of entries", f[0] == 382 && f[1] == 77);
    LAW("of calls that came before", e[0] == 34 && e[1] == 19 && e[2] == 77);
    LAW("which read numbers of the stage", g[0] == 10 && g[1] == 77);
    LAW("there are as many rows as the next stage has states", d[0] == 17 && d[1] == 2 && d[2] == 77);
    d[0] = d[1] = 77, f[0] = e[0] = g[0] = 77;
    LAW("each stage has its numbers",
        mbs_program_values(instance, 2, x, v, f, e, d, g) == 0 && g[0] == 30 && f[0] == 8 + 34 * 31);
    LAW("nothing follows the last one", d[0] == 77);
    fails = 1, f[0] = 77;
    LAW("a call without result has none", mbs_program_values(instance, 0, x, v, f, e, d, g) == -1 && f[0] == 77);
    fails = 0, program.numbers = 0, program.parameters = 0, kinds[1].values.result = nothing;
    LAW("there may be no numbers",
        mbs_program_values(instance, 1, x, v, f, e, d, g) == 0 && f[0] == 7 && d[0] == 7 && d[1] == 77);
    LAW("constants follow", instance->W[2] == 1 && instance->W[4] == 3);
}

static void derivatives(void)
{
    const real x[1] = {7}, v[2] = {2, 3}, ye[2] = {5, 6}, yd[2] = {8, 9}, yg[1] = {4};
    real df[4] = {77, 77, 77, 77}, de[4] = {77, 77, 77, 77}, dd[4] = {77, 77, 77, 77}, dg[4] = {77, 77, 77, 77},
        h[4] = {0, 0, 0, 77};
    int k;
    open_instance();
    LAW("derivatives are computed", mbs_program_jacobians(instance, 0, x, v, df, de, dd, dg) == 0);
    LAW("of f by all variables", df[0] == 17 && df[1] == 2 && df[2] == 5 && df[3] == 77);
    LAW("and of rows by their patterns",
        de[0] == 2 && de[2] == 6 && dd[0] == 11 && dd[1] == 17 && dg[0] == 10 && dg[2] == 17);
    LAW("alone", de[3] == 77 && dd[3] == 77 && dg[3] == 77);
    fails = 1;
    LAW("a call without result has none", mbs_program_jacobians(instance, 0, x, v, df, de, dd, dg) == -1);
    open_instance();
    LAW("second derivatives too", mbs_program_hessian(instance, 0, x, v, 0.125, ye, yd, yg, h) == 0);
    LAW("with the factor and multipliers of all rows",
        instance->W[7] == 0.125 && instance->W[8] == 5 && instance->W[9] == 6);
    LAW("in their order", instance->W[10] == 8 && instance->W[11] == 9 && instance->W[12] == 4);
    LAW("by their pattern", h[0] == 11 && h[1] == 0.125 && h[2] == 5 && h[3] == 77);
    mbs_program_hessian(instance, 2, x, v, 0.125, ye, yd, yg, h);
    LAW("the last stage has no next one", instance->W[9] == 6 && instance->W[10] == 4);
    for (k = 0; k < 2; ++k)
        LAW("numbers are of the stage", instance->W[5 + k] == numbers[4 + k] && instance->W[3 + k] == parameters[k]);
    kinds[0].hessian.steps = 1, kinds[0].hessian.step = steps, fails = 1;
    LAW("a call without result has none", mbs_program_hessian(instance, 0, x, v, 0.125, ye, yd, yg, h) == -1);
}

/* -- calls at once -- */

static int singles, groups;

/* Write a + b, and a - b, of one call. */
static int add(const real **arg, real **res, long long int *iw, real *w, int mem)
{
    (void)iw, (void)w, (void)mem;
    ++singles;
    *res[0] = arg[0][0] + arg[0][1];
    if (res[1])
        *res[1] = arg[0][0] - arg[0][1];
    return 0;
}

/* The same of four calls, which fails where a sum is negative. */
static int add_abreast(const real **arg, real **res, long long int *iw, real *w, int mem)
{
    int s;
    (void)iw, (void)w, (void)mem;
    ++groups;
    for (s = 0; s < 4; ++s) {
        if (arg[0][s] + arg[0][4 + s] < 0)
            return 1;
        res[0][s] = arg[0][s] + arg[0][4 + s];
        if (res[1])
            res[1][s] = arg[0][s] - arg[0][4 + s];
    }
    return 0;
}

/* Run `count` calls, the last of another function on request; call k adds begin[2 k] and begin[2 k + 1]. */
static int run_calls(const real *begin, int count, int has_other, int at_once, int wants_both, const real *found[2])
{
    static const mbs_program_function own[2] = {add, add};
    static const int two[1] = {2}, ones_each[2] = {1, 1}, term[1] = {19};
    static const real factor[1] = {1};
    static const mbs_program_abreast several[2] = {{NULL, NULL, NULL}, {add_abreast, two, ones_each}};
    static real room[4 * 4], W[40];
    static const real *in[1];
    static real *out[2];
    static const mbs_program_lanes lanes = {4, several, room};
    int argument_of[8][1], result_of[8][2], k;
    mbs_program_call made[8];
    mbs_program_step all[8];
    mbs_program small = {0};
    mbs_program_instance own_instance = {0};
    const mbs_program_script script = {count, all, 20, begin, 40, nothing};
    for (k = 0; k < count; ++k) {
        argument_of[k][0] = 2 * k, result_of[k][0] = 20 + 2 * k, result_of[k][1] = wants_both ? 21 + 2 * k : -1;
        made[k] = (mbs_program_call){has_other && k + 1 == count ? 0 : 1, 1, 2, argument_of[k], result_of[k]};
        all[k] = (mbs_program_step){{0, NULL, NULL, NULL, NULL}, &made[k]};
    }
    all[0].terms = (mbs_program_terms){1, term, term, NULL, factor};
    small.functions = own;
    own_instance.program = &small, own_instance.W = W, own_instance.arguments = in, own_instance.results = out;
    own_instance.lanes = at_once ? &lanes : NULL;
    singles = groups = 0, found[0] = W + 20, found[1] = W;
    for (k = 0; k < 40; ++k)
        W[k] = 77;
    return run(&own_instance, &script, W);
}

static void at_once(void)
{
    real begin[20] = {1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 0, 0, 0, 0, 0, 0, 0, 3}, alone[12];
    const real *found[2];
    int k, count;
    for (count = 1; count <= 6; ++count) {
        LAW("calls are made alone", run_calls(begin, count, 0, 0, 1, found) == 0 && singles == count && groups == 0);
        for (k = 0; k < 12; ++k)
            alone[k] = found[0][k];
        LAW("or four at once, or what is left of them",
            run_calls(begin, count, 0, 1, 1, found) == 0 && groups == (count > 5) + (count > 1) && singles == (count % 4 == 1));
        for (k = 0; k < 12; ++k)
            LAW("with the same results, and no others", found[0][k] == alone[k] && (k < 2 * count || alone[k] == 77));
        LAW("after the terms", found[1][19] == 6);
    }
    LAW("other functions are no part of a group",
        run_calls(begin, 4, 1, 1, 1, found) == 0 && groups == 1 && singles == 1 && found[0][6] == 55);
    LAW("results may be left out",
        run_calls(begin, 4, 0, 1, 0, found) == 0 && groups == 1 && found[0][6] == 55 && found[0][7] == 77);
    begin[2] = -9;
    LAW("where one fails, it is made alone, and the others that follow at once",
        run_calls(begin, 4, 0, 1, 1, found) == 0 && groups == 3 && singles == 2);
    LAW("with its result", found[0][0] == 3 && found[0][2] == -4 && found[0][4] == 21 && found[0][6] == 55);
}

int main(void)
{
    rooms(), values(), derivatives(), at_once();
    return broken > 0;
}

/* The comparisons of the check program: they pass kernels that agree to rounding, and no others.
 *
 * Kernels of two bodies by hand; a result of one of them can be wrong, in one call or in all. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static char said[512];

static int say(const char *format, ...)
{
    const size_t used = strlen(said);
    va_list list;
    va_start(list, format);
    vsnprintf(said + used, sizeof said - used, format, list);
    va_end(list);
    return 0;
}

#define printf say
#include "../../../csrc/mbs_check.c"
#undef printf

#include "laws.h"

/* What is wrong: a kernel, its result and nonzero, its call (-1: all), and by how much. */
static struct {
    const char *kernel;
    int result, entry, call, status, calls;
    double error, steep, missed, unit, large, wild; /* the unit of numbers; what the first results of f, and accelerations, are multiplied by */
} fault;

static int end(const char *kernel, double **res)
{
    if (!fault.kernel || strcmp(kernel, fault.kernel))
        return 0;
    if (fault.call < 0 || fault.calls == fault.call) {
        if (fault.status)
            return ++fault.calls, fault.status;
        res[fault.result][fault.entry] += fault.error;
    }
    ++fault.calls;
    return 0;
}

#define KERNEL(f) static int f(const double **arg, double **res, casadi_int *iw, double *w, int mem)
#define FACE(f, ins, outs) \
    static casadi_int f##_n_in(void) { return ins; } \
    static casadi_int f##_n_out(void) { return outs; } \
    static const char *f##_name_in(casadi_int i) { return f##_names[i]; } \
    static const casadi_int *f##_sparsity_in(casadi_int i) { return f##_in[i]; } \
    static const casadi_int *f##_sparsity_out(casadi_int i) { return f##_out[i]; } \
    static int f##_diff_in(casadi_int i) { return i != 2; } \
    static const mbs_face f##_face = MBS_FACE(#f, f);

static const casadi_int two[] = {2, 1, 1}, one[] = {1, 1, 1}, three[] = {3, 1, 1}, square[] = {2, 2, 0, 2, 4, 0, 1, 0, 1};
static const casadi_int diagonal[] = {2, 2, 0, 1, 2, 0, 1}, corner[] = {2, 2, 0, 0, 1, 0}, row[] = {1, 2, 1};
static const casadi_int second[] = {1, 2, 0, 0, 1, 0}, last[] = {2, 1, 0, 1, 1}, no_rows[] = {2, 3, 0, 0, 0, 0}, none[] = {3, 1, 0, 0}, nothing[] = {1, 3, 0, 0, 0, 0};

static double mass(const double *q, int i, int j)
{
    return fault.unit * (i == 0 && j == 0 ? 3 + cos(q[1]) : i == j ? 1.5 : cos(q[1]) / 2);
}

static double bias(const double *q, const double *qd, int i)
{
    return fault.unit * (i ? sin(q[1]) * qd[0] * qd[0] + 0.3 * q[1] : -sin(q[1]) * qd[0] * qd[1] + 2 * q[0]);
}

/* M qdd + c - (u, 0) */
KERNEL(impl)
{
    int i;
    (void)iw, (void)w, (void)mem;
    for (i = 0; i < 2; ++i)
        res[0][i] = mass(arg[0], i, 0) * arg[2][0] + mass(arg[0], i, 1) * arg[2][1] + bias(arg[0], arg[1], i) - (i ? 0 : arg[3][0]);
    return end("impl", res);
}
static const char *const impl_names[] = {"q", "qd", "qdd", "u"};
static const casadi_int *const impl_in[] = {two, two, two, one}, *const impl_out[] = {two, three};
FACE(impl, 4, 1)

KERNEL(semi)
{
    int i;
    (void)iw, (void)w, (void)mem;
    for (i = 0; i < 4; ++i)
        res[0][i] = mass(arg[0], i % 2, i / 2);
    for (i = 0; i < 2; ++i)
        res[1][i] = bias(arg[0], arg[1], i);
    return end("semi", res);
}
static const char *const semi_names[] = {"q", "qd"};
static const casadi_int *const semi_in[] = {two, two}, *const semi_out[] = {square, two};
FACE(semi, 2, 2)

static void accelerate(const double **arg, double **res)
{
    const double a = mass(arg[0], 0, 0), b = mass(arg[0], 0, 1), c = mass(arg[0], 1, 1);
    const double x = arg[2][0] - bias(arg[0], arg[1], 0), y = -bias(arg[0], arg[1], 1);
    res[0][0] = (c * x - b * y) / (a * c - b * b);
    res[0][0] *= fault.large;
    res[0][1] = fault.large * (a * y - b * x) / (a * c - b * b) + fault.wild * sin(1e9 * arg[0][0]);
}
KERNEL(forward)
{
    (void)iw, (void)w, (void)mem;
    accelerate(arg, res);
    return end("forward", res);
}
static const char *const forward_names[] = {"q", "qd", "u"};
static const casadi_int *const forward_in[] = {two, two, one}, *const forward_out[] = {two, three};
FACE(forward, 3, 1)

KERNEL(other)
{
    (void)iw, (void)w, (void)mem;
    accelerate(arg, res);
    return end("other", res);
}
#define other_names forward_names
#define other_in forward_in
#define other_out forward_out
FACE(other, 3, 1)

KERNEL(frames)
{
    (void)iw, (void)w, (void)mem;
    res[0][0] = 3, res[0][1] = fault.unit * cos(arg[0][0]), res[0][2] = fault.unit * (arg[0][1] + arg[1][0]);
    return end("frames", res);
}
static const char *const frames_names[] = {"q", "p"};
static const casadi_int *const frames_in[] = {two, one}, *const frames_out[] = {three, one};
FACE(frames, 2, 1)

KERNEL(sensors)
{
    (void)iw, (void)w, (void)mem;
    res[0][0] = fault.unit * cos(arg[0][0]), res[0][1] = fault.unit * (arg[0][1] + arg[1][0]);
    return end("sensors", res);
}
static const casadi_int *const sensors_out[] = {two, three};
#define sensors_names frames_names
#define sensors_in frames_in
FACE(sensors, 2, 1)

KERNEL(twin)
{
    (void)iw, (void)w, (void)mem;
    res[0][0] = fault.unit * cos(arg[0][0]), res[0][1] = fault.unit * (arg[0][1] + arg[1][0]);
    return end("twin", res);
}
#define twin_names frames_names
#define twin_in frames_in
#define twin_out sensors_out
FACE(twin, 2, 1)

/* r = (sin q0 qd1 theta, q1^3), e = q0 qd1 - q1; and a force that saturates. */
KERNEL(f)
{
    const double *q = arg[0], *qd = arg[1];
    (void)iw, (void)w, (void)mem;
    res[0][0] = fault.unit * fault.large * sin(q[0]) * qd[1] * arg[2][0];
    res[0][1] = fault.unit * (q[1] * q[1] * q[1] + fault.missed * qd[0]);
    res[1][0] = fault.unit * (q[0] * qd[1] - q[1] + (fault.steep > 0 ? tanh(fault.steep * q[0]) : 0));
    return end("f", res);
}
static const char *const f_names[] = {"q", "qd", "theta"};
static const casadi_int *const f_in[] = {two, two, three}, *const f_out[] = {two, one};
FACE(f, 3, 2)

KERNEL(jac)
{
    const double *q = arg[0], *qd = arg[1], t = tanh(fault.steep * q[0]);
    (void)iw, (void)w, (void)mem;
    res[0][0] = fault.large * cos(q[0]) * qd[1] * arg[2][0], res[0][1] = 3 * q[1] * q[1];
    res[1][0] = fault.large * sin(q[0]) * arg[2][0], res[3][0] = qd[1] + fault.steep * (1 - t * t), res[3][1] = -1, res[4][0] = q[0];
    res[0][0] *= fault.unit, res[0][1] *= fault.unit, res[1][0] *= fault.unit;
    res[3][0] *= fault.unit, res[3][1] *= fault.unit, res[4][0] *= fault.unit;
    return end("jac", res);
}
static const casadi_int *const jac_out[] = {diagonal, corner, no_rows, row, second, nothing};
#define jac_names f_names
#define jac_in f_in
FACE(jac, 3, 6)

KERNEL(adj)
{
    const double *q = arg[0], *qd = arg[1], *r = arg[5], *e = arg[6], theta = arg[2][0];
    (void)iw, (void)w, (void)mem;
    res[0][0] = cos(q[0]) * qd[1] * theta * r[0] + qd[1] * e[0], res[0][1] = 3 * q[1] * q[1] * r[1] - e[0];
    res[1][0] = sin(q[0]) * theta * r[0] + q[0] * e[0];
    res[0][0] *= fault.unit, res[0][1] *= fault.unit, res[1][0] *= fault.unit;
    return end("adj", res);
}
static const char *const adj_names[] = {"q", "qd", "theta", "out_r", "out_e", "adj_r", "adj_e"};
static const casadi_int *const adj_in[] = {two, two, three, none, none, two, one}, *const adj_out[] = {two, last, none};
FACE(adj, 7, 3)

/* The comparisons: which kernel may be wrong, where, and by how much it may be. */
typedef struct {
    const char *kernel, *names[2];
    int calls, entries, places[6][2];
    double most, least; /* errors that pass, and that do not */
} comparison;

static const comparison list[] = {
    {"jac", {"jac against differences of f", 0}, 5, 6, {{0, 0}, {0, 1}, {1, 0}, {3, 0}, {3, 1}, {4, 0}}, 1e-10, 1e-4},
    {"adj", {"adj against jac", 0}, 5, 3, {{0, 0}, {0, 1}, {1, 0}}, 1e-15, 1e-11},
    {"twin", {"sensors against twin", 0}, 5, 2, {{0, 0}, {0, 1}}, 1e-15, 1e-12},
    {"frames", {"sensors against the last of frames", 0}, 5, 2, {{0, 1}, {0, 2}}, 1e-15, 1e-12},
    {"semi", {"semi (M) against impl", 0}, 5, 4, {{0, 0}, {0, 1}, {0, 2}, {0, 3}}, 1e-15, 1e-9},
    {"semi", {"semi (c) against impl", 0}, 5, 2, {{1, 0}, {1, 1}}, 1e-16, 1e-11},
    {"forward", {"forward put into impl", 0}, 5, 2, {{0, 0}, {0, 1}}, 1e-10, 1e-6},
    {"f", {"f against 50 digits", 0}, 1, 3, {{0, 0}, {0, 1}, {1, 0}}, 1e-15, 1e-12},
    {"forward", {"forward against 50 digits", 0}, 1, 2, {{0, 0}, {0, 1}}, 1e-10, 1e-6},
    {"other", {"forward against other", 0}, 5, 2, {{0, 0}, {0, 1}}, 1e-10, 1e-6},
};

static double reference[3], accelerations[2];

static int compare(int which)
{
    said[0] = 0, fault.calls = 0;
    switch (which) {
    case 0: return mbs_check_jacobian(&f_face, &jac_face);
    case 1: return mbs_check_adjoint(&f_face, &jac_face, &adj_face);
    case 2: return mbs_check_equal(&sensors_face, &twin_face);
    case 3: return mbs_check_tail(&sensors_face, &frames_face);
    case 4: return mbs_check_mass_matrix(&semi_face, &impl_face);
    case 5: return mbs_check_bias(&semi_face, &impl_face);
    case 6: return mbs_check_accelerations(&forward_face, &impl_face);
    case 7: return mbs_check_results(&f_face, reference);
    case 8: return mbs_check_solution(&forward_face, accelerations);
    default: return mbs_check_same_accelerations(&forward_face, &other_face);
    }
}

static void anew(void)
{
    memset(&fault, 0, sizeof fault);
    fault.unit = fault.large = 1;
}

/* Numbers of the first state, as the 50-digit evaluation has them. */
static void refer(double unit, double large)
{
    double q[2], qd[2], u[1], *results[2] = {reference, reference + 2}, *found[1] = {accelerations};
    const double *of_f[3] = {q, qd, mbs_check_theta}, *given[3] = {q, qd, u};
    anew(), fault.unit = unit, fault.large = large;
    draw(q, 2, "q", 0), draw(qd, 2, "qd", 0), draw(u, 1, "u", 0);
    f(of_f, results, 0, 0, 0);
    forward(given, found, 0, 0, 0);
}

/* The number that is said after a text. */
static double find_number(const char *text)
{
    const char *at = strstr(said, text);
    return at ? strtod(at + strlen(text), NULL) : NAN;
}

static void agreeing(void)
{
    size_t i;
    int k;
    for (i = 0; i < sizeof list / sizeof *list; ++i) {
        const comparison *c = &list[i];
        anew();
        LAW("kernels that agree pass", compare((int)i) == 0);
        LAW("by less than what is allowed", find_number("differ by ") < 0.5 * find_number(", "));
        LAW("and that is said", !strncmp(said, "ok     ", 7) && strstr(said, c->names[0]) && strstr(said, "allowed\n"));
        for (k = 0; k < c->entries; ++k) {
            anew();
            fault.kernel = c->kernel, fault.result = c->places[k][0], fault.entry = c->places[k][1];
            fault.call = -1, fault.error = c->most;
            LAW("rounding passes", compare((int)i) == 0);
            LAW("each kernel is called once in each state", fault.calls == c->calls);
            for (fault.call = 0; fault.call < c->calls; ++fault.call) {
                fault.error = c->least;
                LAW("each result of each state counts", compare((int)i) == 1);
                LAW("and a fault is said", !strncmp(said, "FAULT  ", 7) && strstr(said, c->names[0]));
                fault.error = -c->least;
                LAW("with either sign", compare((int)i) == 1);
                fault.error = NAN;
                LAW("no number is a fault", compare((int)i) == 1 && strstr(said, "nan"));
            }
        }
        for (anew(), fault.kernel = c->kernel, fault.status = 7; fault.call < c->calls; ++fault.call)
            LAW("a kernel that fails is a fault", compare((int)i) == 1 && strstr(said, "a kernel failed with status 7\n"));
    }
    anew();
    fault.kernel = "frames", fault.call = -1, fault.error = 1; /* of its first number */
    LAW("the tail alone is compared", compare(3) == 0);
    for (k = 2; k < 4; ++k) {
        anew();
        fault.unit = 1e-9, fault.kernel = list[k].kernel, fault.entry = k - 2, fault.call = -1, fault.error = 1e-24;
        LAW("small numbers are compared by their size", compare(k) == 0);
        fault.entry = 1, fault.error = 1e-18;
        LAW("and none is too small", compare(k) == 1);
    }
}

static void jacobians(void)
{
    int k;
    anew();
    LAW("differences are right to more than is asked for",
        compare(0) == 0 && find_number("differ by ") < 1e-2 * DIFFERENCES);
    fault.missed = 1e-6;
    LAW("an entry that the pattern leaves out counts", compare(0) == 1);
    anew();
    fault.steep = 300;
    LAW("a force that saturates steeply passes", compare(0) == 0);
    for (k = 0; k < 5; ++k) {
        fault.kernel = "jac", fault.result = 3, fault.entry = 1, fault.call = k, fault.error = 1e-2;
        LAW("but its other derivatives count", compare(0) == 1);
    }
    anew();
    for (fault.steep = 1; fault.steep < 1e4; fault.steep *= 3)
        LAW("of any steepness", compare(0) == 0);
    anew();
    fault.unit = 1e-9, fault.kernel = "jac", fault.call = -1, fault.error = 1e-14;
    LAW("small derivatives are compared by their size", compare(0) == 1);
    fault.error = 1e-20;
    LAW("where rounding passes", compare(0) == 0);
    fault.kernel = "adj", fault.error = 1e-18;
    LAW("adjoint ones, too", compare(1) == 1);
    fault.error = 1e-24;
    LAW("and theirs", compare(1) == 0);
    anew();
    fault.kernel = "jac", fault.result = 3, fault.call = -1, fault.error = 5e-8;
    LAW("an error of a small result counts", compare(0) == 1);
    fault.large = 1e7;
    LAW("not where it is rounding of the largest", compare(0) == 0);
    anew();
    fault.kernel = "f", fault.status = 7, fault.call = -1;
    LAW("differences that fail are a fault", compare(0) == 1 && strstr(said, "status 7"));
}

/* Results beside numbers of 50 digits count by the largest of these. */
static void referring(void)
{
    refer(1, 1e7);
    fault.kernel = "f", fault.result = 1, fault.call = -1, fault.error = 1e-8;
    LAW("rounding of the largest passes in all", compare(7) == 0);
    refer(1e-9, 1);
    LAW("small numbers pass", compare(7) == 0);
    fault.kernel = "f", fault.result = 0, fault.call = -1, fault.error = 1e-18;
    LAW("and are compared by their size", compare(7) == 1);
    refer(1, 1);
}

/* Rounding moves the results of sensors by R (q0 sin q0 + q1 + p), in sizes; numbers that are given are not moved. */
static void spreading(void)
{
    const double p[1] = {0.5};
    int given;
    anew();
    for (given = 0; given < 2; ++given) {
        call at = open_call(&sensors_face), moved = open_call(&sensors_face);
        verdict v = {0, 0};
        double wanted;
        mbs_check_p = given ? p : 0;
        set_state(at, 2), set_state(moved, 2), run(at, &v);
        wanted = fabs(at.in[0][0] * sin(at.in[0][0])) + fabs(at.in[0][1]) + (given ? 0 : fabs(at.in[1][0]));
        LAW("all inputs that are drawn spread results", fabs(find_spread(at, moved, &v) / ROUNDING / wanted - 1) < 2e-2);
        LAW("and come back", !memcmp(at.in[0], moved.in[0], 2 * sizeof(double)) && at.in[1][0] == moved.in[1][0]);
        close_call(at), close_call(moved);
    }
    mbs_check_p = 0;
}

/* Equations of motion of large numbers, and of small accelerations; and accelerations that rounding of a pose decides. */
static void dynamics(void)
{
    int i;
    for (i = 4; i < 7; ++i) {
        anew();
        fault.unit = 1e9, fault.kernel = i == 6 ? "forward" : "semi", fault.result = i == 5, fault.call = -1;
        fault.error = i == 6 ? 1e-9 : 1e-5;
        LAW("large numbers are compared by their size", compare(i) == 0);
    }
    for (i = 0; i < 2; ++i) {
        anew();
        fault.kernel = "impl", fault.entry = i, fault.error = 1e-3;
        LAW("each equation counts", compare(4) == 1);
        fault.calls = 0;
        LAW("of the bias too", compare(5) == 1);
        LAW("and of accelerations", compare(6) == 1);
    }
    anew();
    fault.large = 1e-6, fault.kernel = "other", fault.call = -1, fault.error = 1e-10;
    LAW("small ones, too", compare(9) == 1);
    fault.large = fault.wild = 1, fault.error = 1e-6;
    LAW("where rounding of the pose decides, more is allowed", compare(9) == 0);
    fault.error = 1e-2;
    LAW("but not all", compare(9) == 1);
}

static void reporting(void)
{
    verdict v = {1, 0};
    said[0] = 0;
    LAW("what is allowed passes", report(v, 1e-3, "f", "beside", "g") == 0);
    v.failed = 7;
    LAW("no kernel that failed passes", passes((verdict){1, 0}) && !passes(v) && !passes((verdict){1.5, 0}));
    v.worst = 0.5, v.failed = said[0] = 0;
    LAW("differences are said", !report(v, 1e-3, "f", "beside", "g") && !strcmp(said, "ok     f beside g: differ by 5.0e-04, 1.0e-03 allowed\n"));
    anew();
    fault.unit = 0;
    LAW("zeros agree", compare(2) == 0 && strstr(said, "differ by 0.0e+00,"));
}

/* Numbers of states: as the generator's, and numbers that the program sets. */
static void drawing(void)
{
    double found[2], p[1] = {5};
    int i;
    draw(found, 2, "q", 0);
    LAW("the first state is the generator's", found[0] * 8388608 == 8289018 && found[1] * 8388608 == 1270023);
    draw(found, 2, "qd", 4);
    LAW("and the last", found[0] * 8388608 == -3056366 && found[1] * 8388608 == -4561871);
    anew();
    for (i = 0; i < 2; ++i) {
        call c = open_call(&frames_face);
        mbs_check_p = i ? p : 0, mbs_check_h = found;
        set_state(c, 1);
        LAW("parameters are drawn, or set", i ? c.in[1][0] == 5 : fabs(c.in[1][0]) < 1);
        draw(found, 2, "q", 1);
        LAW("others are drawn", c.in[0][0] == found[0] && c.in[0][1] == found[1]);
        close_call(c);
    }
    mbs_check_p = 0;
    LAW("by their names", find_given("p") == 0 && find_given("h") == found && find_given("theta") == mbs_check_theta);
    mbs_check_p = p;
    LAW("of two kinds", find_given("given_p") == p && find_given("q") == 0 && find_given("unit")[0] * 2 == MBS_EPSILON);
    mbs_check_p = mbs_check_h = 0;
}

static const char *name_unit(casadi_int i)
{
    return i ? "unit" : "q";
}

/* Inputs are found by their names; roundings count in double precision. */
static void names(void)
{
    const double wrong[3] = {3, 7, 7};
    mbs_face face = frames_face;
    call c = open_call(&impl_face);
    LAW("an input has its name", find_input(c, "q") == c.in[0] && find_input(c, "u") == c.in[3] && find_input(c, "x") == 0);
    c.in[0][1] = c.in[1][1] = 5;
    clear_input(c, "q"), clear_input(c, "x");
    LAW("and is cleared by it", c.in[0][1] == 0 && c.in[1][1] == 5);
    close_call(c);
    anew();
    face.name_in = name_unit, said[0] = 0;
    LAW("bounds of roundings are compared", mbs_check_results(&face, wrong) == 1 && !strncmp(said, "FAULT", 5));
}

static void patterns(void)
{
    static const double M[] = {1, 2, 3, 4}, D[] = {5, 6}, numbers[] = {1, 2, 3, 4, 5, 6};
    static const casadi_int wide[] = {2, 3, 0, 1, 1, 2, 1, 0}, full[] = {2, 3, 1};
    int i, j;
    LAW("nonzeros are counted", count_nonzeros(two) == 2 && count_nonzeros(square) == 4 && count_nonzeros(nothing) == 0);
    for (i = 0; i < 2; ++i)
        for (j = 0; j < 2; ++j) {
            LAW("entries of a matrix", find_entry(square, M, i, j) == M[2 * j + i]);
            LAW("zeros that are left out", find_entry(diagonal, D, i, j) == (i == j ? D[i] : 0));
        }
    LAW("of a matrix that is wider than high", find_place(wide, 0) == 1 && find_place(wide, 1) == 4);
    for (i = 0; i < 2; ++i)
        for (j = 0; j < 3; ++j) {
            LAW("entries, column by column", find_entry(full, numbers, i, j) == numbers[2 * j + i]);
            LAW("zeros beside entries", find_entry(wide, D, i, j) == (2 * j + i == 1 ? 5 : 2 * j + i == 4 ? 6 : 0));
        }
    LAW("places, column by column", find_place(diagonal, 1) == 3 && find_place(corner, 0) == 2 && find_place(three, 2) == 2);
}

int main(void)
{
    static const double theta[3] = {0.75, 9, 9};
    mbs_check_theta = theta;
    refer(1, 1), agreeing(), jacobians(), referring(), spreading(), dynamics(), reporting(), drawing(), names(), patterns();
    return broken > 0;
}

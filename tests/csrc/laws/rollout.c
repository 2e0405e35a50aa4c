/* Motions of many states, one state at a time or (rollout_lanes.c) four, against sums and products worked out here. */
#include "../../../csrc/mbs_rollout.c"

#include "laws.h"

#include <stdlib.h>

enum { Q = 5, V = 4, WIDTH = Q + V, STATES = 7, STEPS = 6, EVERY = 2, SAMPLES = 1 + STEPS / EVERY };

static double fails_at; /* a coordinate that the kernel refuses */

/* qdd = (u, 0, 0, 0) * c - s q0, of inputs u, parameters c and s; arguments: c, qd, u, q, s. */
static int accelerate(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem)
{
    const double *q = (const double *)arg[3];
    casadi_int k, lane;
    (void)iw, (void)w, (void)mem;
    LAW("arguments that no course gives are zeros", arg[5] == 0 && res[1] == 0);
    for (lane = 0; lane < MBS_ABREAST; ++lane)
        if (q[lane] == fails_at)
            return 7;
    for (k = 0; k < V; ++k)
        res[0][k] = k ? MBS_EVERY(0) : arg[2][1] * arg[0][0] - arg[4][0] * arg[3][0];
    return 0;
}

/* q0' = qd0, and p' = p o (0, w) / 2 of a quaternion; arguments: q, c, qd. */
static int rate(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem)
{
    const mbs_real *p = arg[0] + 1, *o = arg[2] + 1;
    (void)iw, (void)w, (void)mem;
    res[0][0] = arg[2][0] * arg[1][1];
    res[0][1] = -(p[1] * o[0] + p[2] * o[1] + p[3] * o[2]) / 2;
    res[0][2] = (p[0] * o[0] + p[2] * o[2] - p[3] * o[1]) / 2;
    res[0][3] = (p[0] * o[1] + p[3] * o[0] - p[1] * o[2]) / 2;
    res[0][4] = (p[0] * o[2] + p[1] * o[1] - p[2] * o[0]) / 2;
    return 0;
}

static const double EULER_A[1] = {0}, EULER_B[1] = {1};
static const double MIDPOINT_A[4] = {0, 0, 0.5, 0}, MIDPOINT_B[2] = {0, 1};
static const double CLASSIC_A[16] = {0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1, 0};
static const double CLASSIC_B[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};

static double kept[STATES][SAMPLES][WIDTH], u[STATES * STEPS * 6], c[STATES * 2], stiffness[1];
static int status[STATES];
static const casadi_int first_of_quaternion[1] = {1};

/* Inputs: two a state, of which the first is not used, in each step, and in each stage or not. */
static void fill(mbs_motion *m, mbs_course *course, casadi_int stages, const double *A, const double *b, int by_stage)
{
    const mbs_course given[3] = {
        {u, STEPS * 6, 6, by_stage ? 2 : 0, 2, 2, -1},
        {c, 2, 0, 0, 2, 0, 1},
        {stiffness, 0, 0, 0, 1, 4, -1},
    };
    const mbs_function accelerations = {accelerate, 6, 2, 3, 1}, rates = {rate, 3, 1, 0, 2};
    const mbs_motion all = {accelerations, rates, Q, V, 1, first_of_quaternion, 3, course, stages, A, b, 0.25, STEPS, EVERY};
    int i, k;
    memcpy(course, given, sizeof given);
    memcpy(m, &all, sizeof all);
    memset(kept, 0, sizeof kept);
    for (i = 0; i < STATES; ++i) {
        c[2 * i] = 1 + i, c[2 * i + 1] = 1, status[i] = 99;
        kept[i][0][0] = 0.5 * i, kept[i][0][Q] = 1 - i, kept[i][0][1] = 1;
        for (k = 0; k < STEPS * 6; ++k)
            u[i * STEPS * 6 + k] = k % 2 ? 0.1 * k - 0.3 * i : NAN;
    }
    stiffness[0] = 0, fails_at = NAN;
}

static void move_all(const mbs_motion *m, casadi_int begin, casadi_int end)
{
    void *room = malloc(mbs_room_of_rollout(m));
    mbs_rollout(m, begin, end, kept[0][0], room, status);
    free(room);
}

static int alike(double a, double b)
{
    return fabs(a - b) < 1e-13 * (1 + fabs(a));
}

/* Without a spring, Euler's method sums inputs, and the midpoint method sums inputs of its second stage. */
static void sums(int by_stage)
{
    mbs_motion m;
    mbs_course course[3];
    int i, step;
    if (by_stage)
        fill(&m, course, 2, MIDPOINT_A, MIDPOINT_B, 1);
    else
        fill(&m, course, 1, EULER_A, EULER_B, 0);
    move_all(&m, 0, STATES);
    for (i = 0; i < STATES; ++i) {
        double q = 0.5 * i, v = 1 - i;
        LAW("a motion that ends has status 0", status[i] == 0);
        LAW("the first sample is the start", kept[i][0][0] == q && kept[i][0][Q] == v);
        for (step = 1; step <= STEPS; ++step) {
            const double *at = u + (i * STEPS + step - 1) * 6 + 1;
            q += 0.25 * (by_stage ? v + 0.125 * at[0] * (1 + i) : v);
            v += 0.25 * (by_stage ? at[2] : at[0]) * (1 + i);
            if (step % EVERY == 0) {
                const double *found = kept[i][step / EVERY];
                LAW("each step has its inputs", alike(found[Q], v));
                LAW("and velocities of its stages", alike(found[0], q));
                LAW("what is at rest stays", found[1] == 1 && found[4] == 0 && found[Q + 1] == 0 && found[Q + 3] == 0);
            }
        }
    }
}

/* A step of the classic method multiplies states of an oscillator by the first five terms of the exponential. */
static void oscillator(int with_rates)
{
    const double z = 0.25 * 2; /* step times frequency */
    const double cosine = 1 - z * z / 2 + z * z * z * z / 24, sine = z - z * z * z / 6;
    const int width = with_rates ? WIDTH : 2 * V, v_at = with_rates ? Q : V;
    double *flat = kept[0][0];
    mbs_motion m;
    mbs_course course[3];
    int i, step;
    fill(&m, course, 4, CLASSIC_A, CLASSIC_B, 0);
    memset(u, 0, sizeof u), memset(kept, 0, sizeof kept);
    stiffness[0] = 4;
    if (!with_rates)
        m.rates.f = 0, m.quaternions = 0, m.nq = V; /* q' = qd */
    for (i = 0; i < STATES; ++i)
        flat[i * SAMPLES * width] = 0.5 * i, flat[i * SAMPLES * width + v_at] = 1 - i, flat[i * SAMPLES * width + 1] = 1;
    move_all(&m, 0, STATES);
    for (i = 0; i < STATES; ++i) {
        double q = 0.5 * i, v = 1 - i;
        const double *end = flat + ((i + 1) * SAMPLES - 1) * width;
        for (step = 0; step < STEPS; ++step) {
            const double next = cosine * q + sine * v / 2;
            v = cosine * v - 2 * sine * q, q = next;
        }
        LAW("an oscillator moves as the series of its exponential", alike(end[0], q) && alike(end[v_at], v));
    }
}

/* Turning about one axis: Euler's step adds half the angle as a tangent, and the length is 1 after each. */
static void turns(void)
{
    mbs_motion m;
    mbs_course course[3];
    int i, k, sample;
    for (k = 0; k < 3; ++k) {
        fill(&m, course, 1, EULER_A, EULER_B, 0);
        for (i = 0; i < STATES; ++i)
            kept[i][0][Q + 1 + k] = 0.4 * (i + 1);
        move_all(&m, 0, STATES);
        for (i = 0; i < STATES; ++i)
            for (sample = 1; sample < SAMPLES; ++sample) {
                const double half = EVERY * sample * atan(0.25 * 0.4 * (i + 1) / 2), *p = kept[i][sample] + 1;
                LAW("a quaternion turns by its angle", alike(p[0], cos(half)) && alike(p[1 + k], sin(half)));
                LAW("and about its axis", p[1 + (k + 1) % 3] == 0 && p[1 + (k + 2) % 3] == 0);
            }
    }
}

/* A part of the states moves, or one of them fails. */
static void parts(void)
{
    mbs_motion m;
    mbs_course course[3];
    double all[STATES][SAMPLES][WIDTH];
    int i;
    fill(&m, course, 1, EULER_A, EULER_B, 0);
    move_all(&m, 0, STATES);
    memcpy(all, kept, sizeof all);
    fill(&m, course, 1, EULER_A, EULER_B, 0);
    move_all(&m, 1, 4);
    for (i = 0; i < STATES; ++i)
        if (i >= 1 && i < 4)
            LAW("states move alike in parts", !memcmp(all[i], kept[i], sizeof all[i]) && status[i] == 0);
        else
            LAW("others do not move", kept[i][1][0] == 0 && kept[i][SAMPLES - 1][Q] == 0 && status[i] == 99);
    fill(&m, course, 1, EULER_A, EULER_B, 0);
    move_all(&m, MBS_ABREAST, MBS_ABREAST);
    for (i = 0; i < STATES; ++i)
        LAW("of no states none moves", kept[i][1][0] == 0 && status[i] == 99);
    fill(&m, course, 1, EULER_A, EULER_B, 0);
    fails_at = all[5][1][0]; /* of the sixth state, after two steps */
    move_all(&m, 0, STATES);
    for (i = 0; i < STATES; ++i) {
        const int beside = MBS_ABREAST > 1 && i / MBS_ABREAST == 5 / MBS_ABREAST;
        LAW("a motion that fails has the kernel's status", i != 5 || status[i] == (MBS_ABREAST > 1 ? MBS_GROUP_FAILED : 7));
        LAW("and the ones beside it are named", i == 5 || status[i] == (beside ? MBS_GROUP_FAILED : 0));
        LAW("others are as ever", i == 5 || beside || !memcmp(all[i], kept[i], sizeof all[i]));
        LAW("its last step is the one before", i != 5 || (kept[i][1][0] == all[i][1][0] && kept[i][2][0] == 0));
    }
}

/* Many numbers and stages: the memory that is asked for suffices (the sanitizer watches), and is not much more. */
enum { WIDE = 120 };

static int hold(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem)
{
    casadi_int k;
    (void)arg, (void)iw, (void)w, (void)mem;
    for (k = 0; k < WIDE; ++k)
        res[0][k] = arg[500][k];
    return 0;
}

static void room(void)
{
    static double start[STATES][2][2 * WIDE], given[WIDE];
    const mbs_function f = {hold, 600, 400, 1, 0};
    const mbs_course course[1] = {{given, 0, 0, 0, WIDE, 500, -1}};
    mbs_motion m = {f, {0, 0, 0, 0, 0}, WIDE, WIDE, 0, 0, 1, course, 4, CLASSIC_A, CLASSIC_B, 0.5, 1, 1};
    const size_t needed = (size_t)(7 * 2 * WIDE + WIDE) * sizeof(mbs_real) + 1000 * sizeof(void *);
    void *memory = malloc(mbs_room_of_rollout(&m));
    int k;
    for (k = 0; k < WIDE; ++k)
        given[k] = k;
    mbs_rollout(&m, 0, STATES, start[0][0], memory, status);
    for (k = 0; k < WIDE; ++k)
        LAW("each number moves", alike(start[6][1][k], 0.125 * k) && alike(start[6][1][WIDE + k], 0.5 * k));
    LAW("memory is no more than for all numbers, and some lines", mbs_room_of_rollout(&m) - needed <= 2048);
    free(memory);
}

int main(void)
{
    sums(0), sums(1), oscillator(1), oscillator(0), turns(), parts(), room();
    return broken > 0;
}

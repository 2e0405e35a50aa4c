/* Motions of many states: each group of states goes through all its steps before the next one begins. */
#include "mbs_rollout.h"

#include <math.h>
#include <stdint.h>

#define MBS_LINE 128 /* bytes that vectors are aligned to */

typedef struct {
    mbs_real *x, *stage, *slopes, *found; /* of states (q, qd); of a kernel's result */
    mbs_real *given;                      /* the numbers of all courses */
    const mbs_real **arg, **rates_arg;
    mbs_real **res, **rates_res;
} mbs_desk;

static casadi_int count_given(const mbs_motion *motion)
{
    casadi_int i, sum = 0;
    for (i = 0; i < motion->courses; ++i)
        sum += motion->course[i].numbers;
    return sum;
}

size_t mbs_room_of_rollout(const mbs_motion *motion)
{
    const casadi_int width = motion->nq + motion->n;
    const casadi_int numbers = (3 + motion->stages) * width + count_given(motion);
    const casadi_int pointers = motion->accelerations.n_in + motion->accelerations.n_out + motion->rates.n_in
                                + motion->rates.n_out;
    return 12 * MBS_LINE + (size_t)numbers * sizeof(mbs_real) + (size_t)pointers * sizeof(void *);
}

static void *take(char **room, size_t bytes)
{
    void *taken = *room;
    *room += (bytes + MBS_LINE - 1) / MBS_LINE * MBS_LINE;
    return taken;
}

/* Lay out the arguments of a function: the stage's state, and nothing for others. */
static void lay_function(const mbs_function *function, casadi_int nq, const mbs_desk *desk, const mbs_real **arg,
                         mbs_real **res)
{
    casadi_int i;
    for (i = 0; i < function->n_in; ++i)
        arg[i] = 0;
    for (i = 0; i < function->n_out; ++i)
        res[i] = 0;
    if (function->f) {
        arg[function->q] = desk->stage;
        arg[function->qd] = desk->stage + nq;
        res[0] = desk->found;
    }
}

static mbs_desk lay_out(const mbs_motion *motion, void *room)
{
    char *free = (char *)(((uintptr_t)room + MBS_LINE - 1) / MBS_LINE * MBS_LINE);
    const mbs_function *f = &motion->accelerations, *rates = &motion->rates;
    const size_t state = (size_t)(motion->nq + motion->n) * sizeof(mbs_real), pointer = sizeof(void *);
    mbs_desk desk;
    casadi_int i, place = 0;
    desk.x = take(&free, state);
    desk.stage = take(&free, state);
    desk.found = take(&free, state);
    desk.slopes = take(&free, (size_t)motion->stages * state);
    desk.given = take(&free, (size_t)count_given(motion) * sizeof(mbs_real));
    desk.arg = take(&free, (size_t)f->n_in * pointer);
    desk.res = take(&free, (size_t)f->n_out * pointer);
    desk.rates_arg = take(&free, (size_t)rates->n_in * pointer);
    desk.rates_res = take(&free, (size_t)rates->n_out * pointer);
    lay_function(f, motion->nq, &desk, desk.arg, desk.res);
    lay_function(rates, motion->nq, &desk, desk.rates_arg, desk.rates_res);
    for (i = 0; i < motion->courses; place += motion->course[i++].numbers) {
        if (motion->course[i].place >= 0)
            desk.arg[motion->course[i].place] = desk.given + place;
        if (motion->course[i].rates_place >= 0)
            desk.rates_arg[motion->course[i].rates_place] = desk.given + place;
    }
    return desk;
}

static void set(mbs_real *numbers, int state, MBS_REAL x)
{
    ((MBS_REAL *)numbers)[state] = x;
}

/* Give inputs and parameters of a stage: all at the start, the changing ones in later steps and stages. */
static void give(const mbs_motion *motion, const casadi_int *state, casadi_int step, casadi_int stage, mbs_real *given)
{
    casadi_int i, k;
    int s;
    for (i = 0; i < motion->courses; given += motion->course[i++].numbers) {
        const mbs_course *course = motion->course + i;
        if (stage ? !course->stage_pace : step && !course->pace)
            continue;
        for (s = 0; s < MBS_ABREAST; ++s) {
            const MBS_REAL *from = course->first + state[s] * course->step + step * course->pace
                                   + stage * course->stage_pace;
            for (k = 0; k < course->numbers; ++k)
                set(given + k, s, from[k]);
        }
    }
}

/* Write the slope of the stage's state. */
static int find_slope(const mbs_motion *motion, const mbs_desk *desk, mbs_real *slope)
{
    const casadi_int nq = motion->nq, n = motion->n;
    casadi_int k;
    int status = 0;
    if (motion->rates.f)
        status = motion->rates.f(desk->rates_arg, desk->rates_res, 0, 0, 0);
    for (k = 0; k < nq; ++k)
        slope[k] = motion->rates.f ? desk->found[k] : desk->stage[nq + k];
    if (!status)
        status = motion->accelerations.f(desk->arg, desk->res, 0, 0, 0);
    for (k = 0; k < n; ++k)
        slope[nq + k] = desk->found[k];
    return status;
}

/* Add the slopes of the first stages, with weights, to a state. */
static void add_slopes(const mbs_motion *motion, const mbs_desk *desk, casadi_int stages, const MBS_REAL *weights,
                       mbs_real *to)
{
    const casadi_int width = motion->nq + motion->n;
    casadi_int j, k;
    for (k = 0; k < width; ++k) {
        mbs_real sum = MBS_EVERY(0);
        for (j = 0; j < stages; ++j)
            if (weights[j] != 0)
                sum += weights[j] * desk->slopes[j * width + k];
        to[k] = desk->x[k] + motion->h * sum;
    }
}

/* Take a step. */
static int advance(const mbs_motion *motion, const mbs_desk *desk, const casadi_int *state, casadi_int step)
{
    casadi_int i, k;
    for (i = 0; i < motion->stages; ++i) {
        int status;
        give(motion, state, step, i, desk->given);
        add_slopes(motion, desk, i, motion->A + i * motion->stages, desk->stage);
        status = find_slope(motion, desk, desk->slopes + i * (motion->nq + motion->n));
        if (status)
            return status;
    }
    add_slopes(motion, desk, motion->stages, motion->b, desk->x);
    for (i = 0; i < motion->quaternions; ++i) {
        mbs_real *p = desk->x + motion->quaternion[i];
        const mbs_real length = MBS_SQRT(p[0] * p[0] + p[1] * p[1] + (p[2] * p[2] + p[3] * p[3]));
        for (k = 0; k < 4; ++k)
            p[k] /= length;
    }
    return 0;
}

/* Keep the states of a group; beyond the end, it is filled with the last one. */
static void keep(const mbs_motion *motion, const mbs_desk *desk, const casadi_int *state, casadi_int sample, MBS_REAL *kept)
{
    const casadi_int width = motion->nq + motion->n, samples = 1 + motion->steps / motion->every;
    casadi_int k;
    int s;
    for (s = 0; s < MBS_ABREAST; ++s) {
        MBS_REAL *to = kept + (state[s] * samples + sample) * width;
        for (k = 0; k < width; ++k)
            to[k] = ((const MBS_REAL *)(desk->x + k))[s];
    }
}

static int move(const mbs_motion *motion, const mbs_desk *desk, const casadi_int *state, MBS_REAL *kept)
{
    const casadi_int width = motion->nq + motion->n, samples = 1 + motion->steps / motion->every;
    casadi_int k, step;
    int s, status;
    for (s = 0; s < MBS_ABREAST; ++s)
        for (k = 0; k < width; ++k)
            set(desk->x + k, s, kept[state[s] * samples * width + k]);
    for (step = 0; step < motion->steps; ++step) {
        status = advance(motion, desk, state, step);
        if (status)
            return status;
        if ((step + 1) % motion->every == 0)
            keep(motion, desk, state, (step + 1) / motion->every, kept);
    }
    return 0;
}

void mbs_rollout(const mbs_motion *motion, casadi_int begin, casadi_int end, MBS_REAL *kept, void *room, int *status)
{
    const mbs_desk desk = lay_out(motion, room);
    casadi_int first, state[MBS_ABREAST];
    int s, failure;
    for (first = begin; first < end; first += MBS_ABREAST) {
        for (s = 0; s < MBS_ABREAST; ++s)
            state[s] = first + s < end ? first + s : end - 1;
        failure = move(motion, &desk, state, kept);
        for (s = 0; s < MBS_ABREAST; ++s)
            status[state[s]] = failure && MBS_ABREAST > 1 ? MBS_GROUP_FAILED : failure;
    }
}

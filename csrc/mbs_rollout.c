/* Motions of many states: each group of states goes through all its steps before the next one begins. */
#include "mbs_rollout.h"

#include <stdint.h>

#define MBS_LINE 128 /* bytes that vectors are aligned to */

typedef struct {
    mbs_real *x, *stage, *slopes, *qdd; /* 2 n, 2 n, stages * 2 n and n numbers */
    mbs_real *given;                    /* the numbers of all courses */
    const mbs_real **arg;
    mbs_real **res;
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
    const casadi_int numbers = (5 + 2 * motion->stages) * motion->n + count_given(motion);
    const casadi_int pointers = motion->n_in + motion->n_out;
    return 8 * MBS_LINE + (size_t)numbers * sizeof(mbs_real) + (size_t)pointers * sizeof(void *);
}

static void *take(char **room, size_t bytes)
{
    void *taken = *room;
    *room += (bytes + MBS_LINE - 1) / MBS_LINE * MBS_LINE;
    return taken;
}

static mbs_desk lay_out(const mbs_motion *motion, void *room)
{
    char *free = (char *)(((uintptr_t)room + MBS_LINE - 1) / MBS_LINE * MBS_LINE);
    const size_t n = (size_t)motion->n;
    mbs_desk desk;
    casadi_int i, place = 0;
    desk.x = take(&free, 2 * n * sizeof(mbs_real));
    desk.stage = take(&free, 2 * n * sizeof(mbs_real));
    desk.slopes = take(&free, (size_t)motion->stages * 2 * n * sizeof(mbs_real));
    desk.qdd = take(&free, n * sizeof(mbs_real));
    desk.given = take(&free, (size_t)count_given(motion) * sizeof(mbs_real));
    desk.arg = take(&free, (size_t)motion->n_in * sizeof(void *));
    desk.res = take(&free, (size_t)motion->n_out * sizeof(void *));
    for (i = 0; i < motion->n_in; ++i)
        desk.arg[i] = 0;
    for (i = 0; i < motion->n_out; ++i)
        desk.res[i] = 0;
    for (i = 0; i < motion->courses; place += motion->course[i++].numbers)
        desk.arg[motion->course[i].place] = desk.given + place;
    desk.arg[motion->q] = desk.stage;
    desk.arg[motion->qd] = desk.stage + n;
    desk.res[0] = desk.qdd;
    return desk;
}

static void set(mbs_real *numbers, int state, MBS_REAL x)
{
    ((MBS_REAL *)numbers)[state] = x;
}

/* Give inputs and parameters of a step: all in step 0, the changing ones in later steps. */
static void give(const mbs_motion *motion, const casadi_int *state, casadi_int step, mbs_real *given)
{
    casadi_int i, k;
    int s;
    for (i = 0; i < motion->courses; given += motion->course[i++].numbers) {
        const mbs_course *course = motion->course + i;
        if (step && !course->pace)
            continue;
        for (s = 0; s < MBS_ABREAST; ++s) {
            const MBS_REAL *from = course->first + state[s] * course->step + step * course->pace;
            for (k = 0; k < course->numbers; ++k)
                set(given + k, s, from[k]);
        }
    }
}

/* Take a step. */
static int advance(const mbs_motion *motion, const mbs_desk *desk)
{
    const casadi_int n = motion->n, stages = motion->stages;
    casadi_int i, j, k;
    for (i = 0; i < stages; ++i) {
        mbs_real *slope = desk->slopes + i * 2 * n;
        int status;
        for (k = 0; k < 2 * n; ++k) {
            mbs_real sum = MBS_EVERY(0);
            for (j = 0; j < i; ++j)
                if (motion->A[i * stages + j] != 0)
                    sum += motion->A[i * stages + j] * desk->slopes[j * 2 * n + k];
            desk->stage[k] = desk->x[k] + motion->h * sum;
        }
        status = motion->f(desk->arg, desk->res, 0, 0, 0);
        if (status)
            return status;
        for (k = 0; k < n; ++k) {
            slope[k] = desk->stage[n + k];
            slope[n + k] = desk->qdd[k];
        }
    }
    for (k = 0; k < 2 * n; ++k) {
        mbs_real sum = MBS_EVERY(0);
        for (i = 0; i < stages; ++i)
            if (motion->b[i] != 0)
                sum += motion->b[i] * desk->slopes[i * 2 * n + k];
        desk->x[k] += motion->h * sum;
    }
    return 0;
}

/* Keep the states of a group; beyond the end, it is filled with the last one. */
static void keep(const mbs_motion *motion, const mbs_desk *desk, const casadi_int *state, casadi_int sample, MBS_REAL *kept)
{
    const casadi_int width = 2 * motion->n, samples = 1 + motion->steps / motion->every;
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
    const casadi_int width = 2 * motion->n, samples = 1 + motion->steps / motion->every;
    casadi_int k, step;
    int s, status;
    for (s = 0; s < MBS_ABREAST; ++s)
        for (k = 0; k < width; ++k)
            set(desk->x + k, s, kept[state[s] * samples * width + k]);
    for (step = 0; step < motion->steps; ++step) {
        give(motion, state, step, desk->given);
        status = advance(motion, desk);
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

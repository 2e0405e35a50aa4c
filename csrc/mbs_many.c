/* A kernel in many states: its numbers are gathered, and its results are put in their places. */
#include "mbs_many.h"

#include <stdint.h>

#define MBS_LINE 128 /* bytes that vectors are aligned to */
#ifdef MBS_STATES
#define MBS_AT_ONCE MBS_STATES
#else
#define MBS_AT_ONCE 1
#endif

typedef struct {
    mbs_kernel one;
    mbs_kernel_of_several several;
    casadi_int states, n_in, n_out;
    const mbs_given *in;
    const mbs_found *out;
    const MBS_REAL **arg;
    MBS_REAL **res;
    const mbs_real **args;
    mbs_real **ress;
    MBS_REAL *numbers; /* of one state */
    mbs_real *lanes;   /* of several */
    int *status;
} mbs_work;

/* Count the numbers of all arguments in one state. Each argument has some to spare: they are moved by whole vectors. */
static size_t count(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out)
{
    size_t sum = 0;
    casadi_int i;
    for (i = 0; i < n_in; ++i)
        sum += (size_t)in[i].nonzeros + MBS_AT_ONCE;
    for (i = 0; i < n_out; ++i)
        sum += (size_t)out[i].nonzeros + MBS_AT_ONCE;
    return sum;
}

size_t mbs_room_of_many(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out)
{
    const size_t pointers = 2 * (size_t)(n_in + n_out + 2);
    return 8 * MBS_LINE + count(n_in, in, n_out, out) * (MBS_AT_ONCE + 1) * sizeof(MBS_REAL) + pointers * sizeof(void *);
}

/* -- one state -- */

/* Return whether nonzeros stand one after the other: a kernel can write them itself. */
static int is_plain(const mbs_found *a)
{
    return a->apart == 1 && !a->entries;
}

/* Put the nonzeros of a result in their places. */
static void put_one(const mbs_found *a, casadi_int state, const MBS_REAL *nonzeros)
{
    MBS_REAL *to = a->first + state * a->step;
    casadi_int k;
    for (k = 0; k < a->numbers; ++k) {
        const casadi_int entry = a->entries ? a->entries[k] : k;
        to[k * a->apart] = entry < 0 ? 0 : nonzeros[entry];
    }
}

static int compute_one(const mbs_work *work, casadi_int state)
{
    MBS_REAL *free = work->numbers;
    casadi_int i, k;
    int failure;
    for (i = 0; i < work->n_in; ++i) {
        const mbs_given *a = work->in + i;
        const MBS_REAL *from = a->first ? a->first + state * a->step : 0;
        work->arg[i] = from;
        if (!from || !a->places)
            continue;
        for (k = 0; k < a->nonzeros; ++k)
            free[k] = from[a->places[k]];
        work->arg[i] = free;
        free += a->nonzeros;
    }
    for (i = 0; i < work->n_out; free += work->out[i++].nonzeros) {
        const mbs_found *a = work->out + i;
        work->res[i] = !a->first ? 0 : is_plain(a) ? a->first + state * a->step : free;
    }
    failure = work->one(work->arg, work->res, 0, 0, 0);
    work->status[state] = failure;
    for (i = 0; i < work->n_out && !failure; ++i)
        if (work->out[i].first && !is_plain(work->out + i))
            put_one(work->out + i, state, work->res[i]);
    return failure != 0;
}

#ifdef MBS_STATES

/* -- several states -- */

typedef MBS_REAL mbs_loose __attribute__((vector_size(MBS_VECTOR), aligned(sizeof(MBS_REAL)), may_alias));

/* Two vectors that are merged in turn: the numbers of the first half, and of the second. */
#if MBS_STATES == 16
#define MBS_FIRST 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23
#define MBS_SECOND 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31
#elif MBS_STATES == 8
#define MBS_FIRST 0, 8, 1, 9, 2, 10, 3, 11
#define MBS_SECOND 4, 12, 5, 13, 6, 14, 7, 15
#elif MBS_STATES == 4
#define MBS_FIRST 0, 4, 1, 5
#define MBS_SECOND 2, 6, 3, 7
#else
#define MBS_FIRST 0, 2
#define MBS_SECOND 1, 3
#endif
#if defined(__clang__)
#define MBS_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define MBS_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (mbs_flags){__VA_ARGS__})
#endif

/* Transpose a square of numbers: merged in turn, a row and the row that is half of them below become two, and a number's
 * row and column exchange one digit. */
static inline void transpose(mbs_real *rows)
{
    mbs_real now[MBS_STATES], merged[MBS_STATES];
    int turn, i;
    MBS_UNROLLED
    for (i = 0; i < MBS_STATES; ++i)
        now[i] = rows[i];
    MBS_UNROLLED
    for (turn = 1; turn < MBS_STATES; turn *= 2) {
        MBS_UNROLLED
        for (i = 0; i < MBS_STATES / 2; ++i) {
            merged[2 * i] = MBS_SHUFFLE(now[i], now[i + MBS_STATES / 2], MBS_FIRST);
            merged[2 * i + 1] = MBS_SHUFFLE(now[i], now[i + MBS_STATES / 2], MBS_SECOND);
        }
        MBS_UNROLLED
        for (i = 0; i < MBS_STATES; ++i)
            now[i] = merged[i];
    }
    MBS_UNROLLED
    for (i = 0; i < MBS_STATES; ++i)
        rows[i] = now[i];
}

/* Gather the numbers of an input from number k on, in the given states. */
static void gather_each(const mbs_given *a, const casadi_int *state, casadi_int k, mbs_real *lanes)
{
    int s;
    for (; k < a->nonzeros; ++k) {
        const MBS_REAL *from = a->first + (a->places ? a->places[k] : k);
        mbs_real numbers;
        for (s = 0; s < MBS_STATES; ++s)
            numbers[s] = from[state[s] * a->step];
        lanes[k] = numbers;
    }
}

/* The same for states in sequence, of `states` in all. Rows are read by whole vectors, beyond their ends where
 * other rows follow. */
static void gather(const mbs_given *a, casadi_int states, const casadi_int *state, mbs_real *lanes)
{
    const casadi_int last = (states - MBS_STATES - state[0]) * a->step + a->nonzeros - MBS_STATES;
    const MBS_REAL *from = a->first + state[0] * a->step;
    casadi_int k = 0;
    int s;
    if (a->step == 1)
        for (; k < a->nonzeros; ++k)
            lanes[k] = *(const mbs_loose *)(from + (a->places ? a->places[k] : k));
    else if (!a->places && a->step >= a->nonzeros)
        for (; k < a->nonzeros && k <= last; k += MBS_STATES) {
            MBS_UNROLLED
            for (s = 0; s < MBS_STATES; ++s)
                lanes[k + s] = *(const mbs_loose *)(from + s * a->step + k);
            transpose(lanes + k);
        }
    gather_each(a, state, k, lanes);
}

static inline mbs_real number_of(const mbs_found *a, casadi_int k, const mbs_real *lanes)
{
    const casadi_int entry = a->entries ? a->entries[k] : k;
    return entry < 0 ? (mbs_real){0} : lanes[entry];
}

/* Put the numbers of a result in their places from number k on, except for states that are left out. */
static void put_each(const mbs_found *a, const casadi_int *state, const int *left_out, casadi_int k, const mbs_real *lanes)
{
    int s;
    for (; k < a->numbers; ++k) {
        const mbs_real numbers = number_of(a, k, lanes);
        for (s = 0; s < MBS_STATES; ++s)
            if (!left_out || !left_out[s])
                a->first[state[s] * a->step + k * a->apart] = numbers[s];
    }
}

/* Put a square of numbers of the states in sequence. */
static inline void put_square(const mbs_found *a, const casadi_int *state, casadi_int k, const mbs_real *lanes)
{
    mbs_real rows[MBS_STATES];
    int s;
    MBS_UNROLLED
    for (s = 0; s < MBS_STATES; ++s)
        rows[s] = number_of(a, k + s, lanes);
    transpose(rows);
    MBS_UNROLLED
    for (s = 0; s < MBS_STATES; ++s)
        *(mbs_loose *)(a->first + (state[0] + s) * a->step + k) = rows[s];
}

/* The same for rows that are shorter than a vector, and follow each other: a vector also writes what the next rows will
 * write over, within the group. */
static void put_short(const mbs_found *a, const casadi_int *state, const mbs_real *lanes)
{
    MBS_REAL *to = a->first + state[0] * a->step;
    mbs_real rows[MBS_STATES];
    casadi_int k;
    int s;
    MBS_UNROLLED
    for (s = 0; s < MBS_STATES; ++s)
        rows[s] = s < a->numbers ? number_of(a, s, lanes) : (mbs_real){0};
    transpose(rows);
    MBS_UNROLLED
    for (s = 0; s < MBS_STATES; ++s) {
        if (s * a->step + MBS_STATES <= MBS_STATES * a->step)
            *(mbs_loose *)(to + s * a->step) = rows[s];
        else
            for (k = 0; k < a->numbers; ++k)
                to[s * a->step + k] = rows[s][k];
    }
}

static void put(const mbs_found *a, const casadi_int *state, const mbs_real *lanes)
{
    casadi_int k = 0;
    if (a->step == 1)
        for (; k < a->numbers; ++k)
            *(mbs_loose *)(a->first + state[0] + k * a->apart) = number_of(a, k, lanes);
    else if (a->apart == 1 && a->numbers >= MBS_STATES) {
        for (; k + MBS_STATES <= a->numbers; k += MBS_STATES)
            put_square(a, state, k, lanes);
        if (k < a->numbers)
            put_square(a, state, a->numbers - MBS_STATES, lanes);
        return;
    }
    if (k < a->numbers && a->apart == 1 && a->step == a->numbers)
        put_short(a, state, lanes);
    else
        put_each(a, state, 0, k, lanes);
}

/* Lay out the arrays of lanes; numbers that all states share are gathered once. */
static void lay_out(const mbs_work *work)
{
    static const casadi_int none[MBS_STATES];
    mbs_real *free = work->lanes;
    casadi_int i, k;
    for (i = 0; i < work->n_in; free += work->in[i++].nonzeros + MBS_STATES) {
        work->args[i] = free;
        if (!work->in[i].first)
            for (k = 0; k < work->in[i].nonzeros; ++k)
                free[k] = (mbs_real){0};
        else if (!work->in[i].step)
            gather_each(work->in + i, none, 0, free);
    }
    for (i = 0; i < work->n_out; free += work->out[i++].nonzeros + MBS_STATES)
        work->ress[i] = work->out[i].first ? free : 0;
}

/* Compute a group in which a state fails: each state alone; then the states that do not fail once more in lanes, with one of
 * them in place of each that fails. So a failure changes no digit of other states. */
static casadi_int compute_failing(const mbs_work *work, casadi_int begin, casadi_int end)
{
    casadi_int state[MBS_STATES], good = -1, failures = 0, i;
    int left_out[MBS_STATES], s;
    for (i = begin; i < end; ++i) {
        if (compute_one(work, i))
            ++failures;
        else
            good = i;
    }
    if (good < 0 || !failures)
        return failures;
    for (s = 0; s < MBS_STATES; ++s) {
        left_out[s] = begin + s >= end || work->status[begin + s];
        state[s] = left_out[s] ? good : begin + s;
    }
    for (i = 0; i < work->n_in; ++i)
        if (work->in[i].first && work->in[i].step)
            gather_each(work->in + i, state, 0, (mbs_real *)work->args[i]);
    if (work->several(work->args, work->ress, 0, 0, 0) == 0)
        for (i = 0; i < work->n_out; ++i)
            if (work->out[i].first)
                put_each(work->out + i, state, left_out, 0, work->ress[i]);
    return failures;
}

/* Compute the states of a group, which may be fewer than a vector has numbers: the last one fills it. */
static casadi_int compute_group(const mbs_work *work, casadi_int begin, casadi_int end)
{
    casadi_int state[MBS_STATES], i;
    int left_out[MBS_STATES], s;
    const int is_full = begin + MBS_STATES <= end;
    for (s = 0; s < MBS_STATES; ++s) {
        left_out[s] = begin + s >= end;
        state[s] = left_out[s] ? end - 1 : begin + s;
    }
    for (i = 0; i < work->n_in; ++i) {
        if (!work->in[i].first || !work->in[i].step)
            continue;
        if (is_full)
            gather(work->in + i, work->states, state, (mbs_real *)work->args[i]);
        else
            gather_each(work->in + i, state, 0, (mbs_real *)work->args[i]);
    }
    if (work->several(work->args, work->ress, 0, 0, 0))
        return compute_failing(work, begin, end);
    for (i = 0; i < work->n_out; ++i) {
        if (!work->out[i].first)
            continue;
        if (is_full)
            put(work->out + i, state, work->ress[i]);
        else
            put_each(work->out + i, state, left_out, 0, work->ress[i]);
    }
    for (i = begin; i < end; ++i)
        work->status[i] = 0;
    return 0;
}

#endif

/* -- all states -- */

/* Take memory for arrays, aligned. */
static void *take(char **room, size_t bytes)
{
    void *taken = *room;
    *room += (bytes + MBS_LINE - 1) / MBS_LINE * MBS_LINE;
    return taken;
}

casadi_int mbs_compute_many(mbs_kernel one, mbs_kernel_of_several several, casadi_int states, casadi_int begin,
                            casadi_int end, casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out,
                            void *room, int *status)
{
    const size_t numbers = count(n_in, in, n_out, out);
    char *free = (char *)(((uintptr_t)room + MBS_LINE - 1) / MBS_LINE * MBS_LINE);
    mbs_work work = {one, several, states, n_in, n_out, in, out, 0, 0, 0, 0, 0, 0, status};
    casadi_int failures = 0, state;
    work.lanes = take(&free, numbers * MBS_AT_ONCE * sizeof(MBS_REAL));
    work.numbers = take(&free, numbers * sizeof(MBS_REAL));
    work.arg = take(&free, (size_t)(n_in + 1) * sizeof(void *));
    work.res = take(&free, (size_t)(n_out + 1) * sizeof(void *));
    work.args = take(&free, (size_t)(n_in + 1) * sizeof(void *));
    work.ress = take(&free, (size_t)(n_out + 1) * sizeof(void *));
#ifdef MBS_STATES
    lay_out(&work);
    for (state = begin; state < end; state += MBS_STATES)
        failures += compute_group(&work, state, state + MBS_STATES < end ? state + MBS_STATES : end);
#else
    for (state = begin; state < end; ++state)
        failures += compute_one(&work, state);
#endif
    return failures;
}

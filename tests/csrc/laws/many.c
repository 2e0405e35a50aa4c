/* A kernel in many states, one at a time or (many_lanes.c) four: results in their places, of arrays in any layout.
 *
 * Numbers are whole, so that results are exact; arrays have their size, and nothing is written between results. */
#include "../../../csrc/mbs_many.c"

#include "laws.h"

#include <stdlib.h>

enum { A = 5, B = 2, C = 3, Y = 6, Z = 2, MOST = 14, UNTOUCHED = -7 };

static int calls;

/* y_k = (k + 1) a_k + b_k + c_k, z_k = a_0 - b_k, where a_0 is not negative; of fewer numbers in turn. */
#define DEFINE(name, real, is_negative) \
    static int name(const real **arg, real **res, casadi_int *iw, real *w, int mem) \
    { \
        casadi_int k; \
        (void)iw, (void)w, (void)mem, ++calls; \
        if (is_negative) \
            return 3; \
        for (k = 0; k < Y && res[0]; ++k) { \
            res[0][k] = arg[0][k % A] * (MBS_REAL)(k + 1) + arg[1][k % B]; \
            if (arg[2]) \
                res[0][k] += arg[2][k % C]; \
        } \
        for (k = 0; k < Z && res[1]; ++k) \
            res[1][k] = arg[0][0] - arg[1][k]; \
        return 0; \
    }

DEFINE(one, MBS_REAL, arg[0][0] < 0)
#ifdef MBS_STATES
static int has_negative(const mbs_real *x)
{
    int s;
    for (s = 0; s < MBS_STATES; ++s)
        if ((*x)[s] < 0)
            return 1;
    return 0;
}
DEFINE(several, mbs_real, has_negative(arg[0]))
#define SEVERAL several
#else
#define SEVERAL 0
#endif

/* A layout: numbers of a state one after the other, with a gap between states, or states one after the other. */
typedef struct {
    int by_columns, gap, spread, has_c, has_y, fails;
} layout;

static double of_a(int state, int k)
{
    return 10 * state + k + 1;
}

static double of_c(int k)
{
    return 1000 * (k + 1);
}

/* Number k of y as it must be: nonzeros in turn, or the last first, then the others, with zeros behind. */
static double wanted_y(const layout *l, int state, int k)
{
    const int entry = !l->spread ? k : k == 0 ? Y - 1 : k - 1;
    if (entry >= Y)
        return 0;
    return of_a(state, entry % A) * (entry + 1) + 100 * (entry % B + 1) + (l->has_c ? of_c(entry % C) : 0);
}

static void try(const layout *l, int states, int begin, int end)
{
    const int width = A + l->gap, numbers = Y + 2 * l->spread, y_step = numbers + l->gap;
    const casadi_int spread[Y + 2] = {Y - 1, 0, 1, 2, 3, 4, 5, -1};
    casadi_int places[A];
    const size_t a_size = (size_t)(l->by_columns ? states * A : (states - 1) * width + A);
    const size_t y_size = (size_t)(l->by_columns ? states * numbers : (states - 1) * y_step + numbers);
    double *a = malloc(a_size * sizeof *a), *y = malloc(y_size * sizeof *y), *z = malloc((size_t)(states * Z) * sizeof *z);
    double b[B] = {100, 200}, c[C] = {of_c(0), of_c(1), of_c(2)};
    int *status = malloc((size_t)states * sizeof *status), s, k, failures = 0;
    mbs_given in[3] = {{a, l->by_columns ? 1 : width, A, l->by_columns ? places : 0}, {b, 0, B, 0}, {0, 0, C, 0}};
    mbs_found out[2] = {{y, l->by_columns ? 1 : y_step, l->by_columns ? states : 1, Y, numbers, l->spread ? spread : 0},
                        {z, Z, 1, Z, Z, 0}};
    void *room;
    for (k = 0; k < A; ++k)
        places[k] = k * states;
    if (l->has_c)
        in[2].first = c;
    if (!l->has_y)
        out[0].first = 0;
    for (k = 0; k < (int)a_size; ++k)
        a[k] = NAN;
    for (s = 0; s < states; ++s) {
        for (k = 0; k < A; ++k)
            a[l->by_columns ? k * states + s : s * width + k] = of_a(s, k);
        if (l->fails && s % 3 == l->fails % 3)
            a[l->by_columns ? s : s * width] = -1;
        failures += s >= begin && s < end && l->fails && s % 3 == l->fails % 3;
        status[s] = 99;
    }
    for (k = 0; k < (int)y_size; ++k)
        y[k] = UNTOUCHED;
    for (k = 0; k < states * Z; ++k)
        z[k] = UNTOUCHED;
    room = malloc(mbs_room_of_many(3, in, 2, out));
    calls = 0;
    LAW("failures are counted",
        mbs_compute_many(one, SEVERAL, states, begin, end, 3, in, 2, out, room, status) == failures);
    LAW("without failures each state, or group, is one call", l->fails || calls == (end - begin + MBS_ABREAST - 1) / MBS_ABREAST);
    for (s = 0; s < states; ++s) {
        const int is_done = s >= begin && s < end, fails = l->fails && s % 3 == l->fails % 3, writes = is_done && !fails;
        LAW("each state has its status", status[s] == (!is_done ? 99 : fails ? 3 : 0));
        for (k = 0; k < numbers; ++k) {
            const double found = y[l->by_columns ? k * states + s : s * y_step + k];
            LAW("results are in their places", found == (writes && l->has_y ? wanted_y(l, s, k) : UNTOUCHED));
        }
        for (k = 0; k < Z; ++k)
            LAW("those of few numbers, too", z[s * Z + k] == (writes ? of_a(s, 0) - b[k] : UNTOUCHED));
        for (k = numbers; k < y_step && !l->by_columns && s + 1 < states; ++k)
            LAW("nothing is written between them", y[s * y_step + k] == UNTOUCHED);
    }
    free(a), free(y), free(z), free(status), free(room);
}

/* The memory that is asked for holds all numbers and pointers, and little more. */
static void room(void)
{
    const mbs_given in[2] = {{0, 0, 400, 0}, {0, 0, 300, 0}};
    const mbs_found out[1] = {{0, 0, 1, 900, 900, 0}};
    const size_t lanes = MBS_ABREAST > 1 ? MBS_ABREAST + 1 : 2, numbers = 1600 * lanes * sizeof(MBS_REAL);
    const size_t found = mbs_room_of_many(2, in, 1, out);
    LAW("there is room for all numbers", found >= numbers);
    LAW("and little more", found <= numbers + 2048);
}

int main(void)
{
    static const int spans[][3] = {{1, 0, 1}, {2, 0, 2}, {3, 0, 3}, {4, 0, 4}, {5, 0, 5}, {7, 4, 7}, {8, 0, 8}, {9, 4, 8},
                                   {12, 4, 12}, {13, 0, 13}, {13, 8, 13}, {4, 4, 4}};
    unsigned kind, i;
    for (kind = 0; kind < 96; ++kind)
        for (i = 0; i < sizeof spans / sizeof *spans; ++i) {
            const layout l = {kind & 1, kind & 2 ? 3 : 0, (kind & 4) != 0, (kind & 8) != 0, (kind & 16) == 0, (int)(kind >> 5)};
            try(&l, spans[i][0], spans[i][1], spans[i][2]);
        }
    room();
    return broken > 0;
}

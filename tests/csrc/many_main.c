/* Compute states in lanes, one after the other, and by calls of the kernel: in arrays of exactly their size. */
#include <stdio.h>
#include <stdlib.h>

#include "mbs_many.h"

int kernel(const MBS_REAL **arg, MBS_REAL **res, casadi_int *iw, MBS_REAL *w, int mem);
int MBS_PASTE(kernel_at_, WIDTH)(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem);
#define compute_lanes MBS_PASTE(mbs_compute_many_at_, WIDTH)
#define room_of_lanes MBS_PASTE(mbs_room_of_many_at_, WIDTH)
size_t room_of_lanes(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out);
casadi_int compute_lanes(mbs_kernel one, mbs_kernel_of_several several, casadi_int states, casadi_int begin,
                         casadi_int end, casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out,
                         void *room, int *status);

static MBS_REAL *take(casadi_int numbers)
{
    MBS_REAL *x = malloc((size_t)numbers * sizeof(MBS_REAL));
    casadi_int k;
    for (k = 0; k < numbers; ++k)
        x[k] = (MBS_REAL)(rand() / (RAND_MAX + 1.0) + 0.1);
    return x;
}

/* Returns how many numbers or statuses differ. */
static int try(casadi_int states, int by_columns, int gap, int is_spread)
{
    const casadi_int width = INPUTS + gap, numbers = RESULTS + 2 * is_spread;
    MBS_REAL *x = take(by_columns ? states * INPUTS : (states - 1) * width + INPUTS), *p = take(1), *y[2];
    casadi_int places[INPUTS], entries[RESULTS + 2], k, s, failures[2] = {0, 0};
    int *status[2], wrong = 0, way;
    for (k = 0; k < INPUTS; ++k)
        places[k] = by_columns ? k * states : k;
    for (k = 0; k < numbers; ++k)
        entries[k] = k < 1 ? RESULTS - 1 : k > RESULTS ? -1 : k - 1;
    for (s = 0; s < states; s += 11)
        x[by_columns ? s : s * width] = 0; /* these fail */
    for (way = 0; way < 2; ++way) {
        mbs_given in[2] = {{x, by_columns ? 1 : width, INPUTS, by_columns ? places : 0}, {p, 0, 1, 0}};
        mbs_found out[1] = {{0, by_columns ? 1 : numbers, by_columns ? states : 1, RESULTS, numbers, is_spread ? entries : 0}};
        void *room = malloc(way ? room_of_lanes(2, in, 1, out) : mbs_room_of_many(2, in, 1, out));
        y[way] = take(states * numbers);
        for (k = 0; k < states * numbers; ++k)
            y[way][k] = -7;
        status[way] = malloc((size_t)states * sizeof(int));
        out[0].first = y[way];
        if (way)
            failures[1] = compute_lanes(kernel, (mbs_kernel_of_several)MBS_PASTE(kernel_at_, WIDTH), states, 0, states, 2, in,
                                        1, out, room, status[way]);
        else
            failures[0] = mbs_compute_many(kernel, 0, states, 0, states, 2, in, 1, out, room, status[way]);
        free(room);
    }
    for (s = 0; s < states; ++s) {
        wrong += status[0][s] != status[1][s] || (status[0][s] != 0) != (s % 11 == 0);
        for (k = 0; k < numbers; ++k) {
            const casadi_int at = by_columns ? k * states + s : s * numbers + k;
            const double a = y[0][at], b = y[1][at];
            wrong += !(a - b <= 64 * MBS_EPSILON && b - a <= 64 * MBS_EPSILON) || (status[0][s] && a != -7);
        }
    }
    wrong += failures[0] != failures[1] || failures[0] != (states + 10) / 11;
    for (way = 0; way < 2; ++way) {
        free(y[way]);
        free(status[way]);
    }
    free(x);
    free(p);
    return wrong;
}

int main(void)
{
    static const casadi_int counts[] = {1, 2, 7, 8, 9, 16, 23, 64, 65};
    int k, way, wrong = 0;
    for (k = 0; k < (int)(sizeof counts / sizeof *counts); ++k)
        for (way = 0; way < 8; ++way)
            wrong += try(counts[k], way & 1, way & 2 ? 3 : 0, (way & 4) != 0);
    printf("%d\n", wrong);
    return wrong != 0;
}

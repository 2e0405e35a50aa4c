/* Call every kernel that PROBED lists at pseudo-random states, leaving out each of its results in turn.
 *
 * Memory has exactly the size of the patterns, so that sanitizers find reads and writes beyond. Results hold a poison
 * before each call: with status 0 all of it must be gone, else nothing. Results left out, and the inputs, must not
 * change. Prints "<kernel> <calls> <calls that failed>" for each kernel, or a fault.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include MODEL_HEADER
#include "mbs_check.h"

#define STATES 10
#define POISON 0xA5

#define MBS_PROBE(name, f) MBS_FACE(name, f),
static const mbs_face faces[] = {PROBED(MBS_PROBE)};

static size_t count(const casadi_int *pattern)
{
    return (size_t)(pattern[2] == 1 ? pattern[0] * pattern[1] : pattern[2 + pattern[1]]);
}

static casadi_real *allocate(size_t size)
{
    casadi_real *memory = malloc(size * sizeof *memory + !size);
    if (!memory)
        exit(2);
    return memory;
}

static casadi_real draw(void)
{
    static unsigned long x = 1;
    x = (x * 1664525UL + 1013904223UL) & 0xFFFFFFFFUL;
    return (casadi_real)((double)(x >> 8) / 8388608.0 - 1.0);
}

static void fill(const char *name, casadi_real *values, size_t size)
{
    size_t k;
    for (k = 0; k < size; ++k)
        values[k] = draw();
#ifdef PARAMETERS
    if (!strcmp(name, "p") || !strcmp(name, "h")) {
        mbs_real p[PARAMETERS];
        DEFAULTS(p);
        if (*name == 'p')
            memcpy(values, p, sizeof p);
        else if (SETUP(p, values))
            exit(3);
    }
#else
    (void)name;
#endif
}

static int is_poison(const casadi_real *value)
{
    const unsigned char *bytes = (const unsigned char *)value;
    size_t k;
    for (k = 0; k < sizeof *value; ++k)
        if (bytes[k] != POISON)
            return 0;
    return 1;
}

/* Call f with all results but one (none, if there is no such one); return its status, or -1 for a fault. */
static int probe(const mbs_face *f, casadi_int unwanted)
{
    const casadi_int n_in = f->n_in(), n_out = f->n_out();
    const casadi_real *arg[64];
    casadi_real *res[512], *given[64], *before[64];
    casadi_int i;
    size_t k;
    int status, is_fault = 0;
    for (i = 0; i < n_in; ++i) {
        const size_t size = count(f->sparsity_in(i));
        given[i] = allocate(size);
        before[i] = allocate(size);
        fill(f->name_in(i), given[i], size);
        memcpy(before[i], given[i], size * sizeof **given);
        arg[i] = given[i];
    }
    for (i = 0; i < n_out; ++i) {
        const size_t size = count(f->sparsity_out(i));
        res[i] = i == unwanted ? 0 : allocate(size);
        if (res[i])
            memset(res[i], POISON, size * sizeof **res);
    }
    status = f->call(arg, res, 0, 0, 0);
    for (i = 0; i < n_out; ++i) {
        for (k = 0; res[i] && k < count(f->sparsity_out(i)); ++k)
            is_fault |= is_poison(&res[i][k]) != (status != 0);
        free(res[i]);
    }
    for (i = 0; i < n_in; ++i) {
        is_fault |= memcmp(given[i], before[i], count(f->sparsity_in(i)) * sizeof **given) != 0;
        free(given[i]);
        free(before[i]);
    }
    return is_fault ? -1 : status;
}

int main(void)
{
    size_t k;
    for (k = 0; k < sizeof faces / sizeof *faces; ++k) {
        casadi_int unwanted;
        int state, calls = 0, failed = 0;
        for (state = 0; state < STATES; ++state)
            for (unwanted = -1; unwanted < (state ? 0 : faces[k].n_out()); ++unwanted) {
                const int status = probe(&faces[k], unwanted);
                if (status < 0) {
                    printf("%s: written or left what should not be\n", faces[k].name);
                    return 1;
                }
                ++calls;
                failed += status != 0;
            }
        printf("%s %d %d\n", faces[k].name, calls, failed);
    }
    return 0;
}

/* A stack of cases: rows into the solver's memory, a solve, and its point back. */
#define _POSIX_C_SOURCE 199309L

#include "mbs_cases.h"

#include <string.h>
#include <time.h>

typedef mbs_stages_real real;

static double read(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void take(real *to, const real *rows, int i, int n)
{
    memcpy(to, rows + (size_t)i * (size_t)n, (size_t)n * sizeof *to);
}

static void put(real *rows, const real *from, int i, int n)
{
    memcpy(rows + (size_t)i * (size_t)n, from, (size_t)n * sizeof *from);
}

static void take_numbers(const mbs_cases_worker *w, const mbs_cases_stack *s, int i)
{
    take(w->parameters, s->parameters, i, w->given);
    take(w->lower, s->lower, i, w->variables);
    take(w->upper, s->upper, i, w->variables);
    take(w->least, s->least, i, w->rows);
    take(w->most, s->most, i, w->rows);
    take(w->scale, s->scale, i, w->variables);
}

static void take_point(const mbs_stages_point *p, const mbs_cases_stack *s, int i)
{
    take(p->w, s->w, i, p->variables);
    take(p->below, s->below, i, p->variables);
    take(p->above, s->above, i, p->variables);
    take(p->y, s->y, i, p->rows);
}

static void put_point(const mbs_stages_point *p, const mbs_cases_stack *s, int i)
{
    put(s->w, p->w, i, p->variables);
    put(s->below, p->below, i, p->variables);
    put(s->above, p->above, i, p->variables);
    put(s->y, p->y, i, p->rows);
}

void mbs_cases_solve(const mbs_cases_worker *worker, const mbs_cases_stack *stack, int from, int to)
{
    const mbs_stages_point point = mbs_stages_iterate(worker->solver);
    int i;
    for (i = from; i < to; ++i) {
        mbs_stages_options options = *worker->options;
        const double begin = read(CLOCK_MONOTONIC), own = read(CLOCK_THREAD_CPUTIME_ID);
        mbs_stages_result result;
        take_numbers(worker, stack, i);
        take_point(&point, stack, i);
        if (stack->most_iterations[i] > 0 && stack->most_iterations[i] < options.max_iter)
            options.max_iter = stack->most_iterations[i];
        worker->timed->seconds = 0;
        result = mbs_stages_solve(worker->solver, &options);
        put_point(&point, stack, i);
        stack->status[i] = (int)result.status;
        stack->iterations[i] = result.iterations;
        stack->evaluating[i] = worker->timed->seconds;
        stack->seconds[i] = read(CLOCK_MONOTONIC) - begin;
        stack->cpu_seconds[i] = read(CLOCK_THREAD_CPUTIME_ID) - own;
    }
}

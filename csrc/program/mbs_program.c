#include "mbs_program.h"

#include <string.h>

typedef mbs_stages_real real;

#define ALIGNMENT 16

static size_t round_up(size_t bytes)
{
    return (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

static int largest_vector(const mbs_program *program)
{
    int i, size = 0;
    for (i = 0; i < program->kinds; ++i) {
        const mbs_program_kind *kind = &program->kind[i];
        const int sizes[] = {kind->values.size, kind->jacobians.size, kind->hessian.size};
        size_t j;
        for (j = 0; j < sizeof sizes / sizeof *sizes; ++j)
            size = sizes[j] > size ? sizes[j] : size;
    }
    return size;
}

size_t mbs_program_bytes(const mbs_program *program)
{
    return round_up(sizeof(mbs_program_instance)) + round_up((size_t)largest_vector(program) * sizeof(real)) +
           round_up((size_t)program->reals * sizeof(real)) +
           round_up((size_t)program->integers * sizeof(long long int)) +
           round_up((size_t)program->arguments * sizeof(const real *)) +
           round_up((size_t)program->results * sizeof(real *));
}

static void *take(char **free, size_t bytes)
{
    char *taken = *free;
    *free += round_up(bytes);
    return taken;
}

mbs_program_instance *mbs_program_create(const mbs_program *program, void *memory)
{
    char *free = memory;
    mbs_program_instance *p = take(&free, sizeof *p);
    p->program = program;
    p->parameters = p->numbers = NULL;
    p->lanes = NULL;
    p->W = take(&free, (size_t)largest_vector(program) * sizeof(real));
    p->reals = take(&free, (size_t)program->reals * sizeof(real));
    p->integers = take(&free, (size_t)program->integers * sizeof(long long int));
    p->arguments = take(&free, (size_t)program->arguments * sizeof(const real *));
    p->results = take(&free, (size_t)program->results * sizeof(real *));
    return p;
}

static void add_terms(const mbs_program_terms *terms, real *W)
{
    const int *to = terms->to, *from = terms->from, *by = terms->by;
    const real *coefficient = terms->coefficient;
    int i;
    if (by == NULL)
        for (i = 0; i < terms->count; ++i)
            W[to[i]] += coefficient[i] * W[from[i]];
    else
        for (i = 0; i < terms->count; ++i)
            W[to[i]] += coefficient[i] * W[from[i]] * W[by[i]];
}

static int call(const mbs_program_instance *p, const mbs_program_call *call)
{
    real *W = p->W;
    int i;
    for (i = 0; i < call->arguments; ++i)
        p->arguments[i] = call->argument[i] < 0 ? NULL : W + call->argument[i];
    for (i = 0; i < call->results; ++i)
        p->results[i] = call->result[i] < 0 ? NULL : W + call->result[i];
    return p->program->functions[call->function](p->arguments, p->results, p->integers, p->reals, 0);
}

#ifdef MBS_PROGRAM_LANES
/* Count the calls from this step on that can be made at once. */
static int count_abreast(const mbs_program_lanes *lanes, const mbs_program_step *step, int steps)
{
    int count = 1;
    if (lanes == NULL || lanes->function[step->call->function].function == NULL)
        return 1;
    while (count < lanes->lanes && count < steps && step[count].terms.count == 0 && step[count].call != NULL &&
           step[count].call->function == step->call->function)
        ++count;
    return count;
}

/* Put the numbers of several calls side by side; the last call fills the lanes that are left. */
static void gather(const real *W, int lanes, const mbs_program_step *step, int count, int argument, int size, real *to)
{
    int s, i;
    for (s = 0; s < lanes; ++s) {
        const real *from = W + step[s < count ? s : count - 1].call->argument[argument];
        for (i = 0; i < size; ++i)
            to[i * lanes + s] = from[i];
    }
}

/* Make calls of one function at once. Returns anything but 0 where one of them has no result. */
static int call_abreast(const mbs_program_instance *p, const mbs_program_step *step, int count)
{
    const mbs_program_call *first = step->call;
    const mbs_program_lanes *lanes = p->lanes;
    const mbs_program_abreast *f = &lanes->function[first->function];
    real *free = lanes->room;
    int i, s, k;
    for (i = 0; i < first->arguments; free += lanes->lanes * f->argument[i++]) {
        p->arguments[i] = first->argument[i] < 0 ? NULL : free;
        if (first->argument[i] >= 0)
            gather(p->W, lanes->lanes, step, count, i, f->argument[i], free);
    }
    for (i = 0; i < first->results; free += lanes->lanes * f->result[i++])
        p->results[i] = first->result[i] < 0 ? NULL : free;
    if (f->function(p->arguments, p->results, p->integers, p->reals, 0))
        return -1;
    for (i = 0; i < first->results; ++i)
        for (s = 0; s < count && p->results[i] != NULL; ++s) {
            real *to = p->W + step[s].call->result[i];
            for (k = 0; k < f->result[i]; ++k)
                to[k] = p->results[i][k * lanes->lanes + s];
        }
    return 0;
}
#endif

/* Make the call of a step, with those after it that can be made at once. Returns how many, or 0 where one has no result. */
static int make_calls(const mbs_program_instance *p, const mbs_program_step *step, int steps)
{
#ifdef MBS_PROGRAM_LANES
    const int count = count_abreast(p->lanes, step, steps);
    if (count > 1 && call_abreast(p, step, count) == 0)
        return count;
#else
    (void)steps;
#endif
    return call(p, step->call) ? 0 : 1;
}

static real *append(real *end, const real *numbers, int count)
{
    if (count > 0)
        memcpy(end, numbers, (size_t)count * sizeof(real));
    return end + count;
}

/* Begin W with the numbers that every script is given; return where they end. */
static real *begin(const mbs_program_instance *p, int k, const real *x, const real *v)
{
    const mbs_program *program = p->program;
    const mbs_stages_size *size = &program->kind[program->kind_of_stage[k]].size;
    real *end = append(append(p->W, x, size->nx), v, size->nv);
    end = append(end, p->parameters, program->parameters);
    return program->numbers > 0
               ? append(end, p->numbers + (size_t)k * (size_t)program->numbers, program->numbers)
               : end;
}

static int run(const mbs_program_instance *p, const mbs_program_script *script, real *end)
{
    int i, made = 0;
    append(end, script->start, script->constants);
    for (i = 0; i < script->steps; ++i) {
        const mbs_program_step *step = &script->step[i];
        add_terms(&step->terms, p->W);
        if (step->call == NULL)
            continue;
        if (made == 0 && (made = make_calls(p, step, script->steps - i)) == 0)
            return -1;
        --made;
    }
    return 0;
}

/* Return the rows of d of stage k: the states of the next stage. */
static int count_next(const mbs_program *program, int k)
{
    return k + 1 < program->stages ? program->kind[program->kind_of_stage[k + 1]].size.nx : 0;
}

int mbs_program_values(void *instance, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    const mbs_program_instance *p = instance;
    const mbs_program_kind *kind = &p->program->kind[p->program->kind_of_stage[k]];
    const int *result = kind->values.result;
    if (run(p, &kind->values, begin(p, k, x, v)))
        return -1;
    *f = p->W[result[0]];
    append(e, p->W + result[1], kind->size.ne);
    append(d, p->W + result[2], count_next(p->program, k));
    append(g, p->W + result[3], kind->size.ng);
    return 0;
}

int mbs_program_jacobians(void *instance, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    const mbs_program_instance *p = instance;
    const mbs_program_kind *kind = &p->program->kind[p->program->kind_of_stage[k]];
    const mbs_stages_size *size = &kind->size;
    const int n = size->nx + size->nv, *result = kind->jacobians.result;
    if (run(p, &kind->jacobians, begin(p, k, x, v)))
        return -1;
    append(df, p->W + result[0], n);
    append(de, p->W + result[1], size->patterns->de.column[n]);
    append(dd, p->W + result[2], size->patterns->dd.column[n]);
    append(dg, p->W + result[3], size->patterns->dg.column[n]);
    return 0;
}

int mbs_program_hessian(void *instance, int k, const real *x, const real *v, real factor, const real *ye,
                        const real *yd, const real *yg, real *h)
{
    const mbs_program_instance *p = instance;
    const mbs_program_kind *kind = &p->program->kind[p->program->kind_of_stage[k]];
    const mbs_stages_size *size = &kind->size;
    real *end = append(begin(p, k, x, v), &factor, 1);
    end = append(append(end, ye, size->ne), yd, count_next(p->program, k));
    if (run(p, &kind->hessian, append(end, yg, size->ng)))
        return -1;
    append(h, p->W + kind->hessian.result[0], size->patterns->h.column[size->nx + size->nv]);
    return 0;
}

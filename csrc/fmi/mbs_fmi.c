/* FMI 3.0 for a mechanism: model exchange, and co-simulation by the classical Runge-Kutta method.
 *
 * States are coordinates and velocities. Value references count the time, states, their derivatives, inputs, outputs,
 * parameters, and the longest step of co-simulation. Derivatives by states and inputs come from generated functions. */
#include "mbs_fmi.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MODEL mbs_fmi_model
#define STATES ((fmi3ValueReference)(MODEL.coordinates + MODEL.velocities))
#define FIRST_STATE ((fmi3ValueReference)1)
#define FIRST_DERIVATIVE (FIRST_STATE + STATES)
#define FIRST_INPUT (FIRST_DERIVATIVE + STATES)
#define FIRST_OUTPUT (FIRST_INPUT + (fmi3ValueReference)MODEL.inputs)
#define FIRST_PARAMETER (FIRST_OUTPUT + (fmi3ValueReference)MODEL.outputs)
#define STEP (FIRST_PARAMETER + (fmi3ValueReference)MODEL.parameters)

typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    double time, step;
    int is_set_up, is_known; /* whether set-up, and rates, accelerations and outputs, belong to the present numbers */
    casadi_real *numbers, *work; /* work: four rates of the states, and the states before a step */
} component;

/* --- numbers --- */

static fmi3Status fail(const component *c, const char *message)
{
    if (c->log)
        c->log(c->environment, fmi3Error, "logStatusError", message);
    return fmi3Error;
}

static int call(component *c, const mbs_fmi_call *f)
{
    enum { MOST = 16 };
    const casadi_real *argument[MOST];
    casadi_real *result[MOST];
    int i;
    for (i = 0; i < f->arguments; ++i)
        argument[i] = c->numbers + f->argument[i];
    for (i = 0; i < f->results; ++i)
        result[i] = c->numbers + f->result[i];
    return f->function ? f->function(argument, result, NULL, NULL, 0) : 0;
}

static int set_up(component *c)
{
    if (!c->is_set_up && call(c, &MODEL.setup))
        return 1;
    c->is_set_up = 1;
    return 0;
}

static fmi3Status evaluate(component *c)
{
    char text[120];
    int k, status;
    casadi_real *rates = c->numbers + MODEL.results;
    if (c->is_known)
        return fmi3OK;
    if (set_up(c))
        return fail(c, "the parameters admit no mechanism");
    for (k = 0; !MODEL.rates.function && k < MODEL.coordinates; ++k)
        rates[k] = c->numbers[MODEL.coordinates + k];
    if (call(c, &MODEL.rates) || call(c, &MODEL.places))
        return fail(c, "rates or outputs cannot be computed");
    status = call(c, &MODEL.accelerations);
    if (status) {
        snprintf(text, sizeof text, "the accelerations cannot be computed at joint %d, at time %.9g", status, c->time);
        return fail(c, text);
    }
    c->is_known = 1;
    return fmi3OK;
}

static void change(component *c)
{
    c->is_known = 0;
}

/* Return the number of a value reference, or NULL. */
static casadi_real *find(component *c, fmi3ValueReference r)
{
    if (r >= FIRST_STATE && r < FIRST_DERIVATIVE)
        return c->numbers + (r - FIRST_STATE);
    if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT)
        return c->numbers + MODEL.results + (r - FIRST_DERIVATIVE);
    if (r >= FIRST_INPUT && r < FIRST_OUTPUT)
        return c->numbers + STATES + (r - FIRST_INPUT);
    if (r >= FIRST_OUTPUT && r < FIRST_PARAMETER)
        return c->numbers + MODEL.results + STATES + (r - FIRST_OUTPUT);
    if (r >= FIRST_PARAMETER && r < STEP)
        return c->numbers + MODEL.parameter + (r - FIRST_PARAMETER);
    return NULL;
}

static int is_computed(fmi3ValueReference r)
{
    return (r >= FIRST_DERIVATIVE && r < FIRST_INPUT) || (r >= FIRST_OUTPUT && r < FIRST_PARAMETER);
}

FMI3_API fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                   fmi3Float64 values[], size_t size)
{
    component *c = instance;
    size_t k;
    if (size != count)
        return fail(c, "as many values as value references are needed");
    for (k = 0; k < count; ++k) {
        const casadi_real *place = find(c, references[k]);
        if (is_computed(references[k]) && evaluate(c) != fmi3OK)
            return fmi3Error;
        if (references[k] == 0)
            values[k] = c->time;
        else if (references[k] == STEP)
            values[k] = c->step;
        else if (place)
            values[k] = (double)*place;
        else
            return fail(c, "there is no variable of this value reference");
    }
    return fmi3OK;
}

FMI3_API fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                   const fmi3Float64 values[], size_t size)
{
    component *c = instance;
    size_t k;
    if (size != count)
        return fail(c, "as many values as value references are needed");
    for (k = 0; k < count; ++k) {
        casadi_real *place = find(c, references[k]);
        if (!(values[k] - values[k] == 0))
            return fail(c, "a value is not finite");
        if (references[k] == STEP && values[k] > 0) {
            c->step = values[k];
            continue;
        }
        if (!place || is_computed(references[k]))
            return fail(c, "the variable of this value reference cannot be set");
        *place = (casadi_real)values[k];
        if (references[k] >= FIRST_PARAMETER)
            c->is_set_up = 0;
    }
    change(c);
    return fmi3OK;
}

/* --- derivatives --- */

static int find_unknown(fmi3ValueReference r)
{
    if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT)
        return (int)(r - FIRST_DERIVATIVE);
    return r >= FIRST_OUTPUT && r < FIRST_PARAMETER ? (int)(STATES + r - FIRST_OUTPUT) : -1;
}

static int find_known(fmi3ValueReference r)
{
    if (r >= FIRST_STATE && r < FIRST_DERIVATIVE)
        return (int)(r - FIRST_STATE);
    return r >= FIRST_INPUT && r < FIRST_OUTPUT ? (int)(STATES + r - FIRST_INPUT) : -1;
}

static fmi3Status slope(component *c)
{
    int k;
    if (set_up(c))
        return fail(c, "the parameters admit no mechanism");
    for (k = 0; k < MODEL.slopes; ++k)
        if (call(c, &MODEL.slope[k]))
            return fail(c, "the derivatives cannot be computed");
    return fmi3OK;
}

/* Add one derivative, of unknown i by known j, to what it is a part of. */
static void add(double value, size_t i, size_t j, const fmi3Float64 seed[], fmi3Float64 found[], int is_adjoint)
{
    found[is_adjoint ? j : i] += value * seed[is_adjoint ? i : j];
}

/* Add the derivatives of unknown i: of a state, which is an output too, by itself; else its row. */
static void add_row(const component *c, const fmi3ValueReference unknowns[], size_t i,
                    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[],
                    fmi3Float64 found[], int is_adjoint)
{
    const int row = find_unknown(unknowns[i]);
    size_t j;
    int k;
    for (j = 0; j < n_knowns; ++j)
        if (row < 0 && knowns[j] == unknowns[i])
            add(1, i, j, seed, found, is_adjoint);
    for (k = 0; k < MODEL.nonzeros; ++k)
        for (j = 0; MODEL.row[k] == row && j < n_knowns; ++j)
            if (MODEL.column[k] == find_known(knowns[j]))
                add(MODEL.place[k] < 0 ? 1 : (double)c->numbers[MODEL.place[k]], i, j, seed, found, is_adjoint);
}

static fmi3Status differentiate(component *c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[],
                                fmi3Float64 found[], int is_adjoint)
{
    size_t i, j;
    for (i = 0; i < n_unknowns; ++i)
        if (find_unknown(unknowns[i]) < 0 && find_known(unknowns[i]) < 0)
            return fail(c, "derivatives are known of state derivatives and outputs");
    for (j = 0; j < n_knowns; ++j)
        if (find_known(knowns[j]) < 0)
            return fail(c, "derivatives are known by states and inputs");
    if (slope(c) != fmi3OK)
        return fmi3Error;
    for (i = 0; i < (is_adjoint ? n_knowns : n_unknowns); ++i)
        found[i] = 0;
    for (i = 0; i < n_unknowns; ++i)
        add_row(c, unknowns, i, knowns, n_knowns, seed, found, is_adjoint);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                                 size_t n_unknowns, const fmi3ValueReference knowns[], size_t n_knowns,
                                                 const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[],
                                                 size_t n_sensitivity)
{
    if (n_seed != n_knowns || n_sensitivity != n_unknowns)
        return fail(instance, "a seed for each known and a result for each unknown are needed");
    return differentiate(instance, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity, 0);
}

FMI3_API fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                             size_t n_unknowns, const fmi3ValueReference knowns[], size_t n_knowns,
                                             const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[],
                                             size_t n_sensitivity)
{
    if (n_seed != n_unknowns || n_sensitivity != n_knowns)
        return fail(instance, "a seed for each unknown and a result for each known are needed");
    return differentiate(instance, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity, 1);
}

/* --- instances --- */

FMI3_API const char *fmi3GetVersion(void)
{
    return "3.0";
}

static void begin(component *c)
{
    memset(c->numbers, 0, (size_t)MODEL.size * sizeof *c->numbers);
    memcpy(c->numbers, MODEL.start, (size_t)MODEL.given * sizeof *c->numbers);
    c->time = 0;
    c->step = (double)MODEL.step;
    c->is_set_up = c->is_known = 0;
}

static fmi3Instance instantiate(fmi3String token, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    component *c = calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->environment = environment;
    c->log = log;
    if (!token || strcmp(token, MODEL.token)) {
        fail(c, "the instantiation token is not this model's");
        free(c);
        return NULL;
    }
    c->numbers = malloc((size_t)MODEL.size * sizeof *c->numbers);
    c->work = malloc(5 * (size_t)STATES * sizeof *c->work);
    if (!c->numbers || !c->work) {
        free(c->numbers);
        free(c->work);
        free(c);
        return NULL;
    }
    begin(c);
    return c;
}

FMI3_API fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                   fmi3Boolean visible, fmi3Boolean logging,
                                                   fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    return instantiate(token, environment, log);
}

FMI3_API fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                  fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                  fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                                  size_t count, fmi3InstanceEnvironment environment,
                                                  fmi3LogMessageCallback log, void *update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)count, (void)update;
    return instantiate(token, environment, log);
}

FMI3_API fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                        fmi3Boolean visible, fmi3Boolean logging,
                                                        fmi3InstanceEnvironment environment,
                                                        fmi3LogMessageCallback log, void *update, void *lock,
                                                        void *unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

FMI3_API void fmi3FreeInstance(fmi3Instance instance)
{
    component *c = instance;
    if (!c)
        return;
    free(c->numbers);
    free(c->work);
    free(c);
}

FMI3_API fmi3Status fmi3Reset(fmi3Instance instance)
{
    begin(instance);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance,
                                                fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop,
                                                fmi3Float64 stop)
{
    component *c = instance;
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    c->time = start;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return evaluate(instance);
}

/* --- model exchange --- */

FMI3_API fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    ((component *)instance)->time = time;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 states[], size_t count)
{
    component *c = instance;
    size_t k;
    for (k = 0; k < count && k < STATES; ++k)
        states[k] = (double)c->numbers[k];
    return count == STATES ? fmi3OK : fail(c, "the number of states is another");
}

FMI3_API fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 states[], size_t count)
{
    component *c = instance;
    size_t k;
    for (k = 0; k < count && k < STATES; ++k)
        c->numbers[k] = (casadi_real)states[k];
    change(c);
    return count == STATES ? fmi3OK : fail(c, "the number of states is another");
}

FMI3_API fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t count)
{
    component *c = instance;
    size_t k;
    if (count != STATES)
        return fail(c, "the number of states is another");
    if (evaluate(c) != fmi3OK)
        return fmi3Error;
    for (k = 0; k < count; ++k)
        derivatives[k] = (double)c->numbers[(size_t)MODEL.results + k];
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t count)
{
    size_t k;
    (void)instance;
    for (k = 0; k < count; ++k)
        nominals[k] = 1;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count)
{
    (void)instance;
    *count = STATES;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count)
{
    (void)instance;
    *count = 0;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t count)
{
    (void)indicators;
    return count == 0 ? fmi3OK : fail(instance, "there are no event indicators");
}

FMI3_API fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_set, fmi3Boolean *enter,
                                                fmi3Boolean *terminate)
{
    (void)instance, (void)no_set;
    *enter = false;
    *terminate = false;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *update, fmi3Boolean *terminate,
                                             fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *has_time,
                                             fmi3Float64 *next)
{
    (void)instance;
    *update = *terminate = *nominals = *values = *has_time = false;
    *next = 0;
    return fmi3OK;
}

/* --- co-simulation --- */

static fmi3Status advance(component *c, double h)
{
    static const double when[] = {0, 0.5, 0.5, 1}, weight[] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const size_t n = STATES;
    casadi_real *before = c->work + 4 * n;
    size_t i, k;
    memcpy(before, c->numbers, n * sizeof *before);
    for (i = 0; i < 4; ++i) {
        for (k = 0; k < n; ++k)
            c->numbers[k] = before[k] + (casadi_real)(h * when[i]) * (i ? c->work[(i - 1) * n + k] : 0);
        change(c);
        if (evaluate(c) != fmi3OK) {
            memcpy(c->numbers, before, n * sizeof *before);
            change(c);
            return fmi3Error;
        }
        memcpy(c->work + i * n, c->numbers + MODEL.results, n * sizeof *before);
    }
    for (k = 0; k < n; ++k) {
        casadi_real sum = 0;
        for (i = 0; i < 4; ++i)
            sum += (casadi_real)weight[i] * c->work[i * n + k];
        c->numbers[k] = before[k] + (casadi_real)h * sum;
        if (!(c->numbers[k] - c->numbers[k] == 0)) {
            memcpy(c->numbers, before, n * sizeof *before);
            change(c);
            return fail(c, "the motion runs away");
        }
    }
    change(c);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set,
                               fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    component *c = instance;
    const double steps = size / c->step;
    long count, k;
    (void)no_set;
    *event = *terminate = *early = false;
    *last = c->time = time;
    if (!(size >= 0) || !(steps < 1e9))
        return fail(c, "the communication step has no use, or holds too many steps");
    count = (long)(steps * (1 - 1e-12)) + (size > 0);
    for (k = 0; k < count; ++k) {
        if (advance(c, size / (double)count) != fmi3OK)
            return fmi3Error;
        c->time = time + size * (double)(k + 1) / (double)count;
        *last = c->time;
    }
    return evaluate(c);
}

/* --- the state of an instance --- */

static size_t count_bytes(void)
{
    return 2 * sizeof(double) + (size_t)MODEL.size * sizeof(casadi_real);
}

static void save(const component *c, unsigned char *bytes)
{
    const double two[] = {c->time, c->step};
    memcpy(bytes, two, sizeof two);
    memcpy(bytes + sizeof two, c->numbers, (size_t)MODEL.size * sizeof *c->numbers);
}

static void restore(component *c, const unsigned char *bytes)
{
    double two[2];
    memcpy(two, bytes, sizeof two);
    memcpy(c->numbers, bytes + sizeof two, (size_t)MODEL.size * sizeof *c->numbers);
    c->time = two[0];
    c->step = two[1];
    c->is_set_up = c->is_known = 0;
}

FMI3_API fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    if (!*state)
        *state = malloc(count_bytes());
    if (!*state)
        return fail(instance, "there is no memory for a state");
    save(instance, *state);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    restore(instance, state);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FMI3_API fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance, (void)state;
    *size = count_bytes();
    return fmi3OK;
}

FMI3_API fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, uint8_t bytes[], size_t size)
{
    if (size != count_bytes())
        return fail(instance, "the size of the state is another");
    memcpy(bytes, state, size);
    return fmi3OK;
}

FMI3_API fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const uint8_t bytes[], size_t size,
                                            fmi3FMUState *state)
{
    if (size != count_bytes())
        return fail(instance, "the size of the state is another");
    if (!*state)
        *state = malloc(size);
    if (!*state)
        return fail(instance, "there is no memory for a state");
    memcpy(*state, bytes, size);
    return fmi3OK;
}

/* --- the rest of the interface --- */

/* Functions that have nothing to do. */
#define NOTHING(name, ...)                                                                                             \
    FMI3_API fmi3Status name(__VA_ARGS__)                                                                              \
    {                                                                                                                  \
        (void)instance;                                                                                                \
        return fmi3OK;                                                                                                 \
    }
NOTHING(fmi3EnterEventMode, fmi3Instance instance)
NOTHING(fmi3EnterContinuousTimeMode, fmi3Instance instance)
NOTHING(fmi3EnterStepMode, fmi3Instance instance)
NOTHING(fmi3EnterConfigurationMode, fmi3Instance instance)
NOTHING(fmi3ExitConfigurationMode, fmi3Instance instance)
NOTHING(fmi3EvaluateDiscreteStates, fmi3Instance instance)
NOTHING(fmi3Terminate, fmi3Instance instance)

FMI3_API fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count,
                                        const fmi3String categories[])
{
    (void)instance, (void)on, (void)count, (void)categories;
    return fmi3OK;
}

/* Variables of other types do not exist. */
#define NONE(name, type)                                                                                               \
    FMI3_API fmi3Status fmi3Get##name(fmi3Instance instance, const fmi3ValueReference references[], size_t count,      \
                                      type values[], size_t size)                                                      \
    {                                                                                                                  \
        (void)references, (void)values, (void)size;                                                                    \
        return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");                          \
    }                                                                                                                  \
    FMI3_API fmi3Status fmi3Set##name(fmi3Instance instance, const fmi3ValueReference references[], size_t count,      \
                                      const type values[], size_t size)                                                \
    {                                                                                                                  \
        (void)references, (void)values, (void)size;                                                                    \
        return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");                          \
    }
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(Int32, int32_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, fmi3Boolean)
NONE(String, fmi3String)

FMI3_API fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                  size_t sizes[], const uint8_t *values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");
}

FMI3_API fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                  const size_t sizes[], const uint8_t *const values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");
}

/* Clocks, dependencies that change, and derivatives of outputs by time do not exist. */
#define MISSING(name, ...)                                                                                             \
    FMI3_API fmi3Status name(__VA_ARGS__)                                                                              \
    {                                                                                                                  \
        return fail(instance, #name " is not supported: see the capabilities of the model");                           \
    }
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
MISSING(fmi3GetClock, fmi3Instance instance, const fmi3ValueReference r[], size_t n, bool v[])
MISSING(fmi3SetClock, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const bool v[])
MISSING(fmi3GetIntervalDecimal, fmi3Instance instance, const fmi3ValueReference r[], size_t n, double v[], int *q)
MISSING(fmi3GetIntervalFraction, fmi3Instance instance, const fmi3ValueReference r[], size_t n, uint64_t c[],
        uint64_t s[], int *q)
MISSING(fmi3GetShiftDecimal, fmi3Instance instance, const fmi3ValueReference r[], size_t n, double v[])
MISSING(fmi3GetShiftFraction, fmi3Instance instance, const fmi3ValueReference r[], size_t n, uint64_t c[], uint64_t s[])
MISSING(fmi3SetIntervalDecimal, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const double v[])
MISSING(fmi3SetIntervalFraction, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const uint64_t c[],
        const uint64_t s[])
MISSING(fmi3SetShiftDecimal, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const double v[])
MISSING(fmi3SetShiftFraction, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const uint64_t c[],
        const uint64_t s[])
MISSING(fmi3ActivateModelPartition, fmi3Instance instance, fmi3ValueReference clock, double time)
MISSING(fmi3GetOutputDerivatives, fmi3Instance instance, const fmi3ValueReference r[], size_t n, const int32_t o[],
        double v[], size_t size)
MISSING(fmi3GetNumberOfVariableDependencies, fmi3Instance instance, fmi3ValueReference r, size_t *n)
MISSING(fmi3GetVariableDependencies, fmi3Instance instance, fmi3ValueReference r, size_t e[],
        fmi3ValueReference i[], size_t ie[], fmi3DependencyKind k[], size_t n)
#pragma GCC diagnostic pop

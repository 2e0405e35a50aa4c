/* FMI 3.0 for a mechanism: model exchange, and co-simulation by the classical Runge-Kutta method. */
#include "mbs_fmi.h"

#include <stdbool.h>
#include <stdlib.h>

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef mbs_fmi_reference fmi3ValueReference;
typedef bool fmi3Boolean;
typedef double fmi3Float64;
typedef const char *fmi3String;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                                       fmi3String message);

typedef struct {
    mbs_fmi_instance core; /* first: the core reports with a pointer to it */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} component;

static void report(mbs_fmi_instance *core, const char *message)
{
    const component *c = (const component *)core;
    if (c->log)
        c->log(c->environment, fmi3Error, "logStatusError", message);
}

static fmi3Status end(int has_failed)
{
    return has_failed ? fmi3Error : fmi3OK;
}

static fmi3Status fail(fmi3Instance instance, const char *message)
{
    return end(mbs_fmi_fail(instance, message));
}

/* --- instances --- */

MBS_FMI_API const char *fmi3GetVersion(void)
{
    return "3.0";
}

static fmi3Instance instantiate(fmi3String token, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    component *c = calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->core.report = report;
    c->environment = environment;
    c->log = log;
    if (mbs_fmi_open(&c->core, token)) {
        free(c);
        return NULL;
    }
    return c;
}

MBS_FMI_API fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                   fmi3Boolean visible, fmi3Boolean logging,
                                                   fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    return instantiate(token, environment, log);
}

MBS_FMI_API fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                  fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                  fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                                  size_t count, fmi3InstanceEnvironment environment,
                                                  fmi3LogMessageCallback log, void *update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)count, (void)update;
    return instantiate(token, environment, log);
}

MBS_FMI_API fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                        fmi3Boolean visible, fmi3Boolean logging,
                                                        fmi3InstanceEnvironment environment,
                                                        fmi3LogMessageCallback log, void *update, void *lock,
                                                        void *unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

MBS_FMI_API void fmi3FreeInstance(fmi3Instance instance)
{
    if (instance)
        mbs_fmi_close(instance);
    free(instance);
}

MBS_FMI_API fmi3Status fmi3Reset(fmi3Instance instance)
{
    mbs_fmi_begin(instance);
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance,
                                                   fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop,
                                                   fmi3Float64 stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    mbs_fmi_set_time(instance, start);
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return end(mbs_fmi_initialise(instance));
}

/* --- variables and their derivatives --- */

MBS_FMI_API fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                      fmi3Float64 values[], size_t size)
{
    if (size != count)
        return fail(instance, "as many values as value references are needed");
    return end(mbs_fmi_get(instance, references, count, values));
}

MBS_FMI_API fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                      const fmi3Float64 values[], size_t size)
{
    if (size != count)
        return fail(instance, "as many values as value references are needed");
    return end(mbs_fmi_set(instance, references, count, values));
}

MBS_FMI_API fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                                    size_t n_unknowns, const fmi3ValueReference knowns[],
                                                    size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                                    fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    if (n_seed != n_knowns || n_sensitivity != n_unknowns)
        return fail(instance, "a seed for each known and a result for each unknown are needed");
    return end(mbs_fmi_differentiate(instance, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity, 0));
}

MBS_FMI_API fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                                size_t n_unknowns, const fmi3ValueReference knowns[], size_t n_knowns,
                                                const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[],
                                                size_t n_sensitivity)
{
    if (n_seed != n_unknowns || n_sensitivity != n_knowns)
        return fail(instance, "a seed for each unknown and a result for each known are needed");
    return end(mbs_fmi_differentiate(instance, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity, 1));
}

/* --- model exchange --- */

MBS_FMI_API fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    mbs_fmi_set_time(instance, time);
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 states[], size_t count)
{
    return end(mbs_fmi_get_states(instance, states, count));
}

MBS_FMI_API fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 states[], size_t count)
{
    return end(mbs_fmi_set_states(instance, states, count));
}

MBS_FMI_API fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                                         size_t count)
{
    return end(mbs_fmi_get_rates(instance, derivatives, count));
}

MBS_FMI_API fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t count)
{
    size_t k;
    (void)instance;
    for (k = 0; k < count; ++k)
        nominals[k] = 1;
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count)
{
    (void)instance;
    *count = mbs_fmi_count_states();
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count)
{
    (void)instance;
    *count = 0;
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t count)
{
    (void)indicators;
    return count == 0 ? fmi3OK : fail(instance, "there are no event indicators");
}

MBS_FMI_API fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_set, fmi3Boolean *enter,
                                                   fmi3Boolean *terminate)
{
    (void)no_set;
    *enter = mbs_fmi_has_drifted(instance);
    *terminate = false;
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *update, fmi3Boolean *terminate,
                                                fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *has_time,
                                                fmi3Float64 *next)
{
    *update = *terminate = *nominals = *has_time = false;
    *next = 0;
    *values = mbs_fmi_has_drifted(instance);
    return *values ? end(mbs_fmi_project(instance)) : fmi3OK;
}

/* --- co-simulation --- */

MBS_FMI_API fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set,
                                  fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    const int status = mbs_fmi_advance(instance, time, size);
    (void)no_set;
    *event = *terminate = *early = false;
    *last = ((mbs_fmi_instance *)instance)->time;
    return end(status);
}

/* --- the saved state of an instance --- */

MBS_FMI_API fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    return end(mbs_fmi_take(instance, state));
}

MBS_FMI_API fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    mbs_fmi_restore(instance, state);
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    mbs_fmi_drop(state);
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance, (void)state;
    *size = mbs_fmi_count_bytes();
    return fmi3OK;
}

MBS_FMI_API fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, uint8_t bytes[], size_t size)
{
    return end(mbs_fmi_write(instance, state, bytes, size));
}

MBS_FMI_API fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const uint8_t bytes[], size_t size,
                                               fmi3FMUState *state)
{
    return end(mbs_fmi_read(instance, bytes, size, state));
}

/* --- the rest of the interface --- */

/* Functions that have nothing to do. */
#define NOTHING(name, ...)                                                                                             \
    MBS_FMI_API fmi3Status name(__VA_ARGS__)                                                                              \
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

MBS_FMI_API fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count,
                                        const fmi3String categories[])
{
    (void)instance, (void)on, (void)count, (void)categories;
    return fmi3OK;
}

/* Variables of other types do not exist. */
#define NONE(name, type)                                                                                               \
    MBS_FMI_API fmi3Status fmi3Get##name(fmi3Instance instance, const fmi3ValueReference references[], size_t count,      \
                                      type values[], size_t size)                                                      \
    {                                                                                                                  \
        (void)references, (void)values, (void)size;                                                                    \
        return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");                          \
    }                                                                                                                  \
    MBS_FMI_API fmi3Status fmi3Set##name(fmi3Instance instance, const fmi3ValueReference references[], size_t count,      \
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

MBS_FMI_API fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                  size_t sizes[], const uint8_t *values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");
}

MBS_FMI_API fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                  const size_t sizes[], const uint8_t *const values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return count == 0 ? fmi3OK : fail(instance, "all variables are of the type Float64");
}

/* Clocks, dependencies that change, and derivatives of outputs by time do not exist. */
#define MISSING(name, ...)                                                                                             \
    MBS_FMI_API fmi3Status name(__VA_ARGS__)                                                                              \
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

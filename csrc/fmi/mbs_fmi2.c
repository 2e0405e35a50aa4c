/* FMI 2.0 for a mechanism: model exchange, and co-simulation by the classical Runge-Kutta method. */
#include "mbs_fmi.h"

#include <stdlib.h>
#include <string.h>

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef mbs_fmi_reference fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

typedef struct {
    mbs_fmi_instance core; /* first: the core reports with a pointer to it */
    const fmi2CallbackFunctions *functions;
    char *name;
} component;

static void report(mbs_fmi_instance *core, const char *message)
{
    const component *c = (const component *)core;
    if (c->functions && c->functions->logger)
        c->functions->logger(c->functions->componentEnvironment, c->name, fmi2Error, "logStatusError", "%s", message);
}

static fmi2Status end(int has_failed)
{
    return has_failed ? fmi2Error : fmi2OK;
}

static fmi2Status fail(fmi2Component instance, const char *message)
{
    return end(mbs_fmi_fail(instance, message));
}

/* --- instances --- */

MBS_FMI_API const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

MBS_FMI_API const char *fmi2GetVersion(void)
{
    return "2.0";
}

MBS_FMI_API void fmi2FreeInstance(fmi2Component instance)
{
    component *c = instance;
    if (!c)
        return;
    mbs_fmi_close(&c->core);
    free(c->name);
    free(c);
}

MBS_FMI_API fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                          const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                          fmi2Boolean logging)
{
    const char *const given = name ? name : "";
    component *c = calloc(1, sizeof *c);
    (void)type, (void)resources, (void)visible, (void)logging;
    if (!c)
        return NULL;
    c->core.report = report;
    c->functions = functions;
    c->name = malloc(strlen(given) + 1);
    if (c->name)
        strcpy(c->name, given);
    if (!c->name || mbs_fmi_open(&c->core, token)) {
        free(c->name);
        free(c);
        return NULL;
    }
    return c;
}

MBS_FMI_API fmi2Status fmi2Reset(fmi2Component instance)
{
    mbs_fmi_begin(instance);
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2SetupExperiment(fmi2Component instance, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    mbs_fmi_set_time(instance, start);
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2ExitInitializationMode(fmi2Component instance)
{
    return end(mbs_fmi_initialise(instance));
}

/* --- variables and their derivatives --- */

MBS_FMI_API fmi2Status fmi2GetReal(fmi2Component instance, const fmi2ValueReference references[], size_t count,
                                   fmi2Real values[])
{
    return end(mbs_fmi_get(instance, references, count, values));
}

MBS_FMI_API fmi2Status fmi2SetReal(fmi2Component instance, const fmi2ValueReference references[], size_t count,
                                   const fmi2Real values[])
{
    return end(mbs_fmi_set(instance, references, count, values));
}

MBS_FMI_API fmi2Status fmi2GetDirectionalDerivative(fmi2Component instance, const fmi2ValueReference unknowns[],
                                                    size_t n_unknowns, const fmi2ValueReference knowns[],
                                                    size_t n_knowns, const fmi2Real seed[], fmi2Real sensitivity[])
{
    return end(mbs_fmi_differentiate(instance, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity, 0));
}

/* --- model exchange --- */

MBS_FMI_API fmi2Status fmi2SetTime(fmi2Component instance, fmi2Real time)
{
    mbs_fmi_set_time(instance, time);
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2GetContinuousStates(fmi2Component instance, fmi2Real states[], size_t count)
{
    return end(mbs_fmi_get_states(instance, states, count));
}

MBS_FMI_API fmi2Status fmi2SetContinuousStates(fmi2Component instance, const fmi2Real states[], size_t count)
{
    return end(mbs_fmi_set_states(instance, states, count));
}

MBS_FMI_API fmi2Status fmi2GetDerivatives(fmi2Component instance, fmi2Real derivatives[], size_t count)
{
    return end(mbs_fmi_get_rates(instance, derivatives, count));
}

MBS_FMI_API fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component instance, fmi2Real nominals[], size_t count)
{
    size_t k;
    (void)instance;
    for (k = 0; k < count; ++k)
        nominals[k] = 1;
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2GetEventIndicators(fmi2Component instance, fmi2Real indicators[], size_t count)
{
    (void)indicators;
    return count == 0 ? fmi2OK : fail(instance, "there are no event indicators");
}

MBS_FMI_API fmi2Status fmi2CompletedIntegratorStep(fmi2Component instance, fmi2Boolean no_set, fmi2Boolean *enter,
                                                   fmi2Boolean *terminate)
{
    (void)no_set;
    *enter = mbs_fmi_has_drifted(instance);
    *terminate = 0;
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2NewDiscreteStates(fmi2Component instance, fmi2EventInfo *event)
{
    memset(event, 0, sizeof *event);
    event->valuesOfContinuousStatesChanged = mbs_fmi_has_drifted(instance);
    return event->valuesOfContinuousStatesChanged ? end(mbs_fmi_project(instance)) : fmi2OK;
}

/* --- co-simulation --- */

MBS_FMI_API fmi2Status fmi2DoStep(fmi2Component instance, fmi2Real time, fmi2Real size, fmi2Boolean no_set)
{
    (void)no_set;
    return end(mbs_fmi_advance(instance, time, size));
}

MBS_FMI_API fmi2Status fmi2GetRealStatus(fmi2Component instance, fmi2StatusKind kind, fmi2Real *value)
{
    *value = ((mbs_fmi_instance *)instance)->time;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}

/* --- the saved state of an instance --- */

MBS_FMI_API fmi2Status fmi2GetFMUstate(fmi2Component instance, fmi2FMUstate *state)
{
    return end(mbs_fmi_take(instance, state));
}

MBS_FMI_API fmi2Status fmi2SetFMUstate(fmi2Component instance, fmi2FMUstate state)
{
    mbs_fmi_restore(instance, state);
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2FreeFMUstate(fmi2Component instance, fmi2FMUstate *state)
{
    (void)instance;
    mbs_fmi_drop(state);
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2SerializedFMUstateSize(fmi2Component instance, fmi2FMUstate state, size_t *size)
{
    (void)instance, (void)state;
    *size = mbs_fmi_count_bytes();
    return fmi2OK;
}

MBS_FMI_API fmi2Status fmi2SerializeFMUstate(fmi2Component instance, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return end(mbs_fmi_write(instance, state, (unsigned char *)bytes, size));
}

MBS_FMI_API fmi2Status fmi2DeSerializeFMUstate(fmi2Component instance, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *state)
{
    return end(mbs_fmi_read(instance, (const unsigned char *)bytes, size, state));
}

/* --- the rest of the interface --- */

/* Functions that have nothing to do. */
#define NOTHING(name)                                                                                                  \
    MBS_FMI_API fmi2Status name(fmi2Component instance)                                                                \
    {                                                                                                                  \
        (void)instance;                                                                                                \
        return fmi2OK;                                                                                                 \
    }
NOTHING(fmi2EnterInitializationMode)
NOTHING(fmi2EnterEventMode)
NOTHING(fmi2EnterContinuousTimeMode)
NOTHING(fmi2Terminate)

MBS_FMI_API fmi2Status fmi2SetDebugLogging(fmi2Component instance, fmi2Boolean on, size_t count,
                                           const fmi2String categories[])
{
    (void)instance, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

/* Variables of other types do not exist. */
#define NONE(name, type)                                                                                               \
    MBS_FMI_API fmi2Status fmi2Get##name(fmi2Component instance, const fmi2ValueReference references[], size_t count,  \
                                         type values[])                                                                \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return count == 0 ? fmi2OK : fail(instance, "all variables are of the type Real");                             \
    }                                                                                                                  \
    MBS_FMI_API fmi2Status fmi2Set##name(fmi2Component instance, const fmi2ValueReference references[], size_t count,  \
                                         const type values[])                                                          \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return count == 0 ? fmi2OK : fail(instance, "all variables are of the type Real");                             \
    }
NONE(Integer, fmi2Integer)
NONE(Boolean, fmi2Boolean)
NONE(String, fmi2String)

/* Derivatives of inputs and outputs by time, and steps that run beside the caller, do not exist. */
#define MISSING(name, ...)                                                                                             \
    MBS_FMI_API fmi2Status name(__VA_ARGS__)                                                                           \
    {                                                                                                                  \
        return fail(instance, #name " is not supported: see the capabilities of the model");                           \
    }
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
MISSING(fmi2SetRealInputDerivatives, fmi2Component instance, const fmi2ValueReference r[], size_t n,
        const fmi2Integer o[], const fmi2Real v[])
MISSING(fmi2GetRealOutputDerivatives, fmi2Component instance, const fmi2ValueReference r[], size_t n,
        const fmi2Integer o[], fmi2Real v[])
MISSING(fmi2CancelStep, fmi2Component instance)
MISSING(fmi2GetStatus, fmi2Component instance, fmi2StatusKind kind, fmi2Status *value)
MISSING(fmi2GetIntegerStatus, fmi2Component instance, fmi2StatusKind kind, fmi2Integer *value)
MISSING(fmi2GetBooleanStatus, fmi2Component instance, fmi2StatusKind kind, fmi2Boolean *value)
MISSING(fmi2GetStringStatus, fmi2Component instance, fmi2StatusKind kind, fmi2String *value)
#pragma GCC diagnostic pop

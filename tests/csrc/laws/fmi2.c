/* FMI 2.0 of a unit: each function of the interface does what it says with the instance, and reports failures. */
#include "fmi.h"

#include "../../../csrc/fmi/mbs_fmi.c"
#include "../../../csrc/fmi/mbs_fmi2.c"

#undef malloc
#undef calloc

static char heard[300];
static int complaints;

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...)
{
    ++complaints;
    snprintf(heard, sizeof heard, "%s %s %d %s %s", (const char *)environment, name, status, category, message);
}

static fmi2CallbackFunctions functions = {hear, NULL, NULL, NULL, "here"};

static int hears(void)
{
    const int is_so = complaints == 1 && !strcmp(heard, "here unit 3 logStatusError %s");
    complaints = 0;
    return is_so;
}

static fmi2Component begin(const mbs_fmi_mechanism *model)
{
    present = model;
    last = widest = 1e9, setups = evaluations = complaints = 0;
    return fmi2Instantiate("unit", fmi2CoSimulation, model->token, "", &functions, 0, 0);
}

static void make_instances(void)
{
    fmi2Component c;
    present = &guided;
    LAW("the version", !strcmp(fmi2GetVersion(), "2.0") && !strcmp(fmi2GetTypesPlatform(), "default"));
    LAW("a token is checked", !fmi2Instantiate("unit", fmi2ModelExchange, "other", "", &functions, 0, 0) && hears());
    LAW("in silence too", !fmi2Instantiate(NULL, fmi2ModelExchange, "other", "", NULL, 0, 0));
    functions.logger = NULL;
    LAW("or without a logger", !fmi2Instantiate(NULL, fmi2ModelExchange, "other", "", &functions, 0, 0));
    functions.logger = hear;
    for (left = 0; left < 4; ++left) {
        const long before = left;
        LAW("memory may lack", !fmi2Instantiate("unit", fmi2ModelExchange, "guided", "", &functions, 0, 0));
        LAW("which an instance reports", complaints == (before > 1));
        complaints = 0, left = before;
    }
    left = -1;
    c = fmi2Instantiate(NULL, fmi2ModelExchange, "guided", "", NULL, 0, 0);
    LAW("no name is needed", c && !strcmp(((component *)c)->name, ""));
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
}

static void exchange(void)
{
    static const fmi2ValueReference all[] = {0, 1, 2, 3, 4}, knowns[] = {5, 1}, beyond[] = {99};
    fmi2Component c = begin(&guided);
    fmi2Boolean enter = 7, ends = 7;
    fmi2EventInfo event = {7, 7, 7, 7, 7, 7};
    double v[5], seed[2] = {1, 2}, states[2] = {4, 5};
    LAW("it starts at a time", fmi2SetupExperiment(c, 1, 1e-6, 2, 1, 9) == fmi2OK && fmi2EnterInitializationMode(c) == fmi2OK
        && fmi2ExitInitializationMode(c) == fmi2OK && evaluations == 1);
    LAW("values are read", fmi2GetReal(c, all, 5, v) == fmi2OK && v[0] == 2 && v[1] == 0.5 && v[2] == -1 && v[3] == -1
        && same(v[4], 14.25));
    LAW("not those that are not there", fmi2GetReal(c, beyond, 1, v) == fmi2Error && hears());
    v[0] = 0;
    LAW("inputs are set", fmi2SetReal(c, knowns, 1, v) == fmi2OK && fmi2GetReal(c, all + 4, 1, v) == fmi2OK && same(v[0], 11.25));
    LAW("rates are not", fmi2SetReal(c, all + 4, 1, v) == fmi2Error && hears());
    LAW("derivatives along a seed", fmi2GetDirectionalDerivative(c, all + 3, 2, knowns, 2, seed, v) == fmi2OK && v[0] == 0
        && same(v[1], 1 - 6));
    LAW("of unknowns", fmi2GetDirectionalDerivative(c, all, 1, knowns, 2, seed, v) == fmi2Error && hears());
    LAW("the time", fmi2SetTime(c, 3) == fmi2OK && fmi2GetDerivatives(c, v, 2) == fmi2OK && v[0] == -1 && same(v[1], 12.25));
    LAW("states", fmi2SetContinuousStates(c, states, 2) == fmi2OK && fmi2GetContinuousStates(c, v, 2) == fmi2OK
        && v[0] == 4 && v[1] == 5);
    LAW("of their number", fmi2SetContinuousStates(c, states, 1) == fmi2Error && fmi2GetContinuousStates(c, v, 1) == fmi2Error
        && fmi2GetDerivatives(c, v, 1) == fmi2Error && complaints == 3);
    complaints = 0, v[2] = 8;
    LAW("their size is of order one", fmi2GetNominalsOfContinuousStates(c, v, 2) == fmi2OK && v[0] == 1 && v[1] == 1 && v[2] == 8);
    LAW("nothing happens by itself", fmi2GetEventIndicators(c, v, 0) == fmi2OK && fmi2GetEventIndicators(c, v, 1) == fmi2Error
        && hears());
    LAW("open chains do not drift", fmi2CompletedIntegratorStep(c, 1, &enter, &ends) == fmi2OK && !enter && !ends);
    LAW("and need no event", fmi2NewDiscreteStates(c, &event) == fmi2OK && !event.valuesOfContinuousStatesChanged
        && !event.newDiscreteStatesNeeded && !event.terminateSimulation && !event.nominalsOfContinuousStatesChanged
        && !event.nextEventTimeDefined && event.nextEventTime == 0);
    LAW("the first values come back", fmi2Reset(c) == fmi2OK && fmi2GetReal(c, all, 3, v) == fmi2OK && v[0] == 0 && v[1] == 0.5);
    last = -1;
    LAW("a start may fail", fmi2ExitInitializationMode(c) == fmi2Error && hears());
    fmi2FreeInstance(c);
    c = begin(&looped);
    LAW("loops that have opened", fmi2CompletedIntegratorStep(c, 1, &enter, &ends) == fmi2OK && enter && !ends);
    LAW("are closed by an event", fmi2NewDiscreteStates(c, &event) == fmi2OK && event.valuesOfContinuousStatesChanged
        && ((component *)c)->core.numbers[Y] == 2 * ((component *)c)->core.numbers[X]);
    widest = 0;
    LAW("if they can be", fmi2NewDiscreteStates(c, &event) == fmi2Error && hears());
    fmi2FreeInstance(c);
}

static void step_and_keep(void)
{
    static const fmi2ValueReference states[] = {1, 2, 3};
    fmi2Component c = begin(&guided);
    fmi2FMUstate state = NULL, other = NULL;
    char bytes[1000];
    size_t size = 0;
    double v[3], time = 0, ahead[3];
    LAW("a state is kept", fmi2GetFMUstate(c, &state) == fmi2OK && state);
    LAW("a step is taken", fmi2DoStep(c, 0, 0.25, 1) == fmi2OK && fmi2GetReal(c, states, 3, ahead) == fmi2OK && ahead[0] != 0.5);
    LAW("to its end", fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &time) == fmi2OK && time == 0.25);
    LAW("of which alone there is a status", fmi2GetRealStatus(c, fmi2DoStepStatus, &time) == fmi2Discard);
    LAW("it is taken up", fmi2SetFMUstate(c, state) == fmi2OK && fmi2GetReal(c, states, 3, v) == fmi2OK && v[0] == 0.5);
    LAW("it has bytes", fmi2SerializedFMUstateSize(c, state, &size) == fmi2OK && size == mbs_fmi_count_bytes());
    LAW("which are written", fmi2SerializeFMUstate(c, state, bytes, size) == fmi2OK && !memcmp(bytes, state, size));
    LAW("and read", fmi2DeSerializeFMUstate(c, bytes, size, &other) == fmi2OK && !memcmp(other, state, size));
    LAW("whole", fmi2SerializeFMUstate(c, state, bytes, 1) == fmi2Error && fmi2DeSerializeFMUstate(c, bytes, 1, &other) == fmi2Error);
    LAW("it is freed", fmi2FreeFMUstate(c, &state) == fmi2OK && !state && fmi2FreeFMUstate(c, &other) == fmi2OK && !other);
    left = 0, complaints = 0;
    LAW("memory may lack for one", fmi2GetFMUstate(c, &state) == fmi2Error && hears());
    left = -1;
    LAW("a step may fail", fmi2DoStep(c, 0, -1, 1) == fmi2Error && hears());
    fmi2FreeInstance(c);
}

static void refuse_the_rest(void)
{
    fmi2Component c = begin(&guided);
    LAW("modes need nothing", fmi2EnterEventMode(c) == fmi2OK && fmi2EnterContinuousTimeMode(c) == fmi2OK
        && fmi2Terminate(c) == fmi2OK && fmi2SetDebugLogging(c, 1, 0, NULL) == fmi2OK && complaints == 0);
    LAW("there are no other types", fmi2GetInteger(c, NULL, 0, NULL) == fmi2OK && fmi2SetBoolean(c, NULL, 0, NULL) == fmi2OK);
    LAW("to read", fmi2GetInteger(c, NULL, 1, NULL) == fmi2Error && fmi2GetBoolean(c, NULL, 1, NULL) == fmi2Error
        && fmi2GetString(c, NULL, 1, NULL) == fmi2Error && complaints == 3);
    LAW("or to set", fmi2SetInteger(c, NULL, 1, NULL) == fmi2Error && fmi2SetBoolean(c, NULL, 1, NULL) == fmi2Error
        && fmi2SetString(c, NULL, 1, NULL) == fmi2Error && complaints == 6);
    LAW("nor derivatives by time", fmi2SetRealInputDerivatives(c, NULL, 0, NULL, NULL) == fmi2Error
        && fmi2GetRealOutputDerivatives(c, NULL, 0, NULL, NULL) == fmi2Error && complaints == 8);
    LAW("nor steps beside the caller", fmi2CancelStep(c) == fmi2Error && fmi2GetStatus(c, fmi2DoStepStatus, NULL) == fmi2Error
        && fmi2GetIntegerStatus(c, fmi2DoStepStatus, NULL) == fmi2Error
        && fmi2GetBooleanStatus(c, fmi2DoStepStatus, NULL) == fmi2Error
        && fmi2GetStringStatus(c, fmi2DoStepStatus, NULL) == fmi2Error && complaints == 13);
    fmi2FreeInstance(c);
}

int main(void)
{
    make_instances();
    exchange();
    step_and_keep();
    refuse_the_rest();
    return broken > 0;
}

/* FMI 3.0 of a unit: each function of the interface does what it says with the instance, and reports failures. */
#include "fmi.h"

#include "../../../csrc/fmi/mbs_fmi.c"
#include "../../../csrc/fmi/mbs_fmi3.c"

#undef malloc
#undef calloc

static char heard[300];
static int complaints;

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    ++complaints;
    snprintf(heard, sizeof heard, "%s %d %s %s", (const char *)environment, status, category, message);
}

static int hears(const char *message)
{
    char whole[300];
    int is_so;
    snprintf(whole, sizeof whole, "here 3 logStatusError %s", message);
    is_so = complaints == 1 && !strncmp(heard, whole, strlen(whole));
    complaints = 0;
    return is_so;
}

static fmi3Instance begin(const mbs_fmi_mechanism *model)
{
    present = model;
    last = widest = 1e9, setups = evaluations = complaints = 0;
    return fmi3InstantiateCoSimulation("unit", model->token, "", 0, 0, 0, 0, NULL, 0, "here", hear, NULL);
}

static void make_instances(void)
{
    fmi3Instance c;
    present = &guided;
    LAW("the version", !strcmp(fmi3GetVersion(), "3.0"));
    LAW("a token is checked", !fmi3InstantiateModelExchange("unit", "other", "", 0, 0, "here", hear) && hears("the token"));
    LAW("in silence too", !fmi3InstantiateModelExchange("unit", "other", "", 0, 0, NULL, NULL));
    LAW("nothing is scheduled",
        !fmi3InstantiateScheduledExecution("unit", "guided", "", 0, 0, "here", hear, NULL, NULL, NULL));
    for (left = 0; left < 3; ++left) {
        const long before = left;
        LAW("memory may lack", !fmi3InstantiateModelExchange("unit", "guided", "", 0, 0, "here", hear));
        LAW("which an instance reports", complaints == (before > 0));
        complaints = 0, left = before;
    }
    left = -1;
    c = fmi3InstantiateModelExchange("unit", "guided", "", 0, 0, "here", NULL);
    LAW("an instance for model exchange", c);
    fmi3FreeInstance(c);
    fmi3FreeInstance(NULL);
}

static void exchange(void)
{
    static const fmi3ValueReference all[] = {0, 1, 2, 3, 4}, knowns[] = {5, 1}, beyond[] = {99};
    const char pairs[] = "a seed for each";
    fmi3Instance c = begin(&guided);
    bool f[6] = {true, true, true, true, true, true};
    double v[5], seed[2] = {1, 2}, states[2] = {4, 5};
    size_t count = 9;
    LAW("it starts at a time", fmi3EnterInitializationMode(c, true, 1e-6, 2, true, 9) == fmi3OK
        && fmi3ExitInitializationMode(c) == fmi3OK && evaluations == 1);
    LAW("values are read", fmi3GetFloat64(c, all, 5, v, 5) == fmi3OK && v[0] == 2 && v[1] == 0.5 && v[2] == -1 && v[3] == -1
        && same(v[4], 14.25));
    LAW("not those that are not there", fmi3GetFloat64(c, beyond, 1, v, 1) == fmi3Error && hears("there is no variable"));
    LAW("one for each", fmi3GetFloat64(c, all, 5, v, 4) == fmi3Error && hears("as many values as"));
    v[0] = 0;
    LAW("inputs are set", fmi3SetFloat64(c, knowns, 1, v, 1) == fmi3OK && fmi3GetFloat64(c, all + 4, 1, v, 1) == fmi3OK
        && same(v[0], 11.25));
    LAW("rates are not", fmi3SetFloat64(c, all + 4, 1, v, 1) == fmi3Error && hears("the variable of"));
    LAW("one by one", fmi3SetFloat64(c, knowns, 1, v, 2) == fmi3Error && hears("as many values as"));
    LAW("derivatives along a seed", fmi3GetDirectionalDerivative(c, all + 3, 2, knowns, 2, seed, 2, v, 2) == fmi3OK
        && v[0] == 0 && same(v[1], 1 - 6));
    LAW("and adjoint ones", fmi3GetAdjointDerivative(c, all + 4, 1, knowns, 2, seed, 1, v, 2) == fmi3OK && v[0] == 1
        && same(v[1], -3));
    LAW("of unknowns", fmi3GetDirectionalDerivative(c, all, 1, knowns, 2, seed, 2, v, 1) == fmi3Error && hears("derivatives are"));
    LAW("so of adjoint ones", fmi3GetAdjointDerivative(c, all, 1, knowns, 2, seed, 1, v, 2) == fmi3Error && hears("derivatives are"));
    LAW("a seed of each known", fmi3GetDirectionalDerivative(c, all + 3, 2, knowns, 2, seed, 1, v, 2) == fmi3Error && hears(pairs));
    LAW("a result of each unknown", fmi3GetDirectionalDerivative(c, all + 3, 2, knowns, 2, seed, 2, v, 1) == fmi3Error && hears(pairs));
    LAW("or the other way", fmi3GetAdjointDerivative(c, all + 4, 1, knowns, 2, seed, 2, v, 2) == fmi3Error && hears(pairs));
    LAW("in both parts", fmi3GetAdjointDerivative(c, all + 4, 1, knowns, 2, seed, 1, v, 1) == fmi3Error && hears(pairs));
    LAW("the time", fmi3SetTime(c, 3) == fmi3OK && fmi3GetContinuousStateDerivatives(c, v, 2) == fmi3OK && v[0] == -1
        && same(v[1], 12.25));
    LAW("states", fmi3SetContinuousStates(c, states, 2) == fmi3OK && fmi3GetContinuousStates(c, v, 2) == fmi3OK && v[0] == 4
        && v[1] == 5 && fmi3GetNumberOfContinuousStates(c, &count) == fmi3OK && count == 2);
    LAW("of their number", fmi3SetContinuousStates(c, states, 1) == fmi3Error && fmi3GetContinuousStates(c, v, 1) == fmi3Error
        && fmi3GetContinuousStateDerivatives(c, v, 1) == fmi3Error && complaints == 3);
    complaints = 0, v[2] = 8;
    LAW("their size is of order one", fmi3GetNominalsOfContinuousStates(c, v, 2) == fmi3OK && v[0] == 1 && v[1] == 1 && v[2] == 8);
    LAW("nothing happens by itself", fmi3GetNumberOfEventIndicators(c, &count) == fmi3OK && count == 0
        && fmi3GetEventIndicators(c, v, 0) == fmi3OK && fmi3GetEventIndicators(c, v, 1) == fmi3Error && hears("there are no event"));
    LAW("open chains do not drift", fmi3CompletedIntegratorStep(c, true, f, f + 1) == fmi3OK && !f[0] && !f[1]);
    f[0] = f[1] = true, v[0] = 9;
    LAW("and need no event", fmi3UpdateDiscreteStates(c, f, f + 1, f + 2, f + 3, f + 4, v) == fmi3OK && !f[0] && !f[1] && !f[2]
        && !f[3] && !f[4] && v[0] == 0);
    LAW("the first values come back", fmi3Reset(c) == fmi3OK && fmi3GetFloat64(c, all, 3, v, 3) == fmi3OK && v[0] == 0 && v[1] == 0.5);
    last = -1;
    LAW("a start may fail", fmi3ExitInitializationMode(c) == fmi3Error && hears("the accelerations"));
    fmi3FreeInstance(c);
    c = begin(&looped);
    LAW("loops that have opened", fmi3CompletedIntegratorStep(c, true, f, f + 1) == fmi3OK && f[0] && !f[1]);
    LAW("are closed by an event", fmi3UpdateDiscreteStates(c, f, f + 1, f + 2, f + 3, f + 4, v) == fmi3OK && f[3] && !f[0]
        && ((component *)c)->core.numbers[Y] == 2 * ((component *)c)->core.numbers[X]);
    widest = 0;
    LAW("if they can be", fmi3UpdateDiscreteStates(c, f, f + 1, f + 2, f + 3, f + 4, v) == fmi3Error && hears("the loops"));
    fmi3FreeInstance(c);
}

static void step_and_keep(void)
{
    static const fmi3ValueReference states[] = {1, 2, 3};
    fmi3Instance c = begin(&guided);
    fmi3FMUState state = NULL, other = NULL;
    uint8_t bytes[1000];
    bool f[3] = {true, true, true};
    size_t size = 0;
    double v[3], time = 9;
    LAW("a state is kept", fmi3GetFMUState(c, &state) == fmi3OK && state);
    LAW("a step is taken", fmi3DoStep(c, 0, 0.25, true, f, f + 1, f + 2, &time) == fmi3OK && time == 0.25 && !f[0] && !f[1]
        && !f[2] && fmi3GetFloat64(c, states, 3, v, 3) == fmi3OK && v[0] != 0.5);
    LAW("it is taken up", fmi3SetFMUState(c, state) == fmi3OK && fmi3GetFloat64(c, states, 3, v, 3) == fmi3OK && v[0] == 0.5);
    LAW("it has bytes", fmi3SerializedFMUStateSize(c, state, &size) == fmi3OK && size == mbs_fmi_count_bytes());
    LAW("which are written", fmi3SerializeFMUState(c, state, bytes, size) == fmi3OK && !memcmp(bytes, state, size));
    LAW("and read", fmi3DeserializeFMUState(c, bytes, size, &other) == fmi3OK && !memcmp(other, state, size));
    LAW("whole", fmi3SerializeFMUState(c, state, bytes, 1) == fmi3Error && fmi3DeserializeFMUState(c, bytes, 1, &other) == fmi3Error);
    LAW("it is freed", fmi3FreeFMUState(c, &state) == fmi3OK && !state && fmi3FreeFMUState(c, &other) == fmi3OK && !other);
    left = 0, complaints = 0;
    LAW("memory may lack for one", fmi3GetFMUState(c, &state) == fmi3Error && hears("there is no memory"));
    left = -1;
    LAW("a step may fail", fmi3DoStep(c, 0, -1, true, f, f + 1, f + 2, &time) == fmi3Error && hears("the communication step"));
    fmi3FreeInstance(c);
}

#define REFUSES(type) fmi3Get##type(c, NULL, 1, NULL, 0) == fmi3Error && fmi3Set##type(c, NULL, 1, NULL, 0) == fmi3Error \
    && fmi3Get##type(c, NULL, 0, NULL, 0) == fmi3OK && fmi3Set##type(c, NULL, 0, NULL, 0) == fmi3OK

static void refuse_the_rest(void)
{
    fmi3Instance c = begin(&guided);
    LAW("modes need nothing", fmi3EnterEventMode(c) == fmi3OK && fmi3EnterContinuousTimeMode(c) == fmi3OK
        && fmi3EnterStepMode(c) == fmi3OK && fmi3EnterConfigurationMode(c) == fmi3OK && fmi3ExitConfigurationMode(c) == fmi3OK
        && fmi3EvaluateDiscreteStates(c) == fmi3OK && fmi3Terminate(c) == fmi3OK
        && fmi3SetDebugLogging(c, true, 0, NULL) == fmi3OK && complaints == 0);
    LAW("there are no other numbers", REFUSES(Float32) && REFUSES(Int8) && REFUSES(UInt8) && REFUSES(Int16) && REFUSES(UInt16)
        && REFUSES(Int32) && REFUSES(UInt32) && REFUSES(Int64) && REFUSES(UInt64) && complaints == 18);
    LAW("nor other types", REFUSES(Boolean) && REFUSES(String) && complaints == 22);
    LAW("nor bytes", fmi3GetBinary(c, NULL, 0, NULL, NULL, 0) == fmi3OK && fmi3GetBinary(c, NULL, 1, NULL, NULL, 0) == fmi3Error
        && fmi3SetBinary(c, NULL, 0, NULL, NULL, 0) == fmi3OK && fmi3SetBinary(c, NULL, 1, NULL, NULL, 0) == fmi3Error);
    LAW("nor clocks", fmi3GetClock(c, NULL, 0, NULL) == fmi3Error && fmi3SetClock(c, NULL, 0, NULL) == fmi3Error && complaints == 26);
    LAW("nor derivatives by time", fmi3GetOutputDerivatives(c, NULL, 0, NULL, NULL, 0) == fmi3Error
        && hears("") == 0 && !strcmp(heard, "here 3 logStatusError fmi3GetOutputDerivatives is not supported: see the "
                                            "capabilities of the model"));
    fmi3FreeInstance(c);
}

int main(void)
{
    make_instances();
    exchange();
    step_and_keep();
    refuse_the_rest();
    return broken > 0;
}

/* FMI 2.0 for co-simulation, around $name.h: a communication step is steps of $dt s, and a shorter one to its end. */
#include "$name.h"

#include <stddef.h>
#include <string.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#elif defined __GNUC__
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#define GUID "$guid"
#define INPUTS ${NAME}_INPUTS
#define OUTPUTS ${NAME}_OUTPUTS
#define ROUNDING 1e-6 /* share of a step that a clock may round by */

/* Of the standard's header files, what is used here. */
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;

typedef struct {
    $name body;
    ${name}_real inputs[INPUTS + 1];
    int contact; /* from the next step on */
} State;

typedef struct {
    State state;
    const fmi2CallbackFunctions *callbacks;
} Instance;

static const ${name}_real START[INPUTS + 1] = {$start};

static fmi2Status refuse(const fmi2CallbackFunctions *callbacks, const char *why)
{
    if (callbacks && callbacks->logger)
        callbacks->logger(callbacks->environment, "$name", fmi2Error, "error", why);
    return fmi2Error;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2Reset(fmi2Component component)
{
    State *state = &((Instance *)component)->state;
    ${name}_init(&state->body);
    memcpy(state->inputs, START, sizeof START);
    state->contact = 0;
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *instance = NULL;
    (void)name, (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, GUID))
        refuse(callbacks, "this is for co-simulation, and of the GUID " GUID);
    else if (callbacks && callbacks->allocateMemory && (instance = callbacks->allocateMemory(1, sizeof *instance))) {
        instance->callbacks = callbacks;
        fmi2Reset(instance);
    }
    return instance;
}

EXPORT void fmi2FreeInstance(fmi2Component component)
{
    if (component)
        ((Instance *)component)->callbacks->freeMemory(component);
}

EXPORT fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real duration, fmi2Boolean final)
{
    Instance *instance = component;
    State *state = &instance->state;
    const State before = *state;
    const double steps = duration / ${NAME}_DT;
    double rest;
    long left;
    int failed = 0;
    (void)time, (void)final;
    if (!(steps >= 0 && steps < 1e9))
        return refuse(instance->callbacks, "a communication step must be from 0 to 1e9 steps of $dt s");
    left = (long)(steps + ROUNDING);
    rest = steps - (double)left > ROUNDING ? duration - (double)left * ${NAME}_DT : 0;
    ${name}_switch(&state->body, state->contact);
#if !${NAME}_ANY_STEP
    if (rest > 0)
        return refuse(instance->callbacks, "a communication step must be a whole number of steps of $dt s");
#endif
    for (; left > 0 && !failed; --left)
        failed = ${name}_step(&state->body, state->inputs);
#if ${NAME}_ANY_STEP
    if (rest > 0 && !failed)
        failed = ${name}_step_by(&state->body, state->inputs, rest);
#endif
    if (failed) {
        *state = before;
        return refuse(instance->callbacks, "an input is not a finite number, or leads to none");
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference which[], size_t count, fmi2Real value[])
{
    const State *state = &((Instance *)component)->state;
    const $name *body = &state->body;
    ${name}_real read[OUTPUTS + 1];
    double account[4] = {0};
    size_t k;
    ${name}_outputs(body, read);
#if ${NAME}_ACCOUNT
    account[0] = ${name}_energy(body);
    account[1] = body->supplied;
    account[2] = body->dissipated;
    account[3] = body->lost_in_switching;
#endif
    for (k = 0; k < count; ++k)
        if (which[k] < INPUTS)
            value[k] = state->inputs[which[k]];
        else if (which[k] < INPUTS + OUTPUTS)
            value[k] = read[which[k] - INPUTS];
        else if (which[k] < INPUTS + OUTPUTS + ${NAME}_ACCOUNT)
            value[k] = account[which[k] - INPUTS - OUTPUTS];
        else
            return refuse(((Instance *)component)->callbacks, "there is no such real variable");
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(
    fmi2Component component, const fmi2ValueReference which[], size_t count, const fmi2Real value[])
{
    Instance *instance = component;
    size_t k;
    for (k = 0; k < count; ++k)
        if (which[k] < INPUTS)
            instance->state.inputs[which[k]] = (${name}_real)value[k];
        else
            return refuse(instance->callbacks, "there is no such real input");
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(
    fmi2Component component, const fmi2ValueReference which[], size_t count, fmi2Integer value[])
{
    Instance *instance = component;
    size_t k;
    for (k = 0; k < count; ++k)
        if (which[k])
            return refuse(instance->callbacks, "there is no such variable");
        else
            value[k] = instance->state.contact + 1;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetInteger(
    fmi2Component component, const fmi2ValueReference which[], size_t count, const fmi2Integer value[])
{
    Instance *instance = component;
    size_t k;
    for (k = 0; k < count; ++k)
        if (which[k] || value[k] < 1 || value[k] > ${NAME}_CONTACTS)
            return refuse(instance->callbacks, "there is no such variable, or no such contact mode");
        else
            instance->state.contact = value[k] - 1;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *saved)
{
    Instance *instance = component;
    if (!*saved)
        *saved = instance->callbacks->allocateMemory(1, sizeof(State));
    if (!*saved)
        return refuse(instance->callbacks, "there is no memory for a state");
    memcpy(*saved, &instance->state, sizeof(State));
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate saved)
{
    memcpy(&((Instance *)component)->state, saved, sizeof(State));
    return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *saved)
{
    ((Instance *)component)->callbacks->freeMemory(*saved);
    *saved = NULL;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate saved, size_t *size)
{
    (void)component, (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(State))
        return refuse(((Instance *)component)->callbacks, "there is no room for a state");
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(
    fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (size != sizeof(State))
        return refuse(((Instance *)component)->callbacks, "these bytes are not a state");
    if (fmi2GetFMUstate(component, saved) != fmi2OK)
        return fmi2Error;
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}

/* What has nothing to do here. */

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String which[])
{
    (void)component, (void)on, (void)count, (void)which;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    (void)component, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return fmi2OK;
}

#define NOTHING_TO_DO(name) \
    EXPORT fmi2Status name(fmi2Component component) \
    { \
        (void)component; \
        return fmi2OK; \
    }

NOTHING_TO_DO(fmi2EnterInitializationMode)
NOTHING_TO_DO(fmi2ExitInitializationMode)
NOTHING_TO_DO(fmi2Terminate)
NOTHING_TO_DO(fmi2CancelStep)

/* What there is nothing of. */

#define NO_VARIABLES(type, get, set) \
    EXPORT fmi2Status get(fmi2Component component, const fmi2ValueReference which[], size_t count, type value[]) \
    { \
        (void)which, (void)value; \
        return count ? refuse(((Instance *)component)->callbacks, "there is no such variable") : fmi2OK; \
    } \
    EXPORT fmi2Status set(fmi2Component component, const fmi2ValueReference which[], size_t count, const type value[]) \
    { \
        (void)which, (void)value; \
        return count ? refuse(((Instance *)component)->callbacks, "there is no such variable") : fmi2OK; \
    }

NO_VARIABLES(fmi2Boolean, fmi2GetBoolean, fmi2SetBoolean)
NO_VARIABLES(fmi2String, fmi2GetString, fmi2SetString)

#define NO_STATUS(type, name) \
    EXPORT fmi2Status name(fmi2Component component, fmi2StatusKind kind, type *value) \
    { \
        (void)component, (void)kind, (void)value; \
        return fmi2Discard; \
    }

NO_STATUS(fmi2Status, fmi2GetStatus)
NO_STATUS(fmi2Real, fmi2GetRealStatus)
NO_STATUS(fmi2Integer, fmi2GetIntegerStatus)
NO_STATUS(fmi2Boolean, fmi2GetBooleanStatus)
NO_STATUS(fmi2String, fmi2GetStringStatus)

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference which[], size_t count,
    const fmi2Integer order[], const fmi2Real value[])
{
    (void)which, (void)count, (void)order, (void)value;
    return refuse(((Instance *)component)->callbacks, "inputs are constant in a communication step");
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(
    fmi2Component component, const fmi2ValueReference which[], size_t count, const fmi2Integer order[], fmi2Real value[])
{
    (void)which, (void)count, (void)order, (void)value;
    return refuse(((Instance *)component)->callbacks, "there are no derivatives of outputs");
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[],
    size_t unknowns, const fmi2ValueReference known[], size_t knowns, const fmi2Real known_value[],
    fmi2Real unknown_value[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)known_value, (void)unknown_value;
    return refuse(((Instance *)component)->callbacks, "there are no directional derivatives");
}

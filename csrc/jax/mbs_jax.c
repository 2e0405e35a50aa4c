/* A handler of XLA's foreign function interface: kernels on arrays of compiled programs of JAX.
 *
 * One handler serves all kernels. A program names its kernel by an attribute, `kernel`: a number made from the content of
 * the kernel's library, so that a compiled program that is kept and read again never calls another function. Python
 * enters the kernels that it has loaded.
 */
#include "mbs_jax.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "c_api.h" /* of the installed jaxlib */

#define BUCKETS 1024 /* of the table of kernels */
#define SMALL 8192   /* bytes of memory that are taken from the stack */
#define ROWS 512     /* states of one call of a batch: their statuses are on the stack */

static mbs_jax_kernel *table[BUCKETS];

static mbs_jax_kernel *volatile *find_bucket(long long key)
{
    return (mbs_jax_kernel *volatile *)&table[(unsigned long long)key % BUCKETS];
}

static const mbs_jax_kernel *find_kernel(long long key)
{
    const mbs_jax_kernel *entry = __atomic_load_n(find_bucket(key), __ATOMIC_ACQUIRE);
    while (entry && entry->key != key)
        entry = entry->next;
    return entry;
}

int mbs_jax_enter(mbs_jax_kernel *entry)
{
    mbs_jax_kernel *volatile *bucket = find_bucket(entry->key);
    if (entry->n_in > MBS_JAX_MOST || entry->n_out > MBS_JAX_MOST)
        return 1;
    entry->next = *bucket;
    __atomic_store_n(bucket, entry, __ATOMIC_RELEASE);
    return 0;
}

static XLA_FFI_Error *refuse(const XLA_FFI_CallFrame *frame, const char *message)
{
    XLA_FFI_Error_Create_Args args = {0};
    args.struct_size = XLA_FFI_Error_Create_Args_STRUCT_SIZE;
    args.message = message;
    args.errc = XLA_FFI_Error_Code_FAILED_PRECONDITION;
    return frame->api->XLA_FFI_Error_Create(&args);
}

static casadi_int count(const XLA_FFI_Buffer *buffer)
{
    casadi_int entries = 1;
    int64_t k;
    for (k = 0; k < buffer->rank; ++k)
        entries *= buffer->dims[k];
    return entries;
}

/* Read the attribute `kernel`, the only one. */
static int read_key(const XLA_FFI_Attrs *attrs, long long *key)
{
    const XLA_FFI_Scalar *scalar;
    if (attrs->size != 1 || attrs->types[0] != XLA_FFI_AttrType_SCALAR)
        return 1;
    scalar = (const XLA_FFI_Scalar *)attrs->attrs[0];
    if (scalar->dtype != XLA_FFI_DataType_S64)
        return 1;
    memcpy(key, scalar->value, sizeof *key);
    return 0;
}

/* The results of failed states are not numbers. */
static void mark_failed(const mbs_jax_kernel *entry, casadi_int states, const int *status, casadi_real *const *res)
{
    casadi_int state, k, i;
    for (state = 0; state < states; ++state) {
        if (!status[state])
            continue;
        for (k = 0; k < entry->wanted; ++k)
            for (i = 0; i < entry->out_size[k]; ++i)
                res[k][state * entry->out_size[k] + i] = NAN;
    }
}

/* Call the kernel on some states. */
static casadi_int call_some(const mbs_jax_kernel *entry, casadi_int rows, casadi_real *const *given,
                            const casadi_int *step, casadi_real *const *wanted, int *status, void *room)
{
    static const mbs_given no_input;
    static const mbs_found no_output;
    mbs_given in[MBS_JAX_MOST], *input;
    mbs_found out[MBS_JAX_MOST], *output;
    casadi_int k;
    for (k = 0; k < entry->n_in; ++k)
        in[k] = no_input;
    for (k = 0; k < entry->n_out; ++k)
        out[k] = no_output;
    for (k = 0; k < entry->given; ++k) {
        input = in + entry->in_place[k];
        input->first = given[k];
        input->step = step[k];
        input->nonzeros = entry->in_size[k];
    }
    for (k = 0; k < entry->wanted; ++k) {
        output = out + entry->out_place[k];
        output->first = wanted[k];
        output->step = output->nonzeros = output->numbers = entry->out_size[k];
        output->apart = 1;
    }
    return entry->many(entry->kernel, entry->several, rows, 0, rows, entry->n_in, in, entry->n_out, out, room, status);
}

/* Call the kernel on all states, some at a time. */
static void call(const mbs_jax_kernel *entry, casadi_int states, casadi_real *const *given, const casadi_int *step,
                 casadi_real *const *wanted, int *statuses, void *room)
{
    casadi_real *from[MBS_JAX_MOST], *to[MBS_JAX_MOST];
    casadi_int first, rows, k;
    int own[ROWS], *status;
    for (first = 0; first < states; first += ROWS) {
        rows = states - first < ROWS ? states - first : ROWS;
        status = statuses ? statuses + first : own;
        for (k = 0; k < entry->given; ++k)
            from[k] = given[k] + first * step[k];
        for (k = 0; k < entry->wanted; ++k)
            to[k] = wanted[k] + first * entry->out_size[k];
        if (call_some(entry, rows, from, step, to, status, room))
            mark_failed(entry, rows, status, to);
    }
}

static XLA_FFI_Error *describe(XLA_FFI_CallFrame *frame)
{
    XLA_FFI_Metadata *metadata = ((XLA_FFI_Metadata_Extension *)frame->extension_start)->metadata;
    metadata->api_version.major_version = XLA_FFI_API_MAJOR;
    metadata->api_version.minor_version = XLA_FFI_API_MINOR;
    metadata->traits = 0;
    return 0;
}

/* Operands are the kernel's given inputs, by nonzeros: a row for each state, or one for all. Results are its wanted
 * outputs, a row for each state; one more result, of int32, takes the statuses. */
XLA_FFI_Error *mbs_jax(XLA_FFI_CallFrame *frame)
{
    const mbs_jax_kernel *entry;
    const XLA_FFI_Buffer *buffer;
    casadi_real *given[MBS_JAX_MOST], *wanted[MBS_JAX_MOST];
    casadi_int step[MBS_JAX_MOST], states, k;
    int *statuses = 0;
    char small[SMALL];
    void *room = small;
    long long key;
    if (frame->extension_start && frame->extension_start->type == XLA_FFI_Extension_Metadata)
        return describe(frame);
    if (frame->stage != XLA_FFI_ExecutionStage_EXECUTE)
        return 0;
    if (read_key(&frame->attrs, &key) || !(entry = find_kernel(key)))
        return refuse(frame, "a compiled program calls a kernel that is not loaded; call mbsrun.jax.load first");
    if (frame->args.size != entry->given || frame->rets.size < entry->wanted || frame->rets.size > entry->wanted + 1)
        return refuse(frame, "a compiled program calls a kernel with other arguments than it has; compile it again");
    if (frame->rets.size > entry->wanted)
        statuses = (int *)((XLA_FFI_Buffer *)frame->rets.rets[entry->wanted])->data;
    states = count((XLA_FFI_Buffer *)frame->rets.rets[0]) / entry->out_size[0];
    for (k = 0; k < entry->given; ++k) {
        buffer = (const XLA_FFI_Buffer *)frame->args.args[k];
        given[k] = (casadi_real *)buffer->data;
        step[k] = count(buffer) == entry->in_size[k] ? 0 : entry->in_size[k];
    }
    for (k = 0; k < entry->wanted; ++k)
        wanted[k] = (casadi_real *)((XLA_FFI_Buffer *)frame->rets.rets[k])->data;
    if (entry->room > SMALL && !(room = malloc((size_t)entry->room)))
        return refuse(frame, "no memory is left for a batch");
    call(entry, states, given, step, wanted, statuses, room);
    if (room != small)
        free(room);
    return 0;
}

/* A handler of XLA's foreign function interface: kernels on arrays of compiled programs of JAX.
 *
 * One handler serves all kernels. A program names its kernel by an attribute, `kernel`: a number made from the content of
 * the kernel's library, so that a compiled program that is kept and read again never calls another function. Python
 * enters the kernels that it has loaded.
 */
#include "mbs_jax.h"

#include <math.h>
#include <string.h>

#include "c_api.h" /* of the installed jaxlib */

#define BUCKETS 1024 /* of the table of kernels */
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

/* Call the kernel on all states, some at a time. */
static void call(const mbs_jax_kernel *entry, casadi_int states, casadi_real *const *given, const casadi_int *step,
                 casadi_real *const *wanted, int *statuses)
{
    const casadi_real *arg[MBS_JAX_MOST] = {0};
    casadi_real *res[MBS_JAX_MOST] = {0}, *part[MBS_JAX_MOST];
    casadi_int arg_step[MBS_JAX_MOST] = {0}, res_step[MBS_JAX_MOST] = {0};
    casadi_int first, rows, k;
    int own[ROWS], *status;
    for (k = 0; k < entry->given; ++k)
        arg_step[entry->in_place[k]] = step[k];
    for (k = 0; k < entry->wanted; ++k)
        res_step[entry->out_place[k]] = entry->out_size[k];
    for (first = 0; first < states; first += ROWS) {
        rows = states - first < ROWS ? states - first : ROWS;
        status = statuses ? statuses + first : own;
        for (k = 0; k < entry->given; ++k)
            arg[entry->in_place[k]] = given[k] + first * step[k];
        for (k = 0; k < entry->wanted; ++k)
            res[entry->out_place[k]] = part[k] = wanted[k] + first * entry->out_size[k];
        if (entry->batch(entry->kernel, rows, entry->n_in, arg, arg_step, entry->n_out, res, res_step, status))
            mark_failed(entry, rows, status, part);
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
    call(entry, states, given, step, wanted, statuses);
    return 0;
}

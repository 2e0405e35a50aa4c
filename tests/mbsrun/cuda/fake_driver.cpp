// A driver of two GPUs whose memory is the host's: the calls of libcuda that mbsrun.cuda makes, by their contract.
// Code is the path of a library that runs a grid. A wrong call returns an error, or stops the process.
#include <dlfcn.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#ifdef WITH_CUDA_H // NVIDIA's own declarations: the compiler compares
#include <cuda.h>
#else
typedef int CUresult, CUdevice, CUdevice_attribute, CUpointer_attribute;
typedef unsigned long long CUdeviceptr;
typedef void *CUcontext, *CUmodule, *CUfunction, *CUstream, *CUevent;
#endif

struct Block {
    size_t size;
    int device;
};
static const int DEVICES = 2, GUARD = 64; // bytes on either side of memory, which nobody may write
static std::map<uint64_t, Block> memory;
static std::vector<int> contexts; // devices + 1
static std::string told;
static bool is_initialised = false;
static int next_failure = 0;
static int places[DEVICES];

static int check(const char *name, bool needs_context = true)
{
    told += std::string(name) + "\n";
    if (!is_initialised)
        return 3;
    if (needs_context && contexts.empty())
        return 201;
    const int failure = next_failure;
    next_failure = 0;
    return failure;
}

static void require(bool is_right, const char *what)
{
    if (!is_right) {
        std::fprintf(stderr, "fake driver: %s\n", what);
        std::abort();
    }
}

static bool is_guarded(uint64_t p, size_t size)
{
    const unsigned char *before = (unsigned char *)p - GUARD, *after = (unsigned char *)p + size;
    for (int i = 0; i < GUARD; ++i)
        if (before[i] != 0xA5 || after[i] != 0xA5)
            return false;
    return true;
}

// The block that holds an address; end if none does.
static std::map<uint64_t, Block>::iterator find(uint64_t p)
{
    auto it = memory.upper_bound(p);
    if (it == memory.begin())
        return memory.end();
    --it;
    return p < it->first + it->second.size ? it : memory.end();
}

typedef void (*Grid)(unsigned, unsigned, void **);

extern "C" {

const char *fake_told(void)
{
    return told.c_str();
}

void fake_forget(void)
{
    told.clear();
}

void fake_fail(int code)
{
    next_failure = code;
}

int fake_depth(void)
{
    return (int)contexts.size();
}

int fake_blocks(void)
{
    for (auto &entry : memory)
        require(is_guarded(entry.first, entry.second.size), "memory beside a block was written");
    return (int)memory.size();
}

CUresult cuInit(unsigned flags)
{
    is_initialised = true;
    return flags ? 1 : 0;
}

CUresult cuGetErrorString(CUresult code, const char **text)
{
    *text = code == 2 ? "out of memory" : code == 201 ? "invalid device context" : nullptr;
    return *text ? 0 : 1;
}

CUresult cuDeviceGetCount(int *n)
{
    *n = DEVICES;
    return check("cuDeviceGetCount", false);
}

CUresult cuDeviceGetName(char *name, int size, CUdevice device)
{
    std::snprintf(name, (size_t)size, "Fake %d", device);
    return check("cuDeviceGetName", false);
}

CUresult cuDeviceGetAttribute(int *value, CUdevice_attribute attribute, CUdevice device)
{
    require(attribute == 75 || attribute == 76, "an unknown attribute of a device");
    *value = attribute == 75 ? 9 : 0;
    return check("cuDeviceGetAttribute", false) || device < 0 || device >= DEVICES ? 101 : 0;
}

CUresult cuDevicePrimaryCtxRetain(CUcontext *context, CUdevice device)
{
    *context = (CUcontext)&places[device];
    return check("cuDevicePrimaryCtxRetain", false);
}

CUresult cuCtxPushCurrent_v2(CUcontext context)
{
    contexts.push_back((int)((int *)context - places));
    return check("cuCtxPushCurrent");
}

CUresult cuCtxPopCurrent_v2(CUcontext *context)
{
    const int failure = check("cuCtxPopCurrent");
    if (failure)
        return failure;
    *context = (CUcontext)&places[contexts.back()];
    contexts.pop_back();
    return 0;
}

CUresult cuPointerGetAttribute(void *value, CUpointer_attribute attribute, CUdeviceptr p)
{
    const auto it = find(p);
    if (it == memory.end())
        return 1;
    require(attribute == 2 || attribute == 8 || attribute == 9, "an unknown attribute of a pointer");
    if (attribute == 8)
        *(unsigned char *)value = 0;
    else
        *(int *)value = attribute == 2 ? 2 : it->second.device;
    return 0;
}

CUresult cuModuleLoadData(CUmodule *module, const void *code)
{
    const int failure = check("cuModuleLoadData");
    if (failure)
        return failure;
    *module = dlopen((const char *)code, RTLD_NOW | RTLD_LOCAL);
    return *module ? 0 : 200;
}

CUresult cuModuleGetFunction(CUfunction *function, CUmodule module, const char *name)
{
    *function = dlsym(module, (std::string(name) + "_grid").c_str());
    return *function ? check("cuModuleGetFunction") : 500;
}

CUresult cuLaunchKernel(CUfunction function, unsigned x, unsigned y, unsigned z, unsigned threads, unsigned ty,
                        unsigned tz, unsigned shared, CUstream stream, void **arguments, void **extra)
{
    const int failure = check(("cuLaunchKernel on " + std::to_string((uint64_t)stream)).c_str());
    if (failure)
        return failure;
    if (!x || y != 1 || z != 1 || threads != 128 || ty != 1 || tz != 1 || shared || extra)
        return 1;
    ((Grid)function)(x, threads, arguments);
    return 0;
}

CUresult cuMemAllocAsync(CUdeviceptr *p, size_t size, CUstream)
{
    const int failure = check("cuMemAlloc");
    if (failure || !size)
        return failure ? failure : 1;
    unsigned char *bytes = (unsigned char *)std::malloc(size + 2 * GUARD);
    std::memset(bytes, 0xA5, size + 2 * GUARD);
    *p = (uint64_t)(bytes + GUARD);
    memory[*p] = {size, contexts.back()};
    return 0;
}

CUresult cuMemFreeAsync(CUdeviceptr p, CUstream)
{
    const int failure = check("cuMemFree");
    if (failure || !memory.count(p))
        return failure ? failure : 1;
    require(is_guarded(p, memory[p].size), "memory beside a block was written");
    memory.erase(p);
    std::free((void *)(p - GUARD));
    return 0;
}

CUresult cuMemcpyHtoD_v2(CUdeviceptr p, const void *from, size_t size)
{
    const auto it = find(p);
    require(it != memory.end() && p + size <= it->first + it->second.size, "a copy beyond a block");
    std::memcpy((void *)p, from, size);
    return check("cuMemcpyHtoD");
}

CUresult cuMemcpyDtoH_v2(void *to, CUdeviceptr p, size_t size)
{
    const auto it = find(p);
    require(it != memory.end() && p + size <= it->first + it->second.size, "a copy beyond a block");
    std::memcpy(to, (void *)p, size);
    return check("cuMemcpyDtoH");
}

CUresult cuStreamSynchronize(CUstream stream)
{
    return check(("cuStreamSynchronize " + std::to_string((uint64_t)stream)).c_str());
}

CUresult cuEventCreate(CUevent *event, unsigned flags)
{
    *event = std::malloc(1);
    return flags == 2 ? check("cuEventCreate") : 1;
}

CUresult cuEventRecord(CUevent, CUstream stream)
{
    return check(("cuEventRecord on " + std::to_string((uint64_t)stream)).c_str());
}

CUresult cuStreamWaitEvent(CUstream stream, CUevent, unsigned flags)
{
    return flags ? 1 : check(("cuStreamWaitEvent on " + std::to_string((uint64_t)stream)).c_str());
}

CUresult cuEventDestroy_v2(CUevent event)
{
    std::free(event);
    return check("cuEventDestroy");
}
}

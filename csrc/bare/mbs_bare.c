/* Start-up code, output and counters for QEMU's mps2-an500: see mbs_bare.h.
 *
 * The stack lies at the start of the memory, where nothing is below it: an overflow is a fault. It is painted before
 * main runs, so that its deepest use shows after it. */
#include "mbs_bare.h"

#include <stdint.h>

#define PAINT 0xa5a5a5a5u
#define FAULT 99          /* status of the emulator after a fault */
#define WRITE 4           /* operations of semihosting (Arm: Semihosting for AArch32 and AArch64) */
#define EXIT_EXTENDED 32
#define APPLICATION_EXIT 0x20026
#define CPACR (*(volatile uint32_t *)0xe000ed88u)   /* access to the floating-point unit */
#define COUNTER (*(volatile uint32_t *)0x40028018u) /* ticks of 25 MHz: 40 ns */
#define NANOSECONDS_A_TICK 40
#define SHIFT 6 /* an instruction takes 2^6 ns */

extern uint32_t stack_low[], stack_high[], data_load[], data_start[], data_end[], bss_start[], bss_end[];
int main(void);

static int call_host(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void leave(uint32_t status)
{
    const uint32_t block[2] = {APPLICATION_EXIT, status};
    for (;;)
        call_host(EXIT_EXTENDED, block);
}

void mbs_bare_print(const char *text)
{
    call_host(WRITE, text);
}

/* Write the decimal digits of a number before `end`; return where they begin. */
static char *write_digits(long number, char *end)
{
    unsigned long rest = number < 0 ? 0 - (unsigned long)number : (unsigned long)number;
    do
        *--end = (char)('0' + rest % 10);
    while ((rest /= 10) > 0);
    if (number < 0)
        *--end = '-';
    return end;
}

static void print_line(const char *name, const char *value)
{
    mbs_bare_print(name);
    mbs_bare_print(" ");
    mbs_bare_print(value);
    mbs_bare_print("\n");
}

void mbs_bare_print_integer(const char *name, long number)
{
    char text[16];
    text[15] = 0;
    print_line(name, write_digits(number, text + 15));
}

void mbs_bare_print_float(const char *name, float number)
{
    char text[24], *at = text + 23;
    const union {
        float number;
        uint32_t bits;
    } pun = {number};
    const uint32_t sign = pun.bits >> 31, exponent = pun.bits >> 23 & 255;
    uint32_t digits = (pun.bits & 0x7fffffu) << 1;
    int i;
    if (exponent == 255) {
        print_line(name, digits ? "nan" : sign ? "-inf" : "inf");
        return;
    }
    *at = 0;
    at = write_digits(exponent ? (long)exponent - 127 : -126, at);
    *--at = 'p';
    for (i = 0; i < 6; ++i, digits >>= 4)
        *--at = "0123456789abcdef"[digits & 15];
    *--at = '.', *--at = exponent ? '1' : '0', *--at = 'x', *--at = '0';
    if (sign)
        *--at = '-';
    print_line(name, at);
}

unsigned long mbs_bare_instructions(void)
{
    return (unsigned long)(((uint64_t)COUNTER * NANOSECONDS_A_TICK) >> SHIFT);
}

static void paint_stack(void)
{
    volatile uint32_t *at; /* a call of memset would overwrite its own frame */
    uint32_t *pointer;
    __asm__ volatile("mov %0, sp" : "=r"(pointer));
    for (at = stack_low; at < pointer; ++at)
        *at = PAINT;
}

static long measure_stack(void)
{
    const uint32_t *at = stack_low;
    while (at < stack_high && *at == PAINT)
        ++at;
    return (long)((uintptr_t)stack_high - (uintptr_t)at);
}

__attribute__((used)) static void report_fault(void)
{
    mbs_bare_print("fault\n");
    leave(FAULT);
}

/* The stack may be used up: begin it anew. */
__attribute__((naked)) static void fault(void)
{
    __asm__ volatile("ldr r0, =stack_high\n\tmov sp, r0\n\tb report_fault");
}

static void reset(void)
{
    uint32_t *from = data_load, *to;
    unsigned long began, counted;
    long deepest;
    int status;
    CPACR |= 0xfu << 20;
    __asm__ volatile("dsb\n\tisb");
    for (to = data_start; to < data_end; ++to)
        *to = *from++;
    for (to = bss_start; to < bss_end; ++to)
        *to = 0;
    paint_stack();
    began = mbs_bare_instructions();
    status = main();
    counted = mbs_bare_instructions() - began;
    deepest = measure_stack();
    mbs_bare_print_integer("mbs_bare_instructions", (long)counted);
    mbs_bare_print_integer("mbs_bare_stack", deepest);
    leave((uint32_t)status);
}

/* The first stack pointer, the start, and a handler for each fault of the processor. */
typedef union {
    const void *stack;
    void (*handler)(void);
} vector;

__attribute__((used, section(".vectors"))) static const vector vectors[16] = {
    {stack_high},       {.handler = reset}, {.handler = fault}, {.handler = fault}, {.handler = fault},
    {.handler = fault}, {.handler = fault}, {.handler = fault}, {.handler = fault}, {.handler = fault},
    {.handler = fault}, {.handler = fault}, {.handler = fault}, {.handler = fault}, {.handler = fault},
    {.handler = fault},
};

/* Run a program on a bare Cortex-M7: start, print, count instructions, measure the stack.
 *
 * Compile mbs_bare.c with the program, and link it by mps2_an500.ld: QEMU's machine of that name runs it, with
 * `-icount shift=6` and semihosting. There is no heap and no stdio. The status of `main` ends the emulator. */
#ifndef MBS_BARE_H
#define MBS_BARE_H

/* Print text, or a line "name number". Floating-point numbers are in hexadecimal, without rounding: 0x1.8p+1 is 3. */
void mbs_bare_print(const char *text);
void mbs_bare_print_integer(const char *name, long number);
void mbs_bare_print_float(const char *name, float number);

/* Return how many instructions ran since the machine started; it overflows after 2.6e9. */
unsigned long mbs_bare_instructions(void);

#endif

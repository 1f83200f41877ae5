/* Reset of a Cortex-M4 under QEMU: the floating point unit on, then newlib's start with semihosting. */
extern void _mainCRTStartup(void);
extern char __stack[];

void reset(void);

void reset(void)
{
    *(volatile unsigned *)0xE000ED88u |= 0xFu << 20; /* CPACR: full access to CP10 and CP11 */
    __asm__ volatile("dsb\n\tisb");
    _mainCRTStartup();
}

extern const struct vectors {
    char *stack;
    void (*reset)(void);
} VECTORS;

__attribute__((section(".vectors"), used)) const struct vectors VECTORS = { __stack, reset };

/* Start-up and clock of a Cortex-M, see cortex_m.h.
 * Rule of the clock: an interrupt is taken once for each period of SysTick, and the period is as long as its
 * 24 bits allow. So nothing is lost when interrupts are off for a while, which a tick of 1 ms would not survive. SysTick keeps the
 * priority it has after a reset, 0: then no interrupt that asks for the time comes between its begin and its sum. */
#include "cortex_m.h"

#define SYST_CSR CORTEX_M_REG(0xE000E010)
#define SYST_RVR CORTEX_M_REG(0xE000E014)
#define SYST_CVR CORTEX_M_REG(0xE000E018)
#define SCB_ICSR CORTEX_M_REG(0xE000ED04)
#define SCB_VTOR CORTEX_M_REG(0xE000ED08)

enum {
    CSR_ENABLE = 1 << 0,
    CSR_INTERRUPT = 1 << 1,
    CSR_PROCESSOR_CLOCK = 1 << 2,
    ICSR_SYSTICK_PENDING = 1 << 26,
    SYSTICK_LIMIT = 1 << 24
};

/* Given by the linker script; all of them are multiples of 4. */
extern uint32_t cortex_m_stack_top[], cortex_m_data_start[], cortex_m_data_end[], cortex_m_bss_start[],
    cortex_m_bss_end[];
extern const uint32_t cortex_m_data_load[];

int main(int argc, char **argv);

static uint32_t cycles_per_us, period_ms, period_cycles;
static volatile uint64_t passed_ms; /* in whole periods */

/* A fault, or an exception that nobody uses: a debugger finds the processor here. */
static void stop(void) {
    for (;;) {
    }
}

static void systick(void) {
    passed_ms += period_ms;
}

typedef struct {
    uint32_t *stack_top;
    cortex_m_handler handlers[15]; /* of exceptions 1 to 15 */
} vector_table;

__attribute__((section(".vectors"), used)) static const vector_table vectors = {
    cortex_m_stack_top,
    {cortex_m_reset, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, systick}};

void cortex_m_reset(void) {
    const uint32_t *from = cortex_m_data_load;
    uint32_t *to;

    for (to = cortex_m_data_start; to != cortex_m_data_end; to++)
        *to = *from++;
    for (to = cortex_m_bss_start; to != cortex_m_bss_end; to++)
        *to = 0;
    SCB_VTOR = (uint32_t)(uintptr_t)&vectors; /* a boot loader may have left its own */
    main(0, 0);
    stop();
}

void cortex_m_start_clock(uint32_t clock_hz) {
    cycles_per_us = clock_hz / 1000000;
    period_ms = SYSTICK_LIMIT / (cycles_per_us * 1000);
    period_cycles = period_ms * cycles_per_us * 1000;
    SYST_RVR = period_cycles - 1;
    SYST_CVR = 0;
    SYST_CSR = CSR_ENABLE | CSR_INTERRUPT | CSR_PROCESSOR_CLOCK;
    while (SYST_CVR == 0) { /* until it is loaded: 0 means "at the end of a period" below */
    }
}

/* Gives the whole periods that have passed, in milliseconds. Returns the cycles since then. */
static uint32_t read_clock(uint64_t *periods_ms) {
    uint64_t before_ms;
    uint32_t left;
    do { /* once more, when the interrupt came in between */
        before_ms = passed_ms;
        *periods_ms = before_ms;
        left = SYST_CVR;
        if (SCB_ICSR & ICSR_SYSTICK_PENDING) { /* it is due, and held off */
            *periods_ms += period_ms;
            left = SYST_CVR; /* of the new period; the first one may be of the old one */
            if (left == 0)
                left = period_cycles;
        }
    } while (before_ms != passed_ms);
    return period_cycles - left;
}

uint64_t cortex_m_us(void) {
    uint64_t periods_ms;
    const uint32_t cycles = read_clock(&periods_ms);
    return periods_ms * 1000 + cycles / cycles_per_us;
}

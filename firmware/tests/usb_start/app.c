/* What a program may find at its start: `restart` jumps to address 0 without a reset, as a boot loader does, and
 * `watchdog` does so with the watchdog on. `causes` returns MCUSR, in which two causes of a reset are found. */
#include <avr/interrupt.h>
#include <avr/wdt.h>

#include "j2a_functions.h"

/* Before main(). */
__attribute__((naked, used, section(".init3"))) static void leave_causes(void) {
    MCUSR = _BV(WDRF) | _BV(EXTRF);
}

static void jump(void) {
    cli();
    __asm__ volatile("jmp 0");
}

uint8_t restart(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (void)payload;
    jump();
    return 0;
}

uint8_t watchdog(uint8_t *const length, uint8_t **const payload) {
    (void)length;
    (void)payload;
    wdt_enable(WDTO_60MS);
    jump();
    return 0;
}

uint8_t causes(uint8_t *const length, uint8_t **const payload) {
    **payload = MCUSR;
    *length = 1;
    return 0;
}

void j2a_app_task(void) {
}

/* Timer 1 as both clocks, see avr_clock.h. In: nothing but the timer. Out: its lower 16 bits as they are,
 * and with J2A_WITH_CLOCK microseconds, for which an interrupt counts the overflows. */
#include "avr_clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <string.h>
#include <util/atomic.h>

#include "j2a_clock.h"

void avr_clock_start(void) {
    /* All of it: a boot loader may leave other values than a reset does. */
#if J2A_WITH_CLOCK
    TIMSK1 = _BV(TOIE1);
#endif
    TCCR1A = 0;
    TCCR1B = AVR_CLOCK_DIVIDER == 8 ? _BV(CS11) : _BV(CS11) | _BV(CS10);
}

uint16_t j2a_port_ticks(void) {
    uint16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { /* an interrupt may read the timer, too */
        now = TCNT1;
    }
    return now;
}

#if J2A_PORT_WAIT
#ifndef AVR_CLOCK_QUIET
#define AVR_CLOCK_QUIET(due) ((void)0)
#endif

void j2a_port_wait(uint32_t local_us) {
    enum { TICKS_PER_US = F_CPU / 1000000 / AVR_CLOCK_DIVIDER, LAST_TICKS = 20 * TICKS_PER_US };
    const uint16_t due = (uint16_t)(local_us * TICKS_PER_US);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        while ((int16_t)(due - TCNT1) > LAST_TICKS) {
            NONATOMIC_BLOCK(NONATOMIC_FORCEOFF) {
                __asm__ volatile("nop\n\tnop"); /* an interrupt that is due is taken here; simavr needs two */
            }
        }
        AVR_CLOCK_QUIET(due);
        while ((int16_t)(due - TCNT1) > 0) {
        }
    }
}
#endif

#if J2A_PORT_PRODUCT
/* Bit by bit: the upper half of the product, r22 to r25, moves to the right through b, r18 to r21. The library has only a
 * product of 64 bits by 64, which takes three times as long, and its operands 30 bytes of stack. */
__attribute__((naked, noinline)) int32_t j2a_port_product(int32_t a, int32_t b, uint32_t *low) {
    (void)a;
    (void)b;
    (void)low;
    __asm__("ldi r26, 32\n\tmov r0, r26\n\t"
            "movw r26, r22\n\tmovw r30, r24\n\t" /* a */
            "clr r22\n\tclr r23\n\tmovw r24, r22\n\t"
            "bst r21, 7\n"
            "1:\tsbrs r18, 0\n\trjmp 2f\n\t"
            "add r22, r26\n\tadc r23, r27\n\tadc r24, r30\n\tadc r25, r31\n"
            "2:\tasr r25\n\tror r24\n\tror r23\n\tror r22\n\t"
            "ror r21\n\tror r20\n\tror r19\n\tror r18\n\t"
            "dec r0\n\tbrne 1b\n\t"
            "brtc 3f\n\t" /* the sign of b counts as -2^31, not as 2^31 */
            "sub r22, r26\n\tsbc r23, r27\n\tsbc r24, r30\n\tsbc r25, r31\n"
            "3:\tmovw r30, r16\n\tst Z, r18\n\tstd Z+1, r19\n\tstd Z+2, r20\n\tstd Z+3, r21\n\tret");
}
#endif

#if J2A_WITH_CLOCK
uint32_t avr_clock_overflows; /* each 262 ms at 16 MHz, 33 ms with J2A_WITH_SYNC */

ISR(TIMER1_OVF_vect) {
    avr_clock_overflows++;
}

/* Once, where it has two callers: it is long. */
#if J2A_PORT_STAMP && J2A_WITH_TRANSDUCERS
__attribute__((noinline))
#endif
static uint64_t time_us_of(uint32_t high, uint16_t low) {
    const uint64_t cycles = ((uint64_t)high << 16 | low) * AVR_CLOCK_DIVIDER;
#if F_CPU % 1000000 == 0
    return cycles / (F_CPU / 1000000);
#else /* exact, too, and in two steps nothing overflows */
    return cycles / F_CPU * 1000000 + cycles % F_CPU * 1000000 / F_CPU;
#endif
}

uint64_t j2a_port_time_us(void) {
    uint32_t high;
    uint16_t low;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        low = TCNT1;
        high = avr_clock_overflows;
        if ((TIFR1 & _BV(TOV1)) && low < 0x8000) /* wrapped, but its interrupt has not run yet */
            high++;
    }
    return time_us_of(high, low);
}

#if J2A_PORT_STAMP && J2A_WITH_TRANSDUCERS
/* Says that there is a stamp, in the byte of TIFR1, whose bit it never is. */
#define STAMPED 0x80

/* In assembler, because avr-gcc computes the address of each byte anew, and inline, because an encoder's interrupt has no
 * time for a call. */
inline __attribute__((always_inline)) void j2a_port_stamp(volatile uint8_t *stamp) {
    uint8_t byte;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        __asm__ volatile("lds %0, %2\n\tst %a1, %0\n\t"
                         "lds %0, %2+1\n\tstd %a1+1, %0\n\t"
                         "in %0, %3\n\tori %0, %4\n\tstd %a1+7, %0\n\t" /* behind the timer, which may overflow */
                         "lds %0, %5\n\tstd %a1+2, %0\n\t"
                         "lds %0, %5+1\n\tstd %a1+3, %0\n\t"
                         "lds %0, %5+2\n\tstd %a1+4, %0\n\t"
                         "lds %0, %5+3\n\tstd %a1+5, %0"
                         : "=&d"(byte)
                         : "b"(stamp), "n"(_SFR_MEM_ADDR(TCNT1)), "I"(_SFR_IO_ADDR(TIFR1)), "M"(STAMPED),
                           "i"(&avr_clock_overflows)
                         : "memory");
    }
}

uint64_t j2a_port_stamp_us(const uint8_t *stamp) {
    uint16_t low;
    uint32_t high;
    memcpy(&low, stamp, sizeof low);
    memcpy(&high, stamp + sizeof low, sizeof high);
    if ((stamp[J2A_STAMP_BYTES - 1] & _BV(TOV1)) && low < 0x8000) /* as in j2a_port_time_us() */
        high++;
    return time_us_of(high, low);
}
#endif
#endif

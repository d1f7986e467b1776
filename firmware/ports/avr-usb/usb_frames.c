/* The starts of USB frames as a clock, see usb.h. In: the interrupt at each start of frame, which notes the frame
 * number and timer 1, and nothing more. Out: the last start for core/ext/j2a_clock_frames.c, and the answer to the
 * request of SyncUSB (SYNC-008). */
#include "usb.h"
#include "j2a_clock.h"

#if J2A_PORT_FRAMES

#include <avr/interrupt.h>
#include <util/atomic.h>

#define TICKS_PER_US (F_CPU / 1000000 / AVR_CLOCK_DIVIDER)
#define OLD_TICKS (J2A_CLOCK_FRAMES_MS * 1000UL * TICKS_PER_US)

static volatile struct {
    uint16_t number, ticks, overflows;
    bool is_known;
} last;

/* Ends what usb_quiet() began with the overflow of the timer, and counts one that has waited; with interrupts off. */
static void overflow_on(void) {
    if (TIMSK1 & _BV(TOIE1))
        return;
    if (TIFR1 & _BV(TOV1)) {
        TIFR1 = _BV(TOV1);
        avr_clock_overflows++;
    }
    TIMSK1 |= _BV(TOIE1);
}

void usb_frame_started(void) {
    const uint16_t ticks = TCNT1;
    uint16_t overflows = (uint16_t)avr_clock_overflows;
    if ((TIFR1 & _BV(TOV1)) && ticks < 0x8000) /* wrapped, but its interrupt has not run yet */
        overflows++;
    UDINT = (uint8_t)~_BV(SOFI);
    if (UDMFN & _BV(FNCERR))
        return;
    last.ticks = ticks;
    last.overflows = overflows;
    last.number = UDFNUM;
    last.is_known = true;
    overflow_on();
}

/* Before an action at a time, an interrupt waits that would come between the end of the wait and the action on one
 * board and not on the others. A start of frame may be lost, as others are: until the next turn of the main loop. The
 * overflow of the timer must not be, however long the action takes: it waits for the next start of frame, and counts
 * meanwhile as j2a_port_time_us() has it. */
void usb_quiet(uint16_t due) {
    enum { BEFORE = 20 * TICKS_PER_US, BEHIND = 32 * TICKS_PER_US };
    if (last.is_known && (uint16_t)(due + BEHIND) < BEFORE + BEHIND)
        TIMSK1 &= (uint8_t)~_BV(TOIE1);
    else
        UDIEN &= (uint8_t)~_BV(SOFE);
}

static void frames_on(void) {
    overflow_on();
    if ((UDIEN & _BV(SOFE)) || (usb_trouble & USB_SUSPENDED))
        return;
    UDINT = (uint8_t)~_BV(SOFI); /* nobody knows how long ago it was */
    UDIEN |= _BV(SOFE);
}

/* Returns the ticks from that start until now; with interrupts off. */
static uint32_t age(uint32_t *started) {
    const uint16_t ticks = TCNT1;
    uint16_t overflows = (uint16_t)avr_clock_overflows;
    if ((TIFR1 & _BV(TOV1)) && ticks < 0x8000)
        overflows++;
    *started = (uint32_t)last.overflows << 16 | last.ticks;
    return ((uint32_t)overflows << 16 | ticks) - *started;
}

bool j2a_port_frame(j2a_frame *frame) {
    uint32_t started;
    bool is_known;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        frames_on();
        if (age(&started) > OLD_TICKS)
            last.is_known = false;
        is_known = last.is_known;
        frame->number = last.number;
    }
    frame->began = started * (16 / TICKS_PER_US);
    return is_known;
}

const uint8_t *usb_frame_answer(uint8_t value, uint8_t value_high) {
    static uint8_t answer[J2A_SYNCUSB_SEEN_SIZE];
    uint32_t started;
    uint32_t passed = age(&started);
    uint16_t number = last.number;
    if (!last.is_known || passed > OLD_TICKS) {
        number = J2A_CLOCK_NO_FRAME;
        passed = 0;
    }
    passed /= TICKS_PER_US;
    answer[0] = value;
    answer[1] = value_high;
    j2a_put_u16(answer + 2, number);
    j2a_put_u16(answer + 4, (uint16_t)(passed < 0xFFFF ? passed : 0xFFFF));
    return answer;
}

#endif

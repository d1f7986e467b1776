/* See twi.h. */
#include "twi.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/twi.h>

#include "pins.h"

#ifdef TWI_PULL_UPS
#define BIT_RATE 100000

static volatile uint8_t state = TWI_DONE;
static struct {
    uint8_t *bytes;
    uint8_t address; /* with the direction, as on the wire */
    uint8_t at, writes, reads;
} now;

#define CONTROL (_BV(TWEN) | _BV(TWIE) | _BV(TWINT))

static inline void finish(uint8_t result) {
    TWCR = _BV(TWEN) | _BV(TWINT) | _BV(TWSTO);
    state = result;
}

/* Each interrupt is one step of a transfer, which the status names. */
ISR(TWI_vect) {
    switch (TW_STATUS) {
    case TW_START:
    case TW_REP_START:
        now.at = 0;
        TWDR = now.address;
        TWCR = CONTROL;
        break;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
        if (now.at < now.writes) {
            TWDR = now.bytes[now.at++];
            TWCR = CONTROL;
        } else if (now.reads != 0) {
            now.address |= TW_READ;
            TWCR = CONTROL | _BV(TWSTA);
        } else {
            finish(TWI_DONE);
        }
        break;
    case TW_MR_DATA_ACK:
        now.bytes[now.at++] = TWDR;
        /* fall through */
    case TW_MR_SLA_ACK: /* the last byte is not acknowledged */
        TWCR = now.at + 1 < now.reads ? CONTROL | _BV(TWEA) : CONTROL;
        break;
    case TW_MR_DATA_NACK:
        now.bytes[now.at] = TWDR;
        finish(TWI_DONE);
        break;
    default: /* nobody acknowledges, or another master or a fault is on the bus */
        finish(TWI_FAILED);
    }
}

void twi_init(void) {
    TWI_PORT |= TWI_PULL_UPS;
    TWBR = (F_CPU / BIT_RATE - 16) / 2;
    TWSR = 0;
    TWCR = _BV(TWEN);
}

void twi_transfer(uint8_t address, uint8_t *bytes, uint8_t writes, uint8_t reads) {
    if (state == TWI_BUSY)
        return;
    now.bytes = bytes;
    now.writes = writes;
    now.reads = reads;
    now.address = (uint8_t)(address << 1 | (writes == 0 ? TW_READ : TW_WRITE));
    state = TWI_BUSY;
    TWCR = CONTROL | _BV(TWSTA) | (TWCR & _BV(TWSTO)); /* behind a stop that is still on its way */
}

uint8_t twi_state(void) {
    return state;
}

void twi_stop(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        TWCR = 0; /* lets go of the wires, and forgets what it was doing */
        TWCR = _BV(TWEN);
        if (state == TWI_BUSY)
            state = TWI_FAILED;
    }
}
#else
void twi_init(void) {
}

void twi_transfer(uint8_t address, uint8_t *bytes, uint8_t writes, uint8_t reads) {
    (void)address;
    (void)bytes;
    (void)writes;
    (void)reads;
}

uint8_t twi_state(void) {
    return TWI_FAILED;
}

void twi_stop(void) {
}
#endif

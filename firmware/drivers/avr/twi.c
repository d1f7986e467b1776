/* See twi.h. */
#include "twi.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/twi.h>

#include "pins.h"

#ifdef TWI_PULL_UPS
#define BIT_RATE 100000

static volatile uint8_t state = TWI_DONE;
static uint8_t *bytes;
static uint8_t address; /* with the direction, as on the wire */
static uint8_t at, writes, reads;

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
        at = 0;
        TWDR = address;
        TWCR = CONTROL;
        break;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
        if (at < writes) {
            TWDR = bytes[at++];
            TWCR = CONTROL;
        } else if (reads != 0) {
            address |= TW_READ;
            TWCR = CONTROL | _BV(TWSTA);
        } else {
            finish(TWI_DONE);
        }
        break;
    case TW_MR_DATA_ACK:
        bytes[at++] = TWDR;
        /* fall through */
    case TW_MR_SLA_ACK: /* the last byte is not acknowledged */
        TWCR = at + 1 < reads ? CONTROL | _BV(TWEA) : CONTROL;
        break;
    case TW_MR_DATA_NACK:
        bytes[at] = TWDR;
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

void twi_transfer(uint8_t to, uint8_t *new_bytes, uint8_t new_writes, uint8_t new_reads) {
    if (state == TWI_BUSY)
        return;
    bytes = new_bytes;
    writes = new_writes;
    reads = new_reads;
    address = (uint8_t)(to << 1 | (new_writes == 0 ? TW_READ : TW_WRITE));
    state = TWI_BUSY;
    TWCR = CONTROL | _BV(TWSTA);
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

void twi_transfer(uint8_t to, uint8_t *new_bytes, uint8_t new_writes, uint8_t new_reads) {
    (void)to;
    (void)new_bytes;
    (void)new_writes;
    (void)new_reads;
}

uint8_t twi_state(void) {
    return TWI_FAILED;
}

void twi_stop(void) {
}
#endif

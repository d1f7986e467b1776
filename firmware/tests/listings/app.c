/* A device written against the thesis: its function types (listing 7.1), jump table (listing 7.2)
 * and properties (listing 7.4) as they are printed, and the main loop that it describes. OWN_TABLE: a
 * table with a function of the other kind, an alias, and the misprint of listing 7.3. */
#include "a2j.h"

#include "listing-7.1.h"

uint8_t getTime(uint8_t *const lenp, uint8_t* *const datap);
uint8_t setTrigger(uint8_t *const lenp, uint8_t* *const datap);
uint8_t a2j_set_servo(uint8_t *const lenp, uint8_t* *const datap);
uint8_t squares(bool* isLastp, bool isWrite, uint32_t *const offsetp, uint8_t *const lenp,
                uint8_t* *const datap);

/* The types are the listing's, or these do not compile. */
CMD_P checked_call = &getTime;
CMD_P_MANY checked_many = &squares;

static uint8_t servo;

uint8_t getTime(uint8_t *const lenp, uint8_t* *const datap) {
    uint64_t us = j2a_port_time_us();
    for (*lenp = 0; *lenp < 8; us >>= 8)
        (*datap)[(*lenp)++] = (uint8_t)us;
    return 0;
}

/* Sends its payload back as a SIF. */
uint8_t setTrigger(uint8_t *const lenp, uint8_t* *const datap) {
    const uint8_t length = *lenp;
    *lenp = 0;
    return a2jSendSif(0x42, length, *datap);
}

/* Replies with the position before, from memory of its own. */
uint8_t a2j_set_servo(uint8_t *const lenp, uint8_t* *const datap) {
    static uint8_t before;
    if (*lenp != 1)
        return 1;
    before = servo;
    servo = **datap;
    *datap = &before;
    return 0;
}

/* 1000 bytes to read: the square of each offset. */
uint8_t squares(bool* isLastp, bool isWrite, uint32_t *const offsetp, uint8_t *const lenp,
                uint8_t* *const datap) {
    uint32_t at = *offsetp;
    *lenp = 0;
    if (isWrite)
        return 0xFF;
    for (; at < 1000 && *lenp < 249; at++)
        (*datap)[(*lenp)++] = (uint8_t)(at * at);
    *isLastp = at >= 1000;
    return 0;
}

#ifdef OWN_TABLE
FUNCMAP(a2j_set_servo, servo)
FUNCMAP(squares, table)
STARTJT
ADDJT(a2j_set_servo)
ADDLJT (squares)
ENDJT
#else
#include "listing-7.2.h"
#endif

#include "listing-7.4.h"

int main(void) {
    a2jInit();
    for (;;) {
        a2jTask();
        a2jProcess();
    }
}

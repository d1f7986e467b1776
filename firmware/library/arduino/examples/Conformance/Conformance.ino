/* The functions that the conformance suite asks for: load this sketch onto a board, and run
 *
 *   j2a-conform run "serial:///dev/ttyACM0?baud=115200&boot=2"
 *
 * It tells whether board, stream and speed go together: what is lost, what is late, what is wrong. */
#include <J2A.h>

const uint8_t PERIODIC = 0x20;
const uint16_t STORE_SIZE = 256;

uint8_t content[STORE_SIZE];
uint16_t used = 0;
uint32_t period_ms = 0;
uint32_t next_ms, counter;

uint16_t get_u16(const uint8_t *bytes) {
  return bytes[0] | (uint16_t)bytes[1] << 8;
}

uint8_t failed(uint8_t *const length) {
  *length = 0;
  return J2A_RET_FAILED;
}

/* 8 bytes of microseconds since the start. */
uint8_t getTime(uint8_t *const length, uint8_t **const payload) {
  const uint64_t now_us = j2a_port_time_us();
  j2a_put_u32(*payload, (uint32_t)now_us);
  j2a_put_u32(*payload + 4, (uint32_t)(now_us >> 32));
  *length = 8;
  return J2A_RET_OK;
}

/* The sum of two numbers of 32 bits. */
uint8_t add(uint8_t *const length, uint8_t **const payload) {
  if (*length != 8)
    return failed(length);
  j2a_put_u32(*payload, j2a_get_u32(*payload) + j2a_get_u32(*payload + 4));
  *length = 4;
  return J2A_RET_OK;
}

/* Keeps what was written last; a write at 0 starts anew, others follow on. */
uint8_t store(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
              uint8_t **const data) {
  if (is_write) {
    if (*offset == 0)
      used = 0;
    if (*offset != used || *length > STORE_SIZE - used)
      return failed(length);
    memcpy(content + used, *data, *length);
    used += *length;
    *length = 0;
    return J2A_RET_OK;
  }
  const uint16_t left = *offset < used ? used - *offset : 0;
  *is_last = left <= J2A_MANY_DATA;
  *length = *is_last ? left : J2A_MANY_DATA;
  if (left != 0)
    *data = content + *offset;
  return J2A_RET_OK;
}

/* Returns the first byte of its payload, and says so in the debug text. */
uint8_t ret(uint8_t *const length, uint8_t **const payload) {
  static const char hex[] = "0123456789ABCDEF";
  char line[] = "ret 0x00\n";
  const uint8_t code = (*payload)[0];
  if (*length == 0)
    return J2A_RET_FAILED;
  line[6] = hex[code >> 4];
  line[7] = hex[code & 15];
  J2A.debug(line);
  *length = 0;
  return code;
}

/* Returns after so many milliseconds. */
uint8_t wait(uint8_t *const length, uint8_t **const payload) {
  if (*length != 2)
    return failed(length);
  delay(get_u16(*payload));
  *length = 0;
  return J2A_RET_OK;
}

/* Sends its payload as a SIF: opcode, payload. */
uint8_t sif(uint8_t *const length, uint8_t **const payload) {
  const uint8_t given = *length;
  if (given == 0)
    return J2A_RET_FAILED;
  *length = 0;
  J2A.sendSif((*payload)[0], *payload + 1, given - 1);
  return J2A_RET_OK;
}

/* From now on a SIF that counts, every so many milliseconds; 0 ends it. */
uint8_t sifPeriod(uint8_t *const length, uint8_t **const payload) {
  if (*length != 2)
    return failed(length);
  period_ms = get_u16(*payload);
  next_ms = millis() + period_ms;
  counter = 0;
  *length = 0;
  return J2A_RET_OK;
}

uint8_t overruns(uint8_t *const length, uint8_t **const payload) {
  const uint16_t count = J2A.overruns();
  (*payload)[0] = count & 0xFF;
  (*payload)[1] = count >> 8;
  *length = 2;
  return J2A_RET_OK;
}

J2A_FUNCTIONS(
  J2A_CALL(getTime, getTime),
  J2A_CALL(add, add),
  J2A_MANY(store, store),
  J2A_CALL(ret, ret),
  J2A_CALL(delay, wait),
  J2A_CALL(sif, sif),
  J2A_CALL(sifPeriod, sifPeriod),
  J2A_CALL(overruns, overruns)
);

#if defined(__AVR__) && !defined(USBCON)
#define ROOM J2A_PROPERTY("j2a.rxbuf", "62")
#else
#define ROOM /* an empty item is none */
#endif

J2A_PROPERTIES(
  J2A_PROPERTY("name", "J2A on Arduino"),
  J2A_PROPERTY("port", J2A_PORT_NAME),
  ROOM
);

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  uint8_t payload[4];
  J2A.task();
  if (period_ms == 0 || (int32_t)(millis() - next_ms) < 0)
    return;
  j2a_put_u32(payload, counter++);
  J2A.sendSif(PERIODIC, payload, sizeof payload);
  next_ms += period_ms;
  if ((int32_t)(millis() - next_ms) >= 0) /* too slow for this period: what was missed is left out */
    next_ms = millis() + period_ms;
}

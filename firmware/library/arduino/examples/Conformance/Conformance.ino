/* The functions that the conformance suite asks for: load this sketch onto a board, and run
 *
 *   j2a-conform run "serial:///dev/ttyACM0?baud=115200&boot=2"
 *
 * It tells whether board, stream and speed go together: what is lost, what is late, what is wrong. */
#include <J2A.h>

const uint16_t STORE_SIZE = 256;

uint8_t content[STORE_SIZE];
uint16_t used = 0;
uint32_t period_ms = 0;
uint32_t next_ms, count;

j2a::sif<0x20, uint32_t> counter;

uint8_t failed(uint8_t *const length) {
  *length = 0;
  return J2A_RET_FAILED;
}

uint64_t getTime() {
  return j2a_port_time_us();
}

int32_t add(int32_t a, int32_t b) {
  return (int32_t)((uint32_t)a + (uint32_t)b);
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
  delay(j2a_get_u16(*payload));
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

void sifPeriod(uint16_t period) {
  period_ms = period;
  next_ms = millis() + period_ms;
  count = 0;
}

uint16_t overruns() {
  return J2A.overruns();
}

int32_t divide(int32_t a, int32_t b) {
  if (b == 0)
    return j2a_fail(1);
  return b == -1 ? (int32_t)-(uint32_t)a : a / b;
}

/* Parameters that the function changes are its results. */
void echoNumbers(bool flag, int8_t small, uint16_t wide, int32_t sum, uint64_t big, bool on,
                 bool &outOn, int64_t &outBig, int64_t &outSum, uint32_t &outWide, int16_t &outSmall, uint8_t &outFlag) {
  outOn = on;
  outBig = (int64_t)big;
  outSum = sum;
  outWide = wide;
  outSmall = small;
  outFlag = flag;
}

J2A_FUNCTIONS(
  J2A_FUNCTION(getTime, "-> us !idempotent: Returns the time since the start."),
  J2A_FUNCTION(add, "a b !idempotent: Adds two numbers."),
  J2A_MANY(store, store),
  J2A_CALL(ret, ret),
  J2A_CALL(delay, wait),
  J2A_CALL(sif, sif),
  J2A_FUNCTION(sifPeriod, "period(ms) !idempotent: Sends the SIF counter periodically; 0 stops it."),
  J2A_FUNCTION(overruns, "!idempotent: Returns how often received bytes were lost since the start."),
  J2A_FUNCTION(divide, "a b !idempotent: Divides; fails with code 1 where b is 0."),
  J2A_FUNCTION(echoNumbers, "flag small wide sum big on on big sum wide small flag !idempotent: "
                            "Returns the numbers as other types."),
  J2A_SIF(counter, "count: Counts from 0 while sifPeriod is not 0.")
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
  J2A.task();
  if (period_ms == 0 || (int32_t)(millis() - next_ms) < 0)
    return;
  counter(count++);
  next_ms += period_ms;
  if ((int32_t)(millis() - next_ms) >= 0) /* too slow for this period: what was missed is left out */
    next_ms = millis() + period_ms;
}

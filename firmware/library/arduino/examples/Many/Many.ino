/* Data longer than a frame: 400 bytes that the host writes and reads as a whole.
 *
 * A function of the kind "many" is called once for each chunk. When the host writes, *length bytes in *data
 * belong at *offset; when it reads, the function gives at most J2A_MANY_DATA bytes from *offset on, and says
 * by *is_last when these were the last. *data may point into the sketch's own memory. */
#include <J2A.h>

const uint16_t SIZE = 400;
uint8_t content[SIZE];
uint16_t used = 0;

uint8_t store(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
              uint8_t **const data) {
  if (is_write) {
    const uint8_t given = *length;
    *length = 0;
    if (*offset > SIZE || given > SIZE - *offset)
      return J2A_RET_FAILED;
    memcpy(content + *offset, *data, given);
    used = *offset + given;
    return J2A_RET_OK;
  }
  const uint16_t left = *offset < used ? used - *offset : 0;
  *is_last = left <= J2A_MANY_DATA;
  *length = *is_last ? left : J2A_MANY_DATA;
  if (left != 0)
    *data = content + *offset;
  return J2A_RET_OK;
}

J2A_FUNCTIONS(
  J2A_MANY(store, store)
);

J2A_PROPERTIES(
  J2A_PROPERTY("name", "Many")
);

void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}

void loop() {
  J2A.task();
}

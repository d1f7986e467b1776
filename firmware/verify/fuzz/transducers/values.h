/* Values of transducers as numbers. */
#ifndef VALUES_H
#define VALUES_H

#include "model.h"

/* Puts a number into the bytes of a value. */
void value_put(const described *d, double value, uint8_t *bytes);

/* Returns whether a sensor with this threshold takes a, where b is the value that it took before. */
bool value_differs(const described *d, const uint8_t *a, const uint8_t *b, const uint8_t *limit);

/* Returns whether a value may be a threshold. */
bool value_is_limit(const described *d, const uint8_t *bytes);

bool value_is_in_range(const described *d, const uint8_t *value);

/* Returns whether bytes may be a topic. */
bool value_is_text(const uint8_t *bytes, size_t length);

#endif

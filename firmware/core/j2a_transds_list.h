/* What transds.def lists, as J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, items ..., "") for each
 * transducer: KIND is SENSOR or ACTUATOR, and an item a key in parentheses or the text. Without a guard: it is included
 * once for each meaning of J2A_TRANSD, J2A_STRUCT and J2A_ENUM. */
#define SENSOR(...) J2A_TRANSD(SENSOR, __VA_ARGS__, "")
#define SENSOR_EX(...) J2A_TRANSD(SENSOR, __VA_ARGS__, "")
#define ACTUATOR(...) J2A_TRANSD(ACTUATOR, __VA_ARGS__, "")
#include "transds.def"
#ifdef SENSORS
SENSORS
#undef SENSORS
#endif
#undef SENSOR
#undef SENSOR_EX
#undef ACTUATOR

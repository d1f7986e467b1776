/* Declares the functions that the application lists in its functions.def, so that the compiler
 * compares their types with the kinds given there. Lines of functions.def:
 *   J2A_CALL(name on the wire, C function)     J2A_MANY(name on the wire, C function) */
#ifndef J2A_FUNCTIONS_H
#define J2A_FUNCTIONS_H

#include "j2a.h"

#ifdef __cplusplus
extern "C" {
#endif

#define J2A_CALL(name, function) J2A_DECLARE_CALL(function);
#define J2A_MANY(name, function) J2A_DECLARE_MANY(function);
#include "functions.def"
#undef J2A_CALL
#undef J2A_MANY

#ifdef __cplusplus
}
#endif

#endif

/** Header for the properties. Needs to be called first.*/
#define STARTPROPS unsigned char const PROGMEM a2j_props[] = {
/** Adds a mapping from \a key to \a value. */
#define ADDPROP(key, value) #key "\0" #value "\0"
#define STRFY(x) #x
/** Adds a mapping from \a key to the stringified version of \a value. */
#define ADDPROPEXP(key,value) #key "\0" STRFY(value) "\0"
/** Finalizes the properties. */
#define ENDPROPS }; const uint8_t a2j_props_size = sizeof(a2j_props) - 1;

/* Example */
#define MACRO 13
STARTPROPS
ADDPROP(serial, 0x012F0B04) /* "serial" -> "0x012F0B04" */
ADDPROPEXP (MACRO, MACRO) /* "MACRO" -> "13" */
ENDPROPS

typedef uint8_t (*const CMD_P) (uint8_t *const lenp, uint8_t* *const datap);
typedef uint8_t (*const CMD_P_MANY) (bool* isLastp, bool isWrite, uint32_t *const offsetp, uint8_t *const lenp, uint8_t* *const datap);

/* Function mapping */
FUNCMAP(getTime, getTime)
FUNCMAP(setTrigger, setTrigger)
FUNCMAP(a2j_set_servo, a2j_set_servo)

/* Jump table */
STARTJ
ADDJT(getTime)
ADDJT(setTrigger)
ADDJT(a2j_set_servo)
ENDJT

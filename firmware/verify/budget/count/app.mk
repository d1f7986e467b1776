# Counts itself, see app.c; without functions of its own, and with nothing that a counted byte does not need.
OWN_MAIN := 1
APP_OPTIONS := -DJ2A_WITH_DEBUG=0

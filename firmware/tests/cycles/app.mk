# Measures itself (see app.c), with the size budget's options.
OWN_MAIN := 1
APP_OPTIONS := -DJ2A_WITH_DEBUG=0

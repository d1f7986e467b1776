# The stand-in for the wheel uses more of the system than C99 has.
APP_OPTIONS := -D_XOPEN_SOURCE=600

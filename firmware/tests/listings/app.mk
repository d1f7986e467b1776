OWN_MAIN := 1
# Listing 7.1 declares types that a2j.h has declared.
APP_OPTIONS := -std=gnu11

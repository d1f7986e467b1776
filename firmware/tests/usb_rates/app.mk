# Its own main loop, with marks or without; no debug text, as in the size budget.
OWN_MAIN := 1
APP_OPTIONS := -DJ2A_WITH_DEBUG=0 -DRATES_MARKS=0

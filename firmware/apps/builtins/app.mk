# All built-ins but debug: the firmware whose size has a budget.
APP_OPTIONS := -DJ2A_WITH_DEBUG=0

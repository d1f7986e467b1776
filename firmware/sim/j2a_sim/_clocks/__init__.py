"""`j2a sim clocks`: how well the clocks of boards agree, in exact simulated time.

In: settings with a named seed. Out: figures, a table, plots.
Rules: one truth for all; nothing here reads a clock or waits; the same settings give the same run.
"""

# Where what is:
#   settings           what a run is told
#   truth, frames      crystals, the host's clock; starts of frames, hubs, losses
#   delays, *.json     delays as quantiles; those of a host are recorded by record.py
#   native.c, native   boards whose firmware is compiled for this machine: hours in minutes
#   avr                boards in simavr: the real firmware, cycle by cycle
#   host               the program on the host: the library's estimator
#   usb_host           the daemon syncd, which gives boards on a USB the time
#   run, report, plot  a run; its figures with their bounds; pictures

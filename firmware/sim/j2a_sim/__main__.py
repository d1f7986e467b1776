"""`python -m j2a_sim avr ELF`: the simulator without the rest of the command line."""

from __future__ import annotations

import argparse
import sys

from j2a_sim._command import add_arguments, run

parser = argparse.ArgumentParser(prog="python -m j2a_sim", description="Simulated devices.")
add_arguments(parser)
sys.exit(run(parser.parse_args()))

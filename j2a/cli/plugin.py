"""What a command of another package may use of `j2a`, so that it speaks as the built-in ones do.

What flows out: exit codes and the errors that lead to them; arguments that commands share; output;
and values, transducers and files as the built-in commands read and write them.
Rules: all other modules of `j2a.cli` may change without notice; the commands of the simulator and
of the bridge use nothing else of it.
"""

from j2a.cli._descriptors import transducer_facts
from j2a.cli._exit import (
    FAILED,
    INTERRUPTED,
    LINK,
    OK,
    USAGE,
    CommandFailed,
    UsageError,
    ending_signals,
)
from j2a.cli._files import write_files
from j2a.cli._help import open_help
from j2a.cli._link import (
    add_condition_arguments,
    add_json_argument,
    add_link_arguments,
    add_listen_argument,
    check_listen_url,
    connect,
    finite_seconds,
    seconds,
    whole_number,
)
from j2a.cli._output import note, show, show_json
from j2a.cli._progress import Progress
from j2a.cli._transds import read_source
from j2a.cli._typed import json_of, plain, values_of

__all__ = [
    "FAILED",
    "INTERRUPTED",
    "LINK",
    "OK",
    "USAGE",
    "CommandFailed",
    "Progress",
    "UsageError",
    "add_condition_arguments",
    "add_json_argument",
    "add_link_arguments",
    "add_listen_argument",
    "check_listen_url",
    "connect",
    "ending_signals",
    "finite_seconds",
    "json_of",
    "note",
    "open_help",
    "plain",
    "read_source",
    "seconds",
    "show",
    "show_json",
    "transducer_facts",
    "values_of",
    "whole_number",
    "write_files",
]

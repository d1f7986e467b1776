"""A child process that joins its standard input and output with a TCP port: relay.py PORT."""

import sys
import threading

import j2a_transports
from j2a_transports import Transport, TransportError


def carry(source: Transport, sink: Transport) -> None:
    try:
        while True:
            sink.write(source.read(None))
    except TransportError:
        source.close()
        sink.close()


with (
    j2a_transports.open("stdio:", write_timeout="none") as stdio,
    j2a_transports.open(f"tcp://127.0.0.1:{sys.argv[1]}", write_timeout="none") as tcp,
):
    print("a stray print does not get into the stream", file=sys.stdout)
    back = threading.Thread(target=carry, args=(tcp, stdio))
    back.start()
    carry(stdio, tcp)
    back.join()

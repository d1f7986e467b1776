"""As relay.py, by the system alone: where the near end is what is tried, it starts in no time."""

import os
import socket
import sys
import threading

if os.isatty(0):
    import tty

    tty.setraw(0)


def carry_back(tcp: socket.socket) -> None:
    try:
        while data := tcp.recv(65536):
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
    finally:
        os._exit(0)  # the other thread may wait for ever


with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as tcp:
    back = threading.Thread(target=carry_back, args=(tcp,))
    back.start()
    try:
        while data := os.read(0, 65536):
            tcp.sendall(data)
        tcp.shutdown(socket.SHUT_RDWR)
    except OSError:
        os._exit(0)
    back.join()

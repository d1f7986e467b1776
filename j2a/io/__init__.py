"""The protocol over a link: threads, event loops and clocks around `j2a.protocol`.

The public names are those of `j2a`.

    opening                    opens transports, and turns their errors into those of `j2a`
    threads                    the threads that read and write a transport
    client_base                what both clients have in common
    blocking, loop             how the blocking client waits, and the one in an event loop
    handlers                   who wants which SIF
    connection, functions      a device's link to a host, and the functions of a device
"""

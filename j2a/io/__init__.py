"""The protocol over a link: threads, event loops and clocks around `j2a.protocol`.

The public names are those of `j2a`.

    opening                    opens transports, and turns their errors into those of `j2a`
    threads                    the threads that read and write a transport
    client_base, engine_base   what both clients have in common, and their engines
    blocking, loop             how the blocking client waits, and the one in an event loop
    remote                     the functions of a device, as a host calls them
    handlers                   who wants which SIF
    streams, async_streams     SIFs as iterators
    connection, functions      a device's link to a host, and the functions of a device
    registration, typed        how functions of Python become those
"""

"""The protocol without the link: bytes and the time in, events and bytes out.

Nothing here reads a clock, starts a thread or opens anything; what knows time and threads is
`j2a.io`. The public names are those of `j2a`.

    codec, deframer            frames to wire bytes, and back
    session, calls             a host's side of a link
    server                     a device's side of a link
    transfer                   data of any size, in chunks (a2jMany)
    device_info, announced     what a host knows of its device
    arguments, limits, trace   checks of arguments, time limits of work of several calls, traces
"""

"""The daemon `j2a syncd`, which gives the boards of this computer one time (thesis section 6.2).

`singleton` is the socket by which there is one daemon and by which others ask it, `daemon` its main
loop, `board` the thread of a board with SyncUSB, `history` what it remembers for `j2a sync`,
`plot` draws that, and `realtime` asks the system for punctuality.
"""

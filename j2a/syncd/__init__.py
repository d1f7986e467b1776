"""The daemon `j2a syncd`, which gives the boards of this computer one time (thesis section 6.2).

daemon        the main loop
singleton     the socket by which there is one daemon and by which others ask it
sync_board    the thread of a board with SyncUSB
usb_bus       the frames of its bus
url_boards    the boards whose URLs were given
history       what it remembers for `j2a sync`, and `plot` draws that
system        the rule of udev and the unit of systemd that start it
realtime      asks the system for punctuality
"""

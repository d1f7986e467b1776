"""The USB of a simulated chip, and the ways to it: by hand, as a transport, by pyusb."""

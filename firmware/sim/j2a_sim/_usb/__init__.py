"""The ways to a simulated board on the USB: as a transport, by pyusb."""

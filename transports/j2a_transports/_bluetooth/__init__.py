"""RFCOMM, the serial port of Bluetooth; `link` serves the URLs."""

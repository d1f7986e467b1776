"""J2A boards on the USB, through pyusb; `link` serves the URLs."""

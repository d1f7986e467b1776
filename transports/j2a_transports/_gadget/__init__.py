"""This computer as a USB board, over FunctionFS; `gadget` serves the URLs."""

"""Simulated boards for operating systems, over USB/IP."""

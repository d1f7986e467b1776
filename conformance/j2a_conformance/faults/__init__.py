"""Devices behind links that damage bytes: what gets through, what it costs, and what is wrong.

What flows in: a way to open the link, kinds of fault and their rates, a seed. What flows out:
counts with their theory, and where the device was wrong the shortest bytes that show it. Rules:
the expected replies to any bytes come from the oracle (`_rules.py`), and so does the theory
(`_theory.py`); a device is wrong only where it is wrong again after a fresh start (`_player.py`).
"""

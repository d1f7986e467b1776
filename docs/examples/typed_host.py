"""Calls the functions of typed_device.py. Takes its URL."""

import sys

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

with j2a.connect(sys.argv[1]) as board:
    print(board.functions.add(40, 2))
    print(board.functions["measure"].signature)

    with board.sifs("gust") as gusts:
        reading = board.functions.measure("slow", place=(48.0, 11.0))
        print(reading.temperature, reading.raw, gusts.wait(timeout=1).values)

    try:
        board.functions.measure("off", (0, 0))
    except j2a.FunctionFailed as error:
        print("failed with code", error.code)
    try:
        board.functions.add(2**31, 1)
    except j2a.WrongArgument as error:
        print(error)

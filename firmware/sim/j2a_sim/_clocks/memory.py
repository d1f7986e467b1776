import typing


class ClockMemory:
    def __init__(self, sim: typing.Any) -> None: ...
    def read(self, cycle: float) -> tuple[int, int, int, int]:
        return (0, 0, 0, 0)

"""An upper bound for the stack of a program, from what GCC 10 and newer tell about each function.

In: the folder of the objects, compiled with -fcallgraph-info=su, and the functions of the app.
Out: the bytes along the deepest chain of calls from main, and of the deepest interrupt on top of
it.
Rules: a call through a pointer is one to a function of J2A's table: from j2a_many of kind many,
else of kind call. Whatever nobody calls counts as an interrupt handler; interrupts do not
interrupt each other. Of a function without figures (the C library's) `external` bytes are assumed.
Recursion and frames without limit are refused.
Not covered: assembler, which has a frame of its own for interrupts (`frame`).
"""

import re
from dataclasses import dataclass
from pathlib import Path

from firmware.verify.budget.builds import BudgetError

__all__ = ["callgraph_bound"]

_NODE = re.compile(r'^node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes \((\w+)[^)]*\)')
_EDGE = re.compile(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')
_FUNCTION = re.compile(r"^J2A_(CALL|MANY)\(\s*\w+\s*,\s*(\w+)\s*\)", re.MULTILINE)
_INDIRECT = "__indirect_call"
_BUILTIN = {
    "CALL": {"j2a_get_mapping", "j2a_many", "j2a_get_debug", "j2a_echo"},
    "MANY": {"j2a_get_properties", "j2a_echo_many"},
}


@dataclass(slots=True)
class _Graph:
    """Bytes of each function, and whom it calls."""

    frames: dict[str, int]
    calls: dict[str, set[str]]
    external: int

    def depth(self, name: str, above: tuple[str, ...] = ()) -> int:
        """The most bytes from this function downwards, its own included."""
        if name in above:
            raise BudgetError(f"no bound for the stack: {' calls '.join((*above, name))}")
        if name not in self.frames:
            return self.external
        below = (self.depth(callee, (*above, name)) for callee in self.calls.get(name, ()))
        return self.frames[name] + max(below, default=0)


def _read(objects: Path, external: int) -> _Graph:
    graph = _Graph({}, {}, external)
    files = sorted(objects.glob("*.ci"))
    if not files:
        raise BudgetError(f"no *.ci in {objects}: the compiler has no -fcallgraph-info (GCC 10)")
    for path in files:
        for line in path.read_text().splitlines():
            if node := _NODE.match(line):
                if node[3] not in {"static", "dynamic,bounded"}:
                    raise BudgetError(
                        f"no bound for the stack: the frame of {node[1]} is {node[3]}"
                    )
                graph.frames[node[1]] = int(node[2])
            elif edge := _EDGE.match(line):
                graph.calls.setdefault(edge[1], set()).add(edge[2])
    return graph


def callgraph_bound(objects: Path, functions: Path, frame: int, external: int) -> int:
    """The bound in bytes.

    Args:
        objects: folder with the *.ci files.
        functions: the app's functions.def.
        frame: bytes that the processor, or the assembler around handlers, saves for an interrupt.
        external: bytes assumed for a function of which nothing is known.

    Raises:
        BudgetError: the program does something of which no bound can be told.
    """
    graph = _read(objects, external)
    kinds = {kind: set(names) for kind, names in _BUILTIN.items()}
    for kind, name in _FUNCTION.findall(functions.read_text()):
        kinds[kind].add(name)
    for caller, callees in graph.calls.items():
        if _INDIRECT in callees:
            callees.discard(_INDIRECT)
            kind = "MANY" if caller == "j2a_many" else "CALL"
            callees.update(kinds[kind] & graph.frames.keys())
    called = set().union(*graph.calls.values(), *kinds.values())
    handlers = graph.frames.keys() - called - {"main", "cortex_m_reset"}
    interrupt = frame + max(map(graph.depth, handlers), default=0)
    start = "cortex_m_reset" if "cortex_m_reset" in graph.frames else "main"
    return graph.depth(start) + interrupt

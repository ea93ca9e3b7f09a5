"""What the innermost loops of a compiled program contain, read from its text."""

import re
from typing import NamedTuple

import jax

_OPERATION = re.compile(
    r" (fusion|call|while|copy|gather|sort|scatter|dynamic-update-slice|dynamic-slice|reduce|"
    r"conditional|concatenate)\("
)


class Loop(NamedTuple):
    """One innermost loop, with the calls inside.

    - `most_operations`: greatest number of operations of the loop's body or of a call.
    - `cut`: operations that are cut into parts for several threads.
    """

    most_operations: int
    cut: list[str]


def innermost_loops(program: jax.stages.Compiled, scope: str) -> list[Loop]:
    """Find the loops in the scope of a name that contain no other loops."""
    text = program.as_text()
    assert text is not None
    bodies = {}
    for part in text.split("\n\n"):
        first, *lines = part.strip().split("\n")
        match = re.match(r"(?:ENTRY )?%?([\w.\-]+) ", first)
        if match and first.rstrip().endswith("{"):
            bodies[match[1]] = [line.strip() for line in lines if _OPERATION.search(line)]
    loops = []
    for lines in bodies.values():
        for line in lines:
            if " while(" in line and scope in line:
                body = re.search(r"body=%?([\w.\-]+)", line)
                assert body is not None
                loop = _describe(bodies, body[1])
                loops += [] if loop is None else [loop]
    return loops


def _describe(bodies: dict[str, list[str]], name: str) -> Loop | None:
    """Describe the loop with this body, unless it contains another loop."""
    lines = bodies.get(name, [])
    if any(" while(" in line for line in lines):
        return None
    most, cut = len(lines), [line for line in lines if '"outer_dimension_partitions":["' in line]
    for line in lines:
        for called in re.findall(r"to_apply=%?([\w.\-]+)", line):
            inner = _describe(bodies, called)
            if inner is not None:
                most, cut = max(most, inner.most_operations), cut + inner.cut
    return Loop(most, cut)

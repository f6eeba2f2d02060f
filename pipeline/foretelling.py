"""What a run is about to do that a person may not expect, told before hours go into it.

After a new version of this program all that only has other code is done again, which gives other bits, and other keys
to what is made of them. Only before that can the earlier results be kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pipeline.accept import is_acceptable
from pipeline.graph import Graph
from pipeline.loss import NOT_READ, is_read
from pipeline.plan import Step

SHOWN = 4  # names of stages


def foretold(graph: Graph, steps: Mapping[str, Step]) -> Iterator[str]:
    """What a run of these steps would do again for nothing but other code, and what it may make another one of."""
    code = [name for name, step in steps.items() if is_acceptable(step) and step.state != "refused"]
    if code:
        kept = f"to keep what was made before, stop this run and `accept` it ({code[0]} first), with the same settings"
        yield f"only code changed: {_names(code)}, done again; {kept}"
    unrepeatable = [name for name, node in graph.nodes.items() if node.unrepeatable and is_read(name, graph)]
    waiting = [name for name in unrepeatable if steps[name].state == "depends"]
    if waiting:
        yield f"{_names(waiting)}: made anew if what is before it comes out differently; {NOT_READ}"


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"

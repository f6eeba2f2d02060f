"""What a person is told of a result that is the only one of its kind.

Where it is damaged, a run makes no other in its place by itself. Where what it depends on changed, the run needs
another one, and what was made with the earlier one is strange to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from pipeline.errors import RemoteError, UserError
from pipeline.graph import Graph, Node
from pipeline.store import Store

SHOWN = 8  # names of stages
NOT_READ = "what was made, or published, with the earlier one is not read with this one"


def words_of_loss(name: str, remains: Sequence[str], graph: Graph, store: Store) -> str:
    """The error of a stage whose result is damaged or gone and cannot be made again, with what is made from it."""
    behind = _behind(name, graph)
    more = f" and {len(behind) - SHOWN} more" if len(behind) > SHOWN else ""
    nothing = "nothing in this workflow" if graph.whole else "nothing in this part of the workflow"
    depending = f"{', '.join(behind[:SHOWN])}{more}" if behind else nothing
    error = UserError(
        f"the result of {name} is damaged or gone, and no run can make the same again; made from it: {depending}",
        where=store.address,
        remedy=f"Put it back from a copy of the store; what is damaged is in {store.damaged.folder}. To give it up on "
        f"purpose, delete {' and '.join(remains)}: the next run makes another, and anew what is made from it.",
    )
    return str(error)


def words_of_another(node: Node, key: str, graph: Graph, store: Store) -> str | None:
    """That a stage makes another than the last time; None where it made none, or the same action made it."""
    last = None
    with suppress(RemoteError, OSError):  # a bucket that cannot be reached just now must not end the run
        last = store.history.last(graph.workflow, [node.name])[node.name].made
    if last is None or last.key == key:
        return None
    return f"{node.name} is made anew, for what it depends on is not as it was; {NOT_READ}"


def _behind(name: str, graph: Graph) -> list[str]:
    """All nodes that are made from a node, in order."""
    found = [name]
    for other, node in graph.nodes.items():
        if not set(found).isdisjoint(node.upstream):
            found.append(other)
    return found[1:]

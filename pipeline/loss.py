"""What a person is told when the only one of something is damaged: a run makes no other in its place by itself."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.errors import UserError
from pipeline.graph import Graph
from pipeline.store import Store

SHOWN = 8  # names of stages


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


def _behind(name: str, graph: Graph) -> list[str]:
    """All nodes that are made from a node, in order."""
    found = [name]
    for other, node in graph.nodes.items():
        if not set(found).isdisjoint(node.upstream):
            found.append(other)
    return found[1:]

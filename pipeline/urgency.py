"""What is done first of all that could be done now."""

from __future__ import annotations

from pipeline.graph import Graph


def urgencies(graph: Graph) -> dict[str, int]:
    """For each node a number, the larger the sooner: final nodes, then what only these wait for, then all others.

    So what closes a row, such as its scores, is done before the next row's training begins, and a run that is stopped
    has been of use. Among equals the order of the graph counts.
    """
    final, dependents = set(graph.final), graph.dependents

    def rank(name: str) -> int:
        return 0 if name in final else 1 if final.issuperset(dependents[name]) else 2

    return {name: -place for place, name in enumerate(sorted(graph.nodes, key=rank))}

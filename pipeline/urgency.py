"""What is done first of all that could be done now."""

from __future__ import annotations

from pipeline.graph import Graph


def urgencies(graph: Graph) -> dict[str, int]:
    """For each node a number, the larger the sooner: what has no input, final nodes, what they alone wait for, others.

    So every file from outside is read, and found to be no photo, before anything that takes long; and what closes a
    row, such as its scores, is done before the next row's training begins, so that a run that is stopped has been of
    use. Among equals the order of the graph counts.
    """
    final, dependents = set(graph.final), graph.dependents

    def rank(name: str) -> int:
        if not graph.nodes[name].upstream:
            return 0
        return 1 if name in final else 2 if final.issuperset(dependents[name]) else 3

    return {name: -place for place, name in enumerate(sorted(graph.nodes, key=rank))}

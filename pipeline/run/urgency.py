"""Which of the stages that could start now starts first."""

from __future__ import annotations

from pipeline.workflow.graph import Graph


def urgencies(graph: Graph) -> dict[str, int]:
    """A number for each node; higher ones start first.

    First come nodes without inputs, then final nodes, nodes that only final ones wait for, and all others; among equals
    the order of the graph counts. So every external file is read, and any that is not a photo is found, before anything
    that takes long. And what completes a row, such as its scores, is done before the training of the next row begins,
    so that even a run that is stopped has been of use.
    """
    final, dependents = set(graph.final), graph.dependents

    def rank(name: str) -> int:
        if not graph.nodes[name].upstream:
            return 0
        return 1 if name in final else 2 if final.issuperset(dependents[name]) else 3

    return {name: -place for place, name in enumerate(sorted(graph.nodes, key=rank))}

"""What a person is told about a result that is the only one of its kind.

If it is damaged, or only the code that made it has changed, no run replaces it by itself. If what it depends on has
changed, the run needs another one, with which nothing that was made with the earlier one can be read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

from pipeline.canonical import Json
from pipeline.errors import RemoteError, UserError
from pipeline.plain_text import listed
from pipeline.plan.keys import asks_the_same
from pipeline.store.history import StageResult
from pipeline.store.record import Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Graph, Node

SHOWN = 8  # names of stages
NOT_READ = "a new one cannot read what was made or published with the earlier one"


def refusal(
    node: Node, key: str, parts: Mapping[str, Json], before: Record | None, graph: Graph, store: Store
) -> str | None:
    """Why a run may not start a stage that is not done under this key; None if it may. For `before`, see `Kindred`."""
    if not node.unrepeatable:
        return None
    remains = store.remains(key)
    if remains:
        return words_of_loss(node.name, remains, graph, store)
    return words_of_keeping(node, key, parts, before, store)


def words_of_loss(name: str, remains: Sequence[str], graph: Graph, store: Store) -> str:
    """The error for a stage whose result is damaged or gone and cannot be made again.

    It names what is made from it, and the results of these that are still in the store: whoever lost the key has not
    lost what was made with it.
    """
    behind = _behind(name, graph)
    nothing = "nothing in this workflow" if graph.whole else "nothing in this part of the workflow"
    depending = listed(behind, SHOWN) if behind else nothing
    there = _still_there(behind, graph.workflow, store)
    error = UserError(
        f"the result of {name} is damaged or missing, and no run can make the same one; made from it: {depending}",
        where=store.address,
        found=f"these of earlier runs are still there: {listed(there, SHOWN)}; `export` takes their digests"
        if there
        else None,
        remedy=f"Restore it from a copy of the store; the damaged data is in {store.damaged.folder}. To give it up on "
        f"purpose, delete {' and '.join(remains)}: the next run makes a new one, and everything made from it again.",
    )
    return str(error)


def _still_there(stages: Sequence[str], workflow: str, store: Store) -> list[str]:
    """The last results of these stages that the store still holds, by name and digest; the last stage's come first."""
    with suppress(RemoteError, OSError):
        last, objects = store.history.last(workflow, stages), store.objects
        made = [(name, last[name].made) for name in reversed(stages)]
        outputs = [(name, *output) for name, result in made if result for output in result.outputs.items()]
        return [f"{name}.{output} ({digest[:12]})" for name, output, digest in outputs if digest in objects]
    return []


def words_of_another(node: Node, key: str, last: StageResult | None, graph: Graph) -> str | None:
    """That a stage makes another result than last time; None if it made none, by the same action, or if nobody reads
    it.
    """
    if last is None or last.key == key or not is_read(node.name, graph):
        return None
    return f"{node.name} is made anew because what it depends on has changed; {NOT_READ}"


def is_read(name: str, graph: Graph) -> bool:
    """Whether a stage reads what a node makes, as far as the graph shows; a person may read what no stage takes."""
    takers = [graph.nodes[other] for other in graph.dependents[name]]
    return not takers or any(_reads(taker, name) for taker in takers)


def _reads(taker: Node, name: str) -> bool:
    """Whether a node, with its parameters, reads anything that it takes from the node `name`."""
    taken = [port for port, sources in taker.sources.items() if name in {source.node for source in sources}]
    return any(not _is_unread(taker, port) for port in taken)


def _is_unread(node: Node, port: str) -> bool:
    values = node.declaration.unread.get(port)
    return values is not None and all(node.parameters.get(name) == value for name, value in values.items())


def words_of_keeping(
    node: Node, key: str, parts: Mapping[str, Json], before: Record | None, store: Store
) -> str | None:
    """The error for a stage if an earlier result, which cannot be made again, differs from it only in its code.

    None if there is no such result.
    """
    if before is None or before.key == key or not asks_the_same(before.parts, parts):
        return None
    error = UserError(
        f"only the code of {node.name} changed, and no run can make its result again; a new one could not read what "
        "was made or published with it",
        where=store.address,
        remedy=f"To keep it, `accept` {node.name} with the workflow and the settings of this run. To make a new one on "
        f"purpose, delete {' and '.join(store.remains(before.key))}.",
    )
    return str(error)


def last_of_their_kind(graph: Graph, store: Store) -> dict[str, StageResult | None]:
    """The last results of the stages whose results no run can make again; empty if a bucket cannot be reached now."""
    names = [name for name, node in graph.nodes.items() if node.unrepeatable]
    if not names:
        return {}
    with suppress(RemoteError, OSError):  # a bucket that cannot be reached just now must not end the run
        return {name: last.made for name, last in store.history.last(graph.workflow, names).items()}
    return {}


def _behind(name: str, graph: Graph) -> list[str]:
    """All nodes that are made from a node, directly or not, in order."""
    found = [name]
    for other, node in graph.nodes.items():
        if not set(found).isdisjoint(node.upstream):
            found.append(other)
    return found[1:]

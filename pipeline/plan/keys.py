"""Keys of actions: the parts of each, and their hash."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.canonical import Json, digest_of
from pipeline.workflow.graph import Node, Source

FORMAT = 2

ACCEPTABLE = ("code", "version", "format")
"""Parts of a key that say how something is made, not what was asked for: see `accept`."""


def key_parts(
    node: Node, digests: Mapping[Source, str | None], causes: Mapping[str, str] | None = None
) -> dict[str, Json]:
    """Everything that the result of a node depends on; None stands for an input that is not made yet.

    `causes` says why nodes failed. It is part of the key of a node with labelled inputs, which is told these causes.
    """
    parts: dict[str, Json] = {
        "format": FORMAT,
        "stage": node.uses,
        "version": node.declaration.version,
        "code": node.code.digest,
        "parameters": dict(node.parameters),
        "external": {name: list(values) for name, values in node.external.items()},
        "inputs": {name: [digests[source] for source in sources] for name, sources in node.sources.items()},
        "private": node.private,
    }
    if node.labels:
        parts["items"] = {
            name: [
                [label.text, dict(label.values), (causes or {}).get(source.node)]
                for label, source in zip(labels, node.sources[name], strict=True)
            ]
            for name, labels in node.labels.items()
        }
    return parts


def key_of(parts: Mapping[str, Json]) -> str:
    """The key of an action: SHA-256 of the canonical JSON of its parts."""
    return digest_of(dict(parts), "the key")


def asks_the_same(parts: Mapping[str, Json], others: Mapping[str, Json]) -> bool:
    """Whether two actions ask for the same, and at most differ in how they make it."""
    return key_of(_asked_for(parts)) == key_of(_asked_for(others))


def _asked_for(parts: Mapping[str, Json]) -> dict[str, Json]:
    return {name: value for name, value in parts.items() if name not in ACCEPTABLE}

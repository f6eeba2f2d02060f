"""What the key of an action is made of."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.canonical import Json, digest_of
from pipeline.graph import Node, Source

FORMAT = 2


def key_parts(node: Node, digests: Mapping[Source, str | None]) -> dict[str, Json]:
    """All that the result of a node depends on; None stands for an input that is not made yet."""
    return {
        "format": FORMAT,
        "stage": node.uses,
        "version": node.declaration.version,
        "code": node.code.digest,
        "parameters": dict(node.parameters),
        "external": {name: list(values) for name, values in node.external.items()},
        "inputs": {name: [digests[source] for source in sources] for name, sources in node.sources.items()},
        "private": node.private,
    }


def key_of(parts: Mapping[str, Json]) -> str:
    """The key of an action: SHA-256 of the canonical JSON of its parts."""
    return digest_of(dict(parts), "the key")

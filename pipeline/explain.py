"""What the key of an action is made of, and in words what changed in it since the last time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.canonical import Json, digest_of
from pipeline.graph import Node, Source

FORMAT = 2
FAILED = "failed"
"""Stands for the digest of an input that failed, where a stage goes on without it."""
SHOWN = 60  # characters of a value


def key_parts(
    node: Node, digests: Mapping[Source, str | None], causes: Mapping[str, str] | None = None
) -> dict[str, Json]:
    """All that the result of a node depends on; None stands for an input that is not made yet.

    `causes` says of the nodes that failed why; they are part of the key of a node that is told of them.
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


def changes(
    node: Node, old: Mapping[str, Any], new: Mapping[str, Any], old_code: Mapping[str, str] | None
) -> list[str]:
    """In words, what differs between the parts of two keys of the same node; empty where nothing does.

    `old_code` holds the digests of the modules of the old key, where they are known.
    """
    return [
        *_changed_value("stage", old["stage"], new["stage"]),
        *_changed_value("version", old["version"], new["version"]),
        *_changed_parameters(old["parameters"], new["parameters"]),
        *(_changed_code(old_code, node.code.modules) if old["code"] != new["code"] else ()),
        *(
            f"the files of {name} changed"
            for name in new["external"]
            if old["external"].get(name) != new["external"][name]
        ),
        *_changed_inputs(node, old["inputs"], new["inputs"]),
        *_changed_items(old.get("items", {}), new.get("items", {})),
        *_changed_value("private", old["private"], new["private"]),
        *_changed_value("format of keys", old["format"], new["format"]),
    ]


def _changed_value(name: str, old: Any, new: Any) -> Iterator[str]:
    if old != new or type(old) is not type(new):
        yield f"{name}: {_shown(old)} → {_shown(new)}"


def _changed_parameters(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    for name in [*new, *(name for name in old if name not in new)]:
        if name not in old:
            yield f"parameter {name} is new: {_shown(new[name])}"
        elif name not in new:
            yield f"parameter {name} is gone; it was {_shown(old[name])}"
        else:
            yield from _changed_value(f"parameter {name}", old[name], new[name])


def _changed_code(old: Mapping[str, str] | None, new: Mapping[str, str]) -> Iterator[str]:
    if old is None:
        yield "code changed"
        return
    words = {
        "changed": sorted(name for name in old.keys() & new.keys() if old[name] != new[name]),
        "joined": sorted(new.keys() - old.keys()),
        "no longer used": sorted(old.keys() - new.keys()),
    }
    for word, names in words.items():
        if names:
            yield f"code {word}: {', '.join(names)}"


def _changed_inputs(node: Node, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    for name in [*new, *(name for name in old if name not in new)]:
        before, after = old.get(name), new.get(name)
        if before == after:
            continue
        if before is None or after is None:
            yield f"input {name} is {'new' if before is None else 'gone'}"
            continue
        if len(before) != len(after):
            yield f"input {name}: {len(before)} → {len(after)} artifacts"
            continue
        for source, was, now in zip(node.sources[name], before, after, strict=True):
            if now is None:
                without = ", which it was made without" if was == FAILED else ""
                yield f"input {name} waits for {source.node}{without}"
            elif FAILED in (was, now) and was != now:
                yield f"input {name}: {source.node} {'failed' if now == FAILED else 'had failed, and is made'}"
            elif was != now:
                yield f"input {name}: {source.node} made another {source.output} ({was[:8]} → {now[:8]})"


def _changed_items(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """What items are called and why they failed; how many there are is told of the inputs already."""
    for name in new:
        before, after = old.get(name, []), new[name]
        if len(before) != len(after):
            continue
        for was, now in zip(before, after, strict=True):
            if was[0] != now[0]:
                yield f"input {name}: {was[0]} → {now[0]}"
            elif was[1] != now[1]:
                yield f"input {name}: the values of {now[0]} changed"
            elif was[2] and now[2] and was[2] != now[2]:
                yield f"input {name}: {now[0]} failed otherwise: {_shown(was[2])} → {_shown(now[2])}"


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"

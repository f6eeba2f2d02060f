"""What differs between the parts of two keys, in words and as fields: which parameter, definition, file or input."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from pipeline.canonical import Json
from pipeline.plain_text import in_a_line, listed, without_controls
from pipeline.plan.known import Known
from pipeline.workflow.graph import Node

Part = Literal["stage", "version", "parameter", "code", "external", "input", "item", "private", "format"]

SHOWN = 60  # characters of a value
FAILED = "failed"
"""Stands in for the digest of an input that failed, if the stage goes on without it."""
LISTED = 4  # names in a text, at most; the fields hold all


@dataclass(frozen=True)
class Change:
    """One difference. `name` is that of the parameter, module or input, if there is one; `text` describes the change.

    `details` depend on `part`. For code: `definitions`, grouped by what happened to them, or `modules`. For external
    files: `files`, grouped likewise, and `renamed`. For an input that one stage makes: `source`, the name of that
    stage, and `output`.
    """

    part: Part
    name: str | None
    text: str
    before: Json = None
    after: Json = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def as_json(self) -> dict[str, Any]:
        """The change as JSON fields, `details` included."""
        fields = {"part": self.part, "name": self.name, "text": self.text, "before": self.before, "after": self.after}
        return {**fields, **self.details}


def changes(node: Node, old: Mapping[str, Any], new: Mapping[str, Any], known: Known) -> tuple[Change, ...]:
    """What differs between the parts of two keys of the same node; empty if nothing does."""
    return (
        *_value("stage", None, "stage", old["stage"], new["stage"]),
        *_value("version", None, "version", old["version"], new["version"]),
        *_parameters(old["parameters"], new["parameters"]),
        *_code(old["code"], new["code"], known),
        *_external(old["external"], new["external"], known),
        *_inputs(node, old["inputs"], new["inputs"]),
        *_items(old.get("items", {}), new.get("items", {})),
        *_value("private", None, "private", old["private"], new["private"]),
        *_value("format", None, "format of keys", old["format"], new["format"]),
    )


def _value(part: Part, name: str | None, what: str, old: Json, new: Json) -> Iterator[Change]:
    if old != new or type(old) is not type(new):
        yield Change(part, name, f"{what}: {_shown(old)} → {_shown(new)}", old, new)


def _parameters(old: Mapping[str, Json], new: Mapping[str, Json]) -> Iterator[Change]:
    for name in _names(new, old):
        if name not in old:
            yield Change("parameter", name, f"parameter {name} is new: {_shown(new[name])}", after=new[name])
        elif name not in new:
            yield Change("parameter", name, f"parameter {name} is gone; it was {_shown(old[name])}", before=old[name])
        elif _spelt(old[name]) != _spelt(new[name]):
            text = f"parameter {name}: {_shown(old[name])} → {_shown(new[name])}"
            yield Change("parameter", name, text, old[name], new[name])


def _spelt(value: Json) -> str:
    """JSON in which, as in keys, 1, 1.0 and true differ and the order of names does not matter."""
    return json.dumps(value, sort_keys=True)


def _code(old: str, new: str, known: Known) -> Iterator[Change]:
    if old == new:
        return
    before, after = known.code(old), known.code(new)
    if before is None or after is None:
        yield Change("code", None, "code changed", old, new)
        return
    for name in sorted(before.keys() & after.keys()):
        was, now = before[name], after[name]
        if was["digest"] != now["digest"]:
            definitions = _what_became(was["definitions"], now["definitions"])
            about = _listed(definitions) or "the order of its definitions"
            yield Change("code", name, f"code changed: {name} ({about})", details={"definitions": definitions})
    for words, names in (
        ("newly used", sorted(after.keys() - before.keys())),
        ("no longer used", sorted(before.keys() - after.keys())),
    ):
        if names:
            yield Change("code", None, f"code {words}: {', '.join(names)}", details={"modules": names})


def _external(old: Mapping[str, Any], new: Mapping[str, Any], known: Known) -> Iterator[Change]:
    for name in _names(new, old):
        before, after = old.get(name, []), new.get(name, [])
        if before == after:
            continue
        if len(before) != len(after):
            counts = f"{len(before)} → {len(after)}"
            yield Change("external", name, f"files and folders of {name}: {counts}", list(before), list(after))
            continue
        for was, now in zip(before, after, strict=True):
            if was != now:
                yield _files(name, was, now, known)


def _files(name: str, old: str, new: str, known: Known) -> Change:
    before, after = known.files(old), known.files(new)
    if before is None or after is None:
        return Change("external", name, f"the files of {name} changed", old, new)
    if before.is_folder != after.is_folder:
        kinds = "a folder → a file" if before.is_folder else "a file → a folder"
        return Change("external", name, f"the files of {name} changed: {kinds}", old, new)
    files = _what_became(before.files, after.files)
    gone = {before.files[file]: file for file in files["removed"]}
    renamed = {gone[after.files[file]]: file for file in files["added"] if after.files[file] in gone}
    files["added"] = [file for file in files["added"] if file not in renamed.values()]
    files["removed"] = [file for file in files["removed"] if file not in renamed]
    words = [
        *([_listed(files)] if any(files.values()) else []),
        *(f"{was} renamed to {now}" for was, now in _few(renamed)),
    ]
    if len(renamed) > LISTED:
        words.append(f"and {len(renamed) - LISTED} more renamed")
    text = f"the files of {name} changed: {', '.join(words)}"
    return Change("external", name, without_controls(text), old, new, {"files": files, "renamed": renamed})


def _inputs(node: Node, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[Change]:
    for name in _names(new, old):
        before, after = old.get(name), new.get(name)
        if before == after:
            continue
        if before is None or after is None:
            yield Change("input", name, f"input {name} is {'new' if before is None else 'gone'}", before, after)
            continue
        if len(before) != len(after):
            text = f"input {name}: {len(before)} → {len(after)} artifacts"
            yield Change("input", name, text, before, after)
            continue
        for source, was, now in zip(node.sources[name], before, after, strict=True):
            details = {"source": source.node, "output": source.output}
            if now is None:
                without = ", which the last result was made without" if was == FAILED else ""
                yield Change("input", name, f"input {name} waits for {source.node}{without}", was, None, details)
            elif was != now and FAILED in (was, now):
                text = f"input {name}: {source.node} {'failed' if now == FAILED else 'had failed, but now succeeded'}"
                yield Change("input", name, text, was, now, details)
            elif was != now:
                text = f"input {name}: the {source.output} of {source.node} changed ({was[:8]} → {now[:8]})"
                yield Change("input", name, text, was, now, details)


def _items(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[Change]:
    """Changes of items' labels, values and causes of failure; their number is already reported for the inputs.

    An item is in a list once for each stage that an input gathers from it, but reported only once.
    """
    for name in new:
        before, after = old.get(name, []), new[name]
        if len(before) == len(after):
            changes = [_item(name, was, now) for was, now in zip(before, after, strict=True)]
            yield from {change.text: change for change in changes if change is not None}.values()


def _item(name: str, was: Sequence[Any], now: Sequence[Any]) -> Change | None:
    if was[0] != now[0]:
        return Change("item", name, f"input {name}: {was[0]} → {now[0]}", was[0], now[0])
    if was[1] != now[1]:
        return Change("item", name, f"input {name}: the values of {now[0]} changed", was[1], now[1])
    if was[2] and now[2] and was[2] != now[2]:
        text = f"input {name}: {now[0]} failed differently: {_shown(was[2])} → {_shown(now[2])}"
        return Change("item", name, text, was[2], now[2])
    return None


def _what_became(old: Mapping[str, str], new: Mapping[str, str]) -> dict[str, list[str]]:
    return {
        "changed": sorted(name for name in old.keys() & new.keys() if old[name] != new[name]),
        "added": sorted(new.keys() - old.keys()),
        "removed": sorted(old.keys() - new.keys()),
    }


def _listed(names: Mapping[str, Sequence[str]]) -> str:
    """Such as `a, b changed, c added`; long lists are cut.

    >>> _listed({"changed": ["a", "b"], "added": [], "removed": ["c"]})
    'a, b changed, c removed'
    """
    return ", ".join(f"{listed(group, LISTED)} {became}" for became, group in names.items() if group)


def _few(renamed: Mapping[str, str]) -> list[tuple[str, str]]:
    return list(renamed.items())[:LISTED]


def _names(new: Iterable[str], old: Iterable[str]) -> list[str]:
    return list(dict.fromkeys([*new, *old]))


def _shown(value: Json) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return in_a_line(text, SHOWN)

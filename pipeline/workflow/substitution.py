"""`${…}`: values that a workflow file states once and uses in several places."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from pipeline.errors import nearest
from pipeline.workflow.located import DEEPEST, LARGEST, Located, Problems

Scope = Mapping[str, Located | None]
"""What each `${name}` stands for; None if its value is missing, which is already reported."""

LONGEST_TEXT = 2**20  # characters of a text with `${name}` in it
REFERENCE = re.compile(r"\$(\$|\{([^{}]*)\})")


def substitute(located: Located, scope: Scope, problems: Problems) -> Located | None:
    """`located` with every `${name}` replaced.

    None, with the reason added to `problems`, if that is impossible, and None if it is already broken. A text that is
    nothing but `${name}` becomes the named value itself, with its type, place and base; a text that begins with
    `${name}` takes its base, so that `${folder}/photos` leads where `${folder}` does. Inside a text, a value appears as
    it was typed: the folder 0123 is not a number. `$$` stands for a dollar sign. What grows too large or too deep is
    refused, for example lines that each contain the one before ten times.
    """
    if located.broken:
        return None
    if isinstance(located.value, tuple):
        items = [substitute(item, scope, problems) for item in located.value]
        if any(item is None for item in items):
            return None
        return _bounded(replace(located, value=tuple(item for item in items if item is not None)), problems)
    if isinstance(located.value, Mapping):
        values = {name: substitute(item, scope, problems) for name, item in located.value.items()}
        if any(item is None for item in values.values()):
            return None
        kept = {name: item for name, item in values.items() if item is not None}
        return _bounded(replace(located, value=kept), problems)
    if not isinstance(located.value, str) or "$" not in located.value:
        return located
    whole = REFERENCE.fullmatch(located.value)
    if whole and whole[2] is not None:
        return _look_up(whole[2], located, scope, problems)
    return _interpolate(located, scope, problems)


def _bounded(located: Located, problems: Problems) -> Located | None:
    if located.size > LARGEST:
        message = f"{located.size:,} values once every ${{…}} is replaced; at most {LARGEST:,} are allowed"
    elif located.depth > DEEPEST:
        message = f"nested {located.depth} levels deep once every ${{…}} is replaced; at most {DEEPEST} are allowed"
    else:
        return located
    problems.add(located.place, message)
    return None


def references(located: Located) -> Iterator[str]:
    """The name in every `${name}` of a value, at any depth."""
    for text in located.texts():
        yield from (match[2] for match in REFERENCE.finditer(str(text.value)) if match[2] is not None)


def _interpolate(located: Located, scope: Scope, problems: Problems) -> Located | None:
    text, pieces, end, base, sources = str(located.value), [], 0, located.base, set(located.sources)
    for match in REFERENCE.finditer(text):
        pieces.append(text[end : match.start()])
        end = match.end()
        if match[1] == "$":
            pieces.append("$")
            continue
        value = _look_up(match[2], located, scope, problems)
        if value is None:
            return None
        if value.typed is None and (isinstance(value.value, tuple | Mapping) or value.value is None):
            problems.add(located.place, f"${{{match[2]}}} is {value.found}, which cannot be part of a text")
            return None
        if match.start() == 0:
            base = value.base
        sources |= {value.place, *value.sources}
        pieces.append(str(value.value) if value.typed is None else value.typed)
    pieces.append(text[end:])
    length = sum(map(len, pieces))  # checked before joining, for which there may not be enough memory
    if length > LONGEST_TEXT:
        message = f"a text of {length:,} characters once every ${{…}} is replaced; at most {LONGEST_TEXT:,} are allowed"
        problems.add(located.place, message)
        return None
    return replace(located, value="".join(pieces), base=base, sources=frozenset(sources))


def _look_up(name: str, located: Located, scope: Scope, problems: Problems) -> Located | None:
    if name in scope:
        return scope[name]
    known = ", ".join(f"${{{known}}}" for known in scope) or "none"
    problems.add(located.place, f"${{{name}}} is not known; known: {known}{nearest(name, scope)}")
    return None

"""Values that stages refuse, told once for each mistake: a mistyped var may reach the parameters of many stages."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pipeline.canonical import Json
from pipeline.errors import Place, nearest
from pipeline.fingerprint import SourceTree
from pipeline.located import Located, Problems


@dataclass(frozen=True)
class WrongValue:
    """A value that stands at `place` and that a stage refuses as its parameter `name`; `message` begins with that name.

    `selects`: it would be the name of a module, so that the stage says nothing of which are right.
    """

    place: Place
    stage: str
    name: str
    message: str
    selects: bool = False


def report(found: Iterable[WrongValue], problems: Problems) -> None:
    """Adds a problem for each value and each reason to refuse it, which names the stages that do.

    What a stage says of its parameter goes before what is known of the modules that others would select by it.
    """
    groups: dict[tuple[Place, str], list[WrongValue]] = {}
    for wrong in found:
        groups.setdefault((wrong.place, wrong.name), []).append(wrong)
    for (place, name), group in groups.items():
        stated = [wrong for wrong in group if not wrong.selects] or group
        first = stated[0].message
        reasons: dict[str, dict[str, None]] = {}
        for wrong in group:
            reasons.setdefault(wrong.message if wrong in stated else first, {})[wrong.stage] = None
        for message, stages in reasons.items():
            of_stages = f" of {_listed([*stages])}" if len(stages) > 1 else ""
            problems.add(place, message.replace(f"parameter {name!r}", f"parameter {name!r}{of_stages}", 1))


def to_be_quoted(value: Located) -> str:
    """What to write where a text is wanted that YAML takes for something else, such as the name 2024."""
    if value.value is None:
        return "; so are an empty cell of a table and the text null, which is to be quoted: 'null'"
    if value.typed is None:
        return ""
    quoted = "'" + value.typed.replace("'", "''") + "'"
    return f"""; a text that looks so is to be quoted: {quoted} in a file, "{quoted}" after --set NAME="""


def misnamed_module(
    modules: Iterable[str], parameters: Mapping[str, Json], sources: SourceTree
) -> tuple[str, str] | None:
    """The parameter whose value names a module that is not there, among others that are, and what is wrong with it.

    None where there is no such parameter.
    """
    missing = [module for module in modules if sources.module(module) is None]
    for name, value in parameters.items():
        for module in missing:
            known = sources.modules_in(module.removesuffix(f".{value}")) if module.endswith(f".{value}") else []
            if known:
                allowed = _listed(list(map(repr, known)), "or")
                return (
                    name,
                    f"parameter {name!r} should be {allowed}; found {json.dumps(value)}{nearest(str(value), known)}",
                )
    return None


def _listed(names: list[str], last: str = "and") -> str:
    """
    >>> _listed(["a"]), _listed(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    return f" {last} ".join([*([", ".join(names[:-1])] if names[1:] else []), *names[-1:]])

"""Values that stages refuse, reported once per mistake: a mistyped var may reach the parameters of many stages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.errors import Place
from pipeline.workflow.located import Located, Problems


@dataclass(frozen=True)
class WrongValue:
    """A value at `place` that a stage refuses as its parameter `name`; `message` begins with `parameter 'name'`."""

    place: Place
    stage: str
    name: str
    message: str


def report(found: Iterable[WrongValue], problems: Problems) -> None:
    """Adds one problem for each value and each reason to refuse it; it names the stages if several do."""
    groups: dict[tuple[Place, str], list[WrongValue]] = {}
    for wrong in found:
        groups.setdefault((wrong.place, wrong.name), []).append(wrong)
    for (place, name), group in groups.items():
        reasons: dict[str, dict[str, None]] = {}
        for wrong in group:
            reasons.setdefault(wrong.message, {})[wrong.stage] = None
        for message, stages in reasons.items():
            of_stages = f" of {_listed([*stages])}" if len(stages) > 1 else ""
            problems.add(place, message.replace(f"parameter {name!r}", f"parameter {name!r}{of_stages}", 1))


def wanting_text(name: str, message: str, value: Located) -> str:
    """Why a parameter refuses a value that is not a text, and what to write if it is meant as one.

    YAML takes the name 2024, for example, for a number.
    """
    if value.value is None:
        return f"parameter {name!r}: no value was given; expected a text. To give the text null, {_quoting('null')}"
    if value.typed is None:
        return message
    return f"{message}; to give this as a text, {_quoting(value.typed)}"


def _quoting(typed: str) -> str:
    """How to quote what was typed. In a CSV only double quotes count, and a shell takes the outer ones away."""
    quoted = "'" + typed.replace("'", "''") + "'"
    in_a_cell = '"' + typed.replace('"', '""') + '"'
    return f"""quote it: {quoted} in a YAML file, {in_a_cell} in a CSV, "{quoted}" after --set NAME="""


def _listed(names: list[str]) -> str:
    """
    >>> _listed(["a"]), _listed(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    return " and ".join([*([", ".join(names[:-1])] if names[1:] else []), *names[-1:]])

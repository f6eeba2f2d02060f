"""Stages as a person who writes a workflow reads of them in a terminal."""

from __future__ import annotations

import json
import shutil
import textwrap
from collections.abc import Iterator, Mapping

from pipeline.code.manual import ParameterManual, StageManual
from pipeline.console.tables import indented, table
from pipeline.stage import Input, Output

WIDEST = 120  # characters of a line; narrower terminals get narrower lines
NARROWEST = 60
PRIVACY = {"private": "private", "public": "public", "inherit": "private if an input is"}


def lines_of_summaries(summaries: Mapping[str, str]) -> list[str]:
    """A line for each stage: its name, and what it is for; one alone without stages."""
    return table(list(summaries.items())) or ["There are no stages."]


def lines_of_manual(manual: StageManual) -> Iterator[str]:
    """What a stage is for, takes, makes and can be told."""
    yield from _wrapped(f"{manual.name}: {manual.summary}")
    for paragraph in filter(None, manual.text.split("\n\n")):
        yield ""
        yield from _wrapped(paragraph)
    if manual.inputs:
        yield from ("", "in", *indented(table([[name, _taken(port)] for name, port in manual.inputs.items()])))
    yield from ("", "out", *indented(table([[name, _made(port)] for name, port in manual.outputs.items()])))
    if manual.parameters:
        yield from ("", "with")
        for name, parameter in manual.parameters.items():
            yield from _wrapped(f"{name}: {parameter.values}{_default(parameter)}", "  ", "      ")
            yield from _wrapped(parameter.description, "      ", "      ")


def _taken(port: Input) -> str:
    many = ", any number" if port.many else ""
    return f"{port.kind}{many}{', optional' if port.optional else ''}"


def _made(port: Output) -> str:
    return f"{port.kind}, {PRIVACY[port.privacy]}"


def _default(parameter: ParameterManual) -> str:
    return "; required" if parameter.required else f"; default {_spelled(parameter.default)}"


def _spelled(value: object) -> str:
    """A value as one would write it in a workflow file."""
    return value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)


def _wrapped(text: str, first: str = "", others: str = "") -> list[str]:
    width = max(NARROWEST, min(WIDEST, shutil.get_terminal_size((WIDEST, 24)).columns))
    return textwrap.wrap(
        " ".join(text.split()),
        width,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )

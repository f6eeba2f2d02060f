"""An artifact as a person reads it in a terminal."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby

from pipeline.canonical import Json
from pipeline.console.tables import in_short, indented, number_words, rows_table, table
from pipeline.console.wording import duration
from pipeline.disk import size_words
from pipeline.plain_text import in_a_line, without_controls
from pipeline.results.description import Description, FileDescription, Origin

ROWS = 40  # of a table or lines of a text; more are shortened
FILES = 12  # plain files that are listed one by one; more are grouped by folder


def lines_of(description: Description, everything: bool) -> Iterator[str]:
    """What is known about an artifact, line by line; with `everything`, no row, line or file is left out or cut."""
    yield from _head(description)
    if description.attributes:
        yield from ("", "attributes", *_pairs(description.attributes, everything))
    if description.arrays:
        yield from ("", "arrays", *indented(_arrays(description)))
    if description.files:
        yield from ("", "files", *indented(_files(description.files, everything)))
    for file in description.files:
        yield from _content(file, everything)
    if description.origin:
        yield from ("", "how it was made", *_origin(description.origin, everything))
    if not description.revealed:
        yield from ("", "It is private: values are not shown. Add --reveal to see them.")


def _head(description: Description) -> list[str]:
    names = ", ".join(in_a_line(name) for name in description.names)
    title = f"{in_a_line(description.kind)}{' (private)' if description.private else ''}"
    return [
        f"{title}  {names}".rstrip(),
        f"  digest  {description.digest}",
        f"  size    {size_words(description.size)}",
        f"  path    {description.path}",
    ]


def _arrays(description: Description) -> list[str]:
    rows = [["name", "shape", "type", "chunk", "stored", "least", "mean", "greatest", ""]]
    for array in description.arrays:
        values = array.range
        figures = ["", "", ""]
        remarks = []
        if values is not None and values.least is not None and values.mean is not None and values.greatest is not None:
            figures = [number_words(values.least), number_words(values.mean), number_words(values.greatest)]
        if values is not None and values.nan:
            remarks.append(f"{values.nan:,} not a number")
        if values is not None and values.infinite:
            remarks.append(f"{values.infinite:,} infinite")
        shape, chunk = _shape(array.shape), _shape(array.chunks)
        chunk = "whole" if chunk == shape else chunk
        kind = type_words(array.dtype)
        rows.append([in_a_line(array.name), shape, kind, chunk, size_words(array.stored), *figures, ", ".join(remarks)])
    if not any(row[5] for row in rows[1:]):
        rows = [row[:5] for row in rows]
    return table(rows, right=(4, 5, 6, 7))


def type_words(dtype: str) -> str:
    """NumPy's type code in words.

    >>> [type_words(code) for code in ("<f4", "|u1", "|b1", "<i8", "<c8")]
    ['float32', 'uint8', 'bool', 'int64', 'complex64']
    """
    names = {"f": "float", "u": "uint", "i": "int", "c": "complex"}
    kind, size = dtype[1], dtype[2:]
    return f"{names[kind]}{8 * int(size)}" if kind in names and size.isdigit() else "bool" if kind == "b" else dtype


def _shape(shape: Iterable[int]) -> str:
    return " × ".join(f"{size}" for size in shape) or "one number"


def _files(files: tuple[FileDescription, ...], everything: bool) -> list[str]:
    """A line for each file or, if there are many, for each folder with the number of its files."""
    if everything or len(files) <= FILES:
        spelled = _spelling(everything)
        return table([[spelled(file.name), size_words(file.size)] for file in files], right=(1,))
    rows = []
    for _, group in groupby(files, key=lambda file: file.name.rpartition("/")[0]):
        members = list(group)
        names = f"{members[0].name} … {members[-1].name.rpartition('/')[2]}" if len(members) > 1 else members[0].name
        rows.append([in_a_line(names), f"{len(members)}", size_words(sum(file.size for file in members))])
    return table(rows, right=(1, 2))


def _content(file: FileDescription, everything: bool) -> Iterator[str]:
    """What a file contains, if that is a table or a text."""
    spelled = _spelling(everything)
    if file.rows is not None:
        rows, how = (list(file.rows), None) if everything else in_short(file.rows, ROWS)
        yield from ("", f"{spelled(file.name)}{f' ({how}; --all shows them)' if how else ''}")
        yield from indented(rows_table(rows, spelled))
    elif file.text is not None:
        shown = file.text if everything else file.text[:ROWS]
        left = len(file.text) - len(shown)
        yield from ("", spelled(file.name))
        yield from indented(spelled(line) for line in shown)
        if left:
            yield f"  … {left} more lines; --all shows them"


def _spelling(everything: bool) -> Callable[[str], str]:
    """How texts from an artifact are printed, without what a terminal would obey: whole, or cut to a line."""
    return without_controls if everything else in_a_line


def _origin(origin: Origin, everything: bool) -> Iterator[str]:
    machine = origin.machine
    where = ", ".join(str(machine[name]) for name in ("host", "processor") if machine.get(name))
    cores = f", {machine['cores']} cores" if machine.get("cores") else ""
    yield from indented(
        table(
            [
                ["by", f"{in_a_line(origin.made_by)} ({origin.uses}), {origin.started}, in {duration(origin.seconds)}"],
                ["on", in_a_line(f"{where}{cores}")],
                ["commit", origin.commit or "unknown"],
                ["key", origin.key],
                ["with", ", ".join(f"{name} {version}" for name, version in origin.versions.items())],
            ]
        )
    )
    for title, values in (("recorded", origin.facts), ("parameters", origin.parameters)):
        if values:
            yield f"  {title}"
            yield from indented(_pairs(values, everything))
    if origin.inputs:
        yield "  inputs"
        taken = [
            [name, ", ".join(in_a_line(f"{one.made_by} {one.digest[:12]}".strip()) for one in group) or "none"]
            for name, group in origin.inputs.items()
        ]
        yield from indented(indented(table(taken)))
    yield "  lineage"
    steps = [[in_a_line(step.name), step.uses, duration(step.seconds)] for step in origin.lineage]
    yield from indented(indented(table(steps, right=(2,))))


def _pairs(values: Mapping[str, Json], everything: bool) -> list[str]:
    rows = [[in_a_line(name), _value(value, everything)] for name, value in sorted(values.items())]
    return indented(table(rows))


def _value(value: Json, everything: bool) -> str:
    """A value on one line; a long list as its length and its first items."""
    if isinstance(value, float):
        return number_words(value)
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    if everything:
        return without_controls(text)
    if isinstance(value, list) and len(text) > 80:
        return f"{len(value)}: {in_a_line(text[1:70].rstrip(', '))} …"
    return in_a_line(text)

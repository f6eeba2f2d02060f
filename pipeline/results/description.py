"""What an artifact holds and how it was made, as far as a person may see it.

Values of a private artifact (attributes, ranges, text and parameters) are withheld unless asked for. Its structure
(names, shapes, types, sizes) is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from pipeline.artifact import Artifact
from pipeline.canonical import Json
from pipeline.disk import parse_json
from pipeline.manifest import ARRAYS
from pipeline.results.naming import names_of
from pipeline.store.record import Record, first_makers
from pipeline.store.store import Store

if TYPE_CHECKING:
    import numpy as np

TEXTS = (".txt", ".md", ".json", ".csv", ".yaml", ".yml", ".log")
TABLES = (".jsonl",)
DEEPEST = 20  # levels of nesting in a row of a table
LONGEST_TEXT = 4 * 1024 * 1024  # bytes; the content of a longer file is not shown


@dataclass(frozen=True)
class Range:
    """The values of an array: least, mean and greatest of the finite ones (None if there are none), and the others'
    counts.
    """

    least: float | None
    mean: float | None
    greatest: float | None
    nan: int
    infinite: int


@dataclass(frozen=True)
class ArrayDescription:
    """An array. `stored` is its compressed size in bytes; `range` is None if withheld or if the numbers are complex."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    stored: int
    range: Range | None


@dataclass(frozen=True)
class FileDescription:
    """A plain file. `rows` are those of a table, `text` the lines of a text; None if it is not one or is withheld."""

    name: str
    size: int
    rows: tuple[Mapping[str, Json], ...] | None = None
    text: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Ancestor:
    """An action that something was made from."""

    name: str
    uses: str
    seconds: float
    key: str


@dataclass(frozen=True)
class Taken:
    """An artifact that an action took, and the stage that made it; empty if that is unknown."""

    digest: str
    made_by: str


@dataclass(frozen=True)
class Origin:
    """How an artifact was made. `lineage` is all actions up to its own, each after those that it took from.

    `facts` and `parameters` are None if they are withheld.
    """

    made_by: str
    uses: str
    key: str
    started: str
    seconds: float
    commit: str | None
    machine: Mapping[str, Json]
    facts: Mapping[str, Json] | None
    versions: Mapping[str, str]
    parameters: Mapping[str, Json] | None
    inputs: Mapping[str, tuple[Taken, ...]]
    lineage: tuple[Ancestor, ...]


@dataclass(frozen=True)
class Description:
    """An artifact. `names` are those in `latest`; `revealed`: nothing is withheld; `attributes` is None if withheld."""

    kind: str
    private: bool
    revealed: bool
    digest: str
    path: str
    names: tuple[str, ...]
    size: int
    attributes: Mapping[str, Json] | None
    arrays: tuple[ArrayDescription, ...]
    files: tuple[FileDescription, ...]
    origin: Origin | None


def describe(artifact: Artifact, store: Store | None, reveal: bool) -> Description:
    """Describes an artifact, reading its arrays chunk by chunk unless values are withheld.

    Raises CorruptArtifact if what it reads is damaged.
    """
    told = reveal or not artifact.private
    return Description(
        kind=artifact.kind,
        private=artifact.private,
        revealed=told,
        digest=artifact.digest,
        path=str(artifact.path),
        names=tuple(names_of(artifact.digest, store)) if store else (),
        size=sum(file.size for file in artifact.manifest.files.values()),
        attributes=artifact.attributes if told else None,
        arrays=tuple(_array(artifact, name, told) for name in artifact.names),
        files=tuple(_file(artifact, name, told) for name in artifact.files),
        origin=_origin(artifact, store, reveal) if store else None,
    )


def as_json(description: Description) -> dict[str, object]:
    """The fields that `show --json` prints."""
    return {"event": "artifact", **asdict(description)}


def _array(artifact: Artifact, name: str, told: bool) -> ArrayDescription:
    record = artifact.manifest.arrays[name]
    prefix = f"{ARRAYS}/{name}/"
    stored = sum(file.size for path, file in artifact.manifest.files.items() if path.startswith(prefix))
    values = range_of(artifact, name) if told else None
    return ArrayDescription(name, record.dtype, record.shape, record.chunks, stored, values)


def range_of(artifact: Artifact, name: str) -> Range | None:
    """The range of an array, read chunk by chunk; None for complex numbers. Raises CorruptArtifact if it is damaged."""
    import numpy as np

    if np.dtype(artifact.manifest.arrays[name].dtype).kind == "c":
        return None
    least, greatest, total, finite, nan, infinite = math.inf, -math.inf, 0.0, 0, 0, 0
    for block in artifact.blocks(name):
        values, missing, unbounded = _finite(block)
        nan, infinite, finite = nan + missing, infinite + unbounded, finite + values.size
        if values.size:
            least, greatest = min(least, float(values.min())), max(greatest, float(values.max()))
            total += float(values.sum(dtype=np.float64))
    return Range(least, total / finite, greatest, nan, infinite) if finite else Range(None, None, None, nan, infinite)


def _finite(block: np.ndarray) -> tuple[np.ndarray, int, int]:
    """The finite values of a block, and the numbers of NaNs and of infinities."""
    import numpy as np

    if block.dtype.kind != "f":
        return block, 0, 0
    finite = np.isfinite(block)
    if finite.all():
        return block, 0, 0
    nan = int(np.isnan(block).sum())
    return block[finite], nan, int(block.size - finite.sum()) - nan


def _file(artifact: Artifact, name: str, told: bool) -> FileDescription:
    size = artifact.manifest.files[name].size
    suffix = PurePosixPath(name).suffix.lower()
    if not told or size > LONGEST_TEXT or suffix not in (*TEXTS, *TABLES):
        return FileDescription(name, size)
    lines = artifact.file(name).read_text(encoding="utf-8", errors="replace").splitlines()
    rows = _rows(lines) if suffix in TABLES else None
    return FileDescription(name, size, rows, None if rows is not None else tuple(lines))


def _rows(lines: list[str]) -> tuple[Mapping[str, Json], ...] | None:
    """The rows of a table, one object per line; None if it is not a table, or nested too deeply to be one."""
    try:
        rows = [parse_json(line) for line in lines if line.strip()]
    except ValueError:
        return None
    return tuple(rows) if all(isinstance(row, dict) and not _is_deeper(row, DEEPEST) for row in rows) else None


def _is_deeper(value: Json, levels: int) -> bool:
    """Whether lists and mappings are nested more than `levels` levels deep."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return items is not None and (levels == 0 or any(_is_deeper(item, levels - 1) for item in items))


def _origin(artifact: Artifact, store: Store, reveal: bool) -> Origin | None:
    makers = first_makers(store.records())
    record = makers.get(artifact.digest)
    if record is None:
        return None
    provenance: Mapping[str, Any] = record.provenance
    parts: Mapping[str, Any] = record.parts
    told = reveal or not record.private  # a public output may have private siblings, which parameters would reveal
    return Origin(
        made_by=f"{record.workflow}/{record.name}",
        uses=str(parts.get("stage")),
        key=record.key,
        started=str(provenance.get("started")),
        seconds=record.seconds,
        commit=provenance.get("commit"),
        machine=provenance.get("machine", {}),
        facts=provenance.get("facts", {}) if told else None,
        versions=provenance.get("versions", {}),
        parameters=parts.get("parameters", {}) if told else None,
        inputs={name: tuple(_taken(digest, makers) for digest in group) for name, group in record.inputs.items()},
        lineage=tuple(_lineage(record, makers)),
    )


def _taken(digest: str, makers: Mapping[str, Record]) -> Taken:
    return Taken(digest, makers[digest].name if digest in makers else "")


def _lineage(record: Record, makers: Mapping[str, Record]) -> list[Ancestor]:
    """The actions behind `record`, each after those that it took from; `record` itself is the last."""
    ordered: dict[str, Ancestor] = {}
    waiting = [record]
    while waiting:
        action = waiting[-1]
        before = [makers[digest] for digests in action.inputs.values() for digest in digests if digest in makers]
        lacking = [maker for maker in before if maker.key not in ordered and maker not in waiting]
        if lacking:
            waiting += lacking[:1]
            continue
        waiting.pop()
        uses = str(action.parts.get("stage"))
        ordered[action.key] = Ancestor(action.name, uses, action.seconds, action.key)
    return list(ordered.values())

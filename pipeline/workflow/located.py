"""YAML in which every value knows its place, so that later errors can point to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from pipeline.canonical import Json
from pipeline.errors import Place, Problem, WorkflowError
from pipeline.plain_text import in_a_line

Scalar = str | int | float | bool | None
LONGEST_NUMBER = 1024  # bits, as many as a float's range; Python does not even print much longer ones
DEEPEST = 50  # levels; an alias that contains itself would otherwise never end
LARGEST = 1_000_000  # values; eight lines of ten aliases each would otherwise fill any memory
TIMESTAMP = "tag:yaml.org,2002:timestamp"
A_VALUE_OF_TEXT = 64  # characters that count as one value


class Problems:
    """Collects what is wrong, so that a person sees all of it at once; `missing` names vars that have no value."""

    def __init__(self) -> None:
        self._problems: list[Problem] = []
        self.missing: set[str] = set()

    def add(self, place: Place, message: str) -> None:
        """Adds what is wrong at a place."""
        self._problems.append(Problem(place, message))

    def __len__(self) -> int:
        return len(self._problems)

    def __iter__(self) -> Iterator[Problem]:
        return iter(self._problems)

    def raise_if_any(self) -> None:
        """Raises WorkflowError with all problems, if there are any."""
        if self._problems:
            raise WorkflowError(self._problems)


@dataclass(frozen=True)
class Located:
    """A value with its place, and the directory that relative paths in it are relative to (`base`).

    `size` is the number of values in it, itself included, plus one for every 64 characters of text. What occurs in it
    twice counts twice, although it takes twice the memory only when it is written out. `depth` is its number of levels.
    `typed` is the text of a value that was read as something else, such as the number 0123 or what follows `--set
    NAME=`; it is None for null, and if nobody typed the value. `broken`: it could not be read, which is already
    reported. `sources` are the places of the values that became part of a text.
    """

    value: Scalar | tuple[Located, ...] | Mapping[str, Located]
    place: Place
    base: Path
    keys: Mapping[str, Place] = field(default_factory=dict)
    typed: str | None = None
    broken: bool = False
    sources: frozenset[Place] = frozenset()
    size: int = field(init=False, compare=False, repr=False)
    depth: int = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        texts = (self.value,) if isinstance(self.value, str) else self.value if isinstance(self.value, Mapping) else ()
        length = sum(len(text) // A_VALUE_OF_TEXT for text in texts)
        object.__setattr__(self, "size", 1 + length + sum(item.size for item in self.items))
        object.__setattr__(self, "depth", 1 + max((item.depth for item in self.items), default=0))

    def places(self) -> Iterator[Place]:
        """The places of the value, of everything in it, and of what became part of its texts."""
        yield self.place
        yield from self.sources
        for item in self.items:
            yield from item.places()

    @property
    def items(self) -> tuple[Located, ...]:
        """What a list or a mapping holds; empty for any other value."""
        if isinstance(self.value, Mapping):
            return tuple(self.value.values())
        return self.value if isinstance(self.value, tuple) else ()

    @property
    def plain(self) -> Json:
        """The value as plain JSON data, without places."""
        if isinstance(self.value, tuple):
            return [item.plain for item in self.value]
        if isinstance(self.value, Mapping):
            return {name: item.plain for name, item in self.value.items()}
        return self.value

    def texts(self) -> Iterator[Located]:
        """Every text in the value, at any depth."""
        if isinstance(self.value, str):
            yield self
        for item in self.items:
            yield from item.texts()

    @property
    def found(self) -> str:
        """The value as an error message shows it.

        >>> Located("x", Place("w.yaml"), Path()).found, Located((), Place("w.yaml"), Path()).found
        ("the text 'x'", 'a list')
        """
        if isinstance(self.value, tuple):
            return "a list"
        if isinstance(self.value, Mapping):
            return "a mapping"
        if self.value is None:
            return "nothing"
        if isinstance(self.value, bool):
            return "true" if self.value else "false"
        return f"the text {self.value!r}" if isinstance(self.value, str) else f"the number {self.value}"

    def at(self, path: tuple[object, ...]) -> Located:
        """What `path` (keys and indices) leads to, or the last value on the way that exists."""
        here = self
        for step in path:
            if isinstance(here.value, Mapping) and step in here.value:
                here = here.value[str(step)]
            elif isinstance(here.value, tuple) and isinstance(step, int) and step < len(here.value):
                here = here.value[step]
            else:
                break
        return here


def read_yaml(text: str, file: str, base: Path, problems: Problems, fixed: Place | None = None) -> Located | None:
    """The document in `text`; None, with the reason added to `problems`, if it is not YAML.

    Places are in `file`. If `fixed` is given, it is the place of the whole, and `column` numbers the values in it.
    """
    try:
        node = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = fixed or (Place(file, mark.line + 1, mark.column + 1) if mark else Place(file))
        problems.add(place, f"not YAML: {error.problem or error.context}")
        return None
    except YAMLError as error:
        problems.add(fixed or Place(file), f"not YAML: {str(error).splitlines()[0]}")
        return None
    except (AssertionError, RecursionError):  # what ruamel raises for %YAML 1.3, and for 500 nested lists
        problems.add(fixed or Place(file), f"not YAML 1.2, or nested more than {DEEPEST} levels deep")
        return None
    if node is None:
        return Located(None, fixed or Place(file, 1, 1), base)
    try:
        return _Reader(file, base, problems, fixed).located(node, 0)
    except _TooLarge as error:
        message = f"more than the {LARGEST:,} values allowed; what an alias (*name) stands for counts each time"
        problems.add(error.place, message)
        return None


class _TooLarge(Exception):
    def __init__(self, place: Place) -> None:
        self.place = place


class _Reader:
    def __init__(self, file: str, base: Path, problems: Problems, fixed: Place | None) -> None:
        self.file = file
        self.base = base
        self.problems = problems
        self.fixed = fixed
        self.constructor = YAML(typ="safe", pure=True).constructor
        self.read = 0
        self.known: dict[Node, Located] = {}
        self.places = 0

    def located(self, node: Node, depth: int) -> Located:
        """The value of a node. Raises _TooLarge, with the place, if there are too many values.

        What an alias stands for is read once, but counts each time.
        """
        found = self.known.get(node)
        if found is None or depth + found.depth > DEEPEST:
            found = self.known[node] = self.read_anew(node, depth)
        else:
            self.count(found.size, found.place)
        return found

    def count(self, values: int, place: Place) -> None:
        self.read += values
        if self.read > LARGEST:
            raise _TooLarge(place)

    def read_anew(self, node: Node, depth: int) -> Located:
        place = self.place(node)
        self.count(1 + (len(node.value) // A_VALUE_OF_TEXT if isinstance(node, ScalarNode) else 0), place)
        if depth > DEEPEST:
            self.problems.add(place, f"nested more than {DEEPEST} levels deep")
            return Located(None, place, self.base)
        if isinstance(node, MappingNode):
            values, keys = {}, {}
            for name, key, value in self.entries(node):
                values[name] = self.located(value, depth + 1)
                keys[name] = self.place(key)
            return Located(values, place, self.base, keys)
        if isinstance(node, SequenceNode):
            return Located(tuple(self.located(item, depth + 1) for item in node.value), place, self.base)
        before = len(self.problems)
        scalar = self.scalar(node, place)
        typed = None if scalar is None or isinstance(scalar, str) else str(node.value)
        return Located(scalar, place, self.base, typed=typed, broken=len(self.problems) > before)

    def entries(self, node: MappingNode) -> Iterator[tuple[str, Node, Node]]:
        seen: set[str] = set()
        for key, value in node.value:
            if not isinstance(key, ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
                self.problems.add(self.place(key), "a key must be a plain name")
            elif key.value in seen:
                self.problems.add(self.place(key), f"{key.value!r} appears twice")
            else:
                seen.add(key.value)
                yield key.value, key, value

    def scalar(self, node: Node, place: Place) -> Scalar:
        if node.tag == TIMESTAMP:
            return str(node.value)  # perhaps a folder's name: there are no dates in JSON, nor in a table
        try:
            value = self.constructor.construct_object(node)
        except (YAMLError, ValueError, LookupError):  # LookupError: for `!!bool maybe`, and for an empty `!!int`
            value = NotImplemented
        if isinstance(value, int) and value.bit_length() > LONGEST_NUMBER:
            self.problems.add(place, f"a number of more than {LONGEST_NUMBER} bits")
            return None
        if value is None or isinstance(value, Scalar):
            return value
        shown = in_a_line(repr(node.value))
        self.problems.add(place, f"{shown} is neither text, a number, true, false nor null; quote it if it is text")
        return None

    def place(self, node: Node) -> Place:
        if self.fixed is None:
            return Place(self.file, node.start_mark.line + 1, node.start_mark.column + 1)
        self.places += 1
        return replace(self.fixed, column=self.places - 1)

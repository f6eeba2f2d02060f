"""Reading bundles from any source: every claimed size is checked against the file before memory is allocated for it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.errors import UserError
from stages.hiding.bundle import (
    CONTAINER_FORMAT,
    DESCRIPTION,
    GAUSSIANS,
    IN_COMMENT,
    SECRET_DESCRIPTION,
    SECRET_FORMAT,
    VERSION,
    ContainerBundle,
    SecretBundle,
)
from stages.hiding.columns import VERTEX, attribute_of
from stages.hiding.message_names import TAKEN, is_taken
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS
from stages.hiding.weights import SUFFIX, Weights, read_weights
from stages.hiding.words import WORD
from stages.imaging.names import can_be_written
from stages.scene.ply.reading import Ply, read_ply

PARTS = ("method", "settings", "attributes")
LARGEST_JSON = 2**20  # bytes
MOST_ATTRIBUTES, MOST_AXES = 32, 4
MOST_MESSAGES = 1000
MOST_FACTS, MOST_NUMBERS, LARGEST_NUMBER = 32, 2**17, 2**53
LONGEST_TEXT = 200  # characters
LONGEST_FACT = 2**15
"""Of a word among a secret's facts, in characters. The longest are a seal's signs, 16 a channel beyond the eighth."""


def read_container_bundle(place: Path) -> ContainerBundle:
    """Read a bundle's folder, or a single PLY that holds its own description and has no networks.

    Raises `UserError` for files that are missing, broken or of another format. Whether networks and attributes fit the
    method is checked by `fitted_method`, not here.
    """
    if place.is_dir():
        description = json_of(place / DESCRIPTION, text_of(place, DESCRIPTION))
        if not (place / GAUSSIANS).exists():
            raise _not_a_bundle(place, GAUSSIANS)
        ply, networks = read_ply(place / GAUSSIANS), _networks(place, PUBLIC_NETWORKS)
    else:
        ply, networks = read_ply(place), {}
        description = json_of(place, _description_in(ply))
    check_format(ply.path, description, CONTAINER_FORMAT)
    method, settings, shapes = _checked(ply, description)
    attributes = {name: attribute_of(ply, name, shape) for name, shape in sorted(shapes.items())}
    return ContainerBundle(method, settings, attributes, networks)


def read_secret_bundle(place: Path) -> SecretBundle:
    """Read a secret bundle's folder. Raises `UserError` for files that are missing, broken or of another format."""
    path = place / SECRET_DESCRIPTION
    description = json_of(path, text_of(place, SECRET_DESCRIPTION))
    check_format(path, description, SECRET_FORMAT)
    messages = description.get("messages")
    if not (isinstance(messages, list) and len(messages) <= MOST_MESSAGES and all(map(_is_name, messages))):
        raise _no_names(path)
    if len(set(messages)) != len(messages):
        raise _no_names(path)
    return SecretBundle(tuple(messages), _networks(place, SECRET_NETWORKS), _facts(path, description.get("facts", {})))


def _facts(path: Path, facts: Any) -> dict[str, Any]:
    if isinstance(facts, dict) and len(facts) <= MOST_FACTS and all(map(_is_fact, facts.items())):
        return facts
    raise UserError(
        "the secret's facts are invalid",
        where=path,
        expected=f"at most {MOST_FACTS} words, finite numbers, or lists of these numbers",
    )


def _is_fact(fact: tuple[str, Any]) -> bool:
    name, value = fact
    word = isinstance(value, str) and can_be_written(value, LONGEST_FACT)
    numbers = isinstance(value, list) and len(value) <= MOST_NUMBERS and all(map(_is_number, value))
    return bool(WORD.fullmatch(name)) and name != "messages" and (word or numbers or _is_number(value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) <= LARGEST_NUMBER


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and can_be_written(value) and not is_taken(value)


def _no_names(path: Path) -> UserError:
    """The error does not quote what was found: messages' names must not appear in logs."""
    return UserError(
        "a secret without the messages' names",
        where=path,
        expected=f"a list `messages` of at most {MOST_MESSAGES} different names, none of them {TAKEN}",
        remedy="Fetch the file again from where the secret is kept.",
    )


def _checked(ply: Ply, description: Mapping[str, Any]) -> tuple[str, dict[str, Any], dict[str, tuple[int, ...]]]:
    """The method, its settings, and the attributes' shapes, none of which has more values than the PLY has columns."""
    columns = len(ply.rows(VERTEX).dtype.names or ())
    match description:
        case {"method": str(method), "settings": dict(settings), "attributes": dict(shapes)} if (
            WORD.fullmatch(method)
            and len(shapes) <= MOST_ATTRIBUTES
            and all(_is_attribute(name, shape, columns) for name, shape in shapes.items())
        ):
            return method, settings, {name: tuple(shape) for name, shape in shapes.items()}
    raise UserError(
        "the description of a container is not understood",
        where=ply.path,
        found=json.dumps({name: description.get(name) for name in PARTS})[:LONGEST_TEXT],
        expected=f"a method, its settings, and the shapes of attributes that are among {columns} columns",
    )


def _is_attribute(name: str, shape: Any, columns: int) -> bool:
    if not (WORD.fullmatch(name) and isinstance(shape, list) and len(shape) <= MOST_AXES):
        return False
    return all(type(size) is int and 0 <= size <= columns for size in shape) and math.prod(shape) <= columns


def check_format(path: Path, description: Mapping[str, Any], expected: str) -> None:
    """Raise `UserError` unless the description states the expected format and the supported version."""
    found = (description.get("format"), description.get("version"))
    if found != (expected, VERSION):
        raise UserError(
            "a description of the wrong format or version",
            where=path,
            found=f"format {found[0]!r}, version {found[1]!r}"[:LONGEST_TEXT],
            expected=f"format {expected!r}, version {VERSION}",
        )


def _description_in(ply: Ply) -> bytes:
    for comment in ply.comments:
        if comment.startswith(IN_COMMENT):
            return comment.removeprefix(IN_COMMENT).encode()
    raise UserError(
        "a PLY that does not say which container it is",
        where=ply.path,
        found=f"no comment {IN_COMMENT.strip()!r}",
        expected=f"{GAUSSIANS} as it was exported, or its folder",
    )


def _networks(place: Path, names: Sequence[str]) -> dict[str, Weights]:
    paths = {name: place / f"{name}{SUFFIX}" for name in names}
    return {name: read_weights(path) for name, path in paths.items() if path.exists()}


def text_of(place: Path, name: str) -> bytes:
    """The content of a bundle's JSON file, cut off one byte beyond what `json_of` accepts.

    Raises `UserError` if the file is missing or cannot be read.
    """
    path = place / name
    try:
        if not path.is_file():
            raise _not_a_bundle(place, name)
        with path.open("rb") as file:
            return file.read(LARGEST_JSON + 1)
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error


def _not_a_bundle(place: Path, name: str) -> UserError:
    """The error for a folder without the file `name`; the user may have swapped the folders, or renamed the file."""
    if place.is_file():
        return UserError(
            "no folder of a bundle",
            where=place,
            found="a file",
            expected="a folder",
            remedy="Give the folder that was exported; if this is a zip of it, unpack it.",
        )
    there = ", ".join(sorted(entry.name for entry in place.iterdir())[:5]) if place.is_dir() else "no folder"
    swapped = {
        DESCRIPTION: (SECRET_DESCRIPTION, "This is the secret folder: give it as `secret`, and the public one here."),
        SECRET_DESCRIPTION: (DESCRIPTION, "This is the public folder: give it as `bundle`, and the secret one here."),
        GAUSSIANS: (DESCRIPTION, f"If the PLY has another name here, rename it to {GAUSSIANS}."),
    }
    other, remedy = swapped.get(name, (name, None))
    return UserError(
        "no secret bundle" if name == SECRET_DESCRIPTION else "no bundle",
        where=place,
        found=there or "an empty folder",
        expected=f"a file {name} in it",
        remedy=remedy if (place / other).is_file() else None,
    )


def json_of(path: Path, text: bytes) -> dict[str, Any]:
    """Parse `text`, the content of `path`, as a JSON object. Raises `UserError` if it is none or has too many bytes."""
    try:
        content = json.loads(text) if len(text) <= LARGEST_JSON else None
    except (ValueError, RecursionError) as error:
        raise UserError(
            "no JSON",
            where=path,
            found=str(error)[:LONGEST_TEXT],
            expected="the file as it was exported",
            remedy="Fetch it again: it was damaged or edited.",
        ) from error
    if not isinstance(content, dict):
        raise UserError("no description", where=path, expected=f"a JSON object of at most {LARGEST_JSON} bytes")
    return content

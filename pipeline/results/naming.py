"""Finding the artifact that a person means: by its path, its digest, or its name in `latest`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path

from pipeline.artifact import Artifact, load
from pipeline.errors import CommandError, nearest
from pipeline.manifest import MANIFEST
from pipeline.plain_text import listed
from pipeline.store.external import from_home
from pipeline.store.opening import is_store, open_store
from pipeline.store.store import Store

PREFIX = re.compile(r"[0-9a-f]{6,64}")
SHOWN = 12  # names listed in an error
HOW_IT_ENDED: Mapping[str, str] = {"failed": "failed", "skipped": "was skipped"}  # states of stages that made nothing


def find_artifact(text: str, address: str | Path) -> tuple[Artifact, Store | None]:
    """The artifact that `text` names, and the store that it is in, if any.

    `text` is the path of an artifact, or the first six or more characters of a digest, or `WORKFLOW/STAGE.OUTPUT`; the
    workflow, the output and the row of a `foreach` may be left out if that is unambiguous. Digests and names are looked
    up in the store at `address`. Raises CommandError if there is no such store, or if `text` matches no artifact or
    several, CorruptArtifact if the artifact is damaged.
    """
    path = Path(text)
    if (path / MANIFEST).is_file():
        return load(path.resolve()), _store_around(path.resolve())
    store = open_existing(address)
    names = store.latest_digests()
    if PREFIX.fullmatch(text):
        found = {digest: _names_of(digest, names) for digest in store.objects if digest.startswith(text)}
        if found:
            return store.artifact(_only(text, found)), store
    if text in names:
        return store.artifact(names[text]), store
    found_names = {name: [name] for name in names if text in forms_of(name)}
    if not found_names:
        raise CommandError(
            f"no artifact {text!r}",
            where=store.address,
            expected=_expected(text, names),
            remedy=_why_absent(text, store),
        )
    return store.artifact(names[_only(text, found_names)]), store


@contextmanager
def finding(text: str, address: str | Path) -> Iterator[tuple[Artifact, Store | None]]:
    """Like `find_artifact`, but the store stays in use within the block, so that nothing is deleted from it.

    A store that cannot be written, such as another user's, is read without this protection. Also raises CommandError if
    results are being deleted.
    """
    artifact, store = find_artifact(text, address)
    with store.in_use() if store and os.access(store.root, os.W_OK) else nullcontext():
        yield artifact, store


def check_workflows(store: Store, names: Iterable[str]) -> None:
    """Raises CommandError if one of `names` is not a workflow that has run in this store."""
    known = store.history.workflows()
    for name in names:
        if name not in known:
            listed = ", ".join(known) or "none"
            raise CommandError(f"no workflow {name!r} has run here; those that have: {listed}{nearest(name, known)}")


def open_existing(address: str | Path) -> Store:
    """The store at an address. Raises CommandError for a folder that is not one: reading must not create a store."""
    if "://" not in str(address) and not (str(address) and is_store(from_home(address))):
        raise CommandError(
            "no store there", where=address, remedy="Say where results are kept with --store or $GS_HIDER_STORE."
        )
    return open_store(address)


def names_of(digest: str, store: Store) -> list[str]:
    """The names that an artifact has in `latest`; empty if it has none."""
    return _names_of(digest, store.latest_digests())


def _names_of(digest: str, names: dict[str, str]) -> list[str]:
    return [name for name, other in names.items() if other == digest]


def _store_around(path: Path) -> Store | None:
    """The store that holds the artifact at `path`; None if it is not in a store."""
    root = path.parent.parent
    return Store(root) if path.parent.name == "objects" and (root / "actions").is_dir() else None


def forms_of(name: str) -> list[str]:
    """What a person may type for a name in `latest`; the name itself comes first.

    >>> forms_of("hide/views[reef].views")  # doctest: +NORMALIZE_WHITESPACE
    ['hide/views[reef].views', 'hide/views[reef]', 'hide/views', 'hide/views.views',
     'views[reef].views', 'views[reef]', 'views', 'views.views']
    """
    workflow, _, rest = name.partition("/")
    stage, _, output = rest.rpartition(".")
    entry, bracket, _ = stage.partition("[")
    forms = [rest, stage, entry, *([f"{entry}.{output}"] if bracket else [])]
    return list(dict.fromkeys([*(f"{workflow}/{form}" for form in forms), *forms]))


def _only(text: str, found: dict[str, list[str]]) -> str:
    """The only key of `found`. Raises CommandError if there are several, with the names (the values) of each."""
    if len(found) > 1:
        candidates = [
            " = ".join(dict.fromkeys([name[:12] if PREFIX.fullmatch(name) else name, *names]))
            for name, names in found.items()
        ]
        raise CommandError(f"{text!r} may mean several artifacts; choose one of {listed(candidates, SHOWN)}")
    return next(iter(found))


def _expected(text: str, names: dict[str, str]) -> str:
    hint = nearest(text, [form for name in names for form in forms_of(name)])
    there = f"; there are {listed([*names], SHOWN)}" if names else ""
    return f"the path of an artifact, 6 or more characters of a digest, or WORKFLOW/STAGE.OUTPUT{there}{hint}"


def _why_absent(text: str, store: Store) -> str | None:
    """Why `latest` lacks what `text` names, and how to have what an earlier run made; None if no run failed over it."""
    earlier = _of_an_earlier_run(text, store)
    return _how_to_have_again(*earlier, store) if earlier else _why_not_made(text, store)


def _how_to_have_again(name: str, digest: str, store: Store) -> str | None:
    """How to have a result of an earlier run, with its name and digest; None if the last run did not fail."""
    workflow = name.partition("/")[0]
    for journal in store.history.journals(workflow)[:1]:
        failed = [stage for stage, result in store.history.results(journal).items() if result.state == "failed"]
        if failed:
            return (
                f"The last run of {workflow} failed in {failed[0]}, so `latest` has no links to its result or to what "
                "is made from it. Earlier results are still in the store: repeat their command to restore the links, "
                f"or name it by its digest, {digest[:12]}."
            )
    return None


def _why_not_made(text: str, store: Store) -> str | None:
    """Why the last run of a workflow did not make what `text` names; None if `text` names no stage that it lacks."""
    output = text.rpartition(".")[2]  # any: a stage that made nothing left no record of its outputs
    for workflow in store.history.workflows():
        for journal in store.history.journals(workflow)[:1]:
            for stage, result in store.history.results(journal).items():
                name = f"{workflow}/{stage}.{output}"
                if result.state in HOW_IT_ENDED and text in (name, *forms_of(name)):
                    why = f": {result.cause}" if result.cause else ""
                    return f"In the last run of {workflow}, {stage} {HOW_IT_ENDED[result.state]}{why}"
    return None


def _of_an_earlier_run(text: str, store: Store) -> tuple[str, str] | None:
    """The name and the digest of the newest result that `text` names, linked or not; None if there is none."""
    objects = store.objects
    named = ((name, digest) for name, digest in store.history.outputs() if text in (name, *forms_of(name)))
    return next(((name, digest) for name, digest in named if digest in objects), None)

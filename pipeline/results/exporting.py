"""Copies of artifacts for use elsewhere: a folder that `load` opens, or one .zip file with the same layout."""

from __future__ import annotations

import shutil
import uuid
import zipfile
from pathlib import Path

from pipeline.artifact import Artifact, load
from pipeline.errors import CommandError
from pipeline.manifest import MANIFEST
from pipeline.results.privacy import make_folder, new_file
from pipeline.store.store import Store

EARLIEST = (1980, 1, 1, 0, 0, 0)  # time that a .zip can store; a fixed one, so that equal artifacts give equal files


def export_artifact(artifact: Artifact, target: Path, zipped: bool, store: Store | None = None) -> None:
    """Copies an artifact to `target`, which appears whole or not at all. Every byte is checked against the manifest.

    Nobody else can read the copy of a private artifact. Raises CommandError if `target` exists or is inside `store`,
    CorruptArtifact if the artifact is not what was written.
    """
    if target.exists() or target.is_symlink():
        raise CommandError("already exists", where=target, remedy="Choose another name, or remove it first.")
    if store and target.resolve().is_relative_to(store.root.resolve()):
        raise CommandError("inside the store, where `gc` deletes what does not belong there", where=target)
    make_folder(target.absolute().parent, artifact.private)
    aside = target.absolute().parent / f".{target.name}.{uuid.uuid4().hex}"
    packed = aside.with_name(f"{aside.name}.zip")
    try:
        copy = _copied(artifact, aside)
        if zipped:
            _pack(copy, packed)
            packed.rename(target)
        else:
            aside.rename(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        packed.unlink(missing_ok=True)


def _copied(artifact: Artifact, folder: Path) -> Artifact:
    """A copy of what the manifest names, checked. Never opens a link or a pipe in the place of a file."""
    artifact.check_sizes()
    make_folder(folder, artifact.private)
    for name in (*artifact.manifest.files, MANIFEST):
        make_folder((folder / name).parent, artifact.private)
        with (artifact.path / name).open("rb") as source, new_file(folder / name, artifact.private) as file:
            shutil.copyfileobj(source, file)
    copy = load(folder)
    copy.verify()
    return copy


def _pack(artifact: Artifact, path: Path) -> None:
    """Packs a .zip without compression: chunks are compressed already. The same content gives the same bytes."""
    with new_file(path, artifact.private) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted((*artifact.manifest.files, MANIFEST)):
            entry = zipfile.ZipInfo(name, EARLIEST)
            entry.external_attr = (0o600 if artifact.private else 0o644) << 16
            with (artifact.path / name).open("rb") as source, archive.open(entry, "w", force_zip64=True) as packed:
                shutil.copyfileobj(source, packed)

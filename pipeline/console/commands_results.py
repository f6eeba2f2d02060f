"""`show` and `export`: looking at results, and copying them elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from pipeline.console.console import ArtifactName, Json, Reveal, StoreAddress, near, reported, say
from pipeline.disk import written_to


def show(
    artifact: ArtifactName,
    store: StoreAddress = "store",
    pictures: Annotated[
        Path | None,
        typer.Option(
            "--pictures", metavar="FOLDER", help="Also writes its pictures to this folder, as PNG.", show_default=False
        ),
    ] = None,
    limit: Annotated[
        int, typer.Option("--limit", min=1, metavar="N", help="At most this many pictures, spread evenly over all.")
    ] = 16,
    everything: Annotated[bool, typer.Option("--all", help="Every row, line, file and picture.")] = False,
    reveal: Reveal = False,
    as_json: Json = False,
) -> None:
    """Shows what is in an artifact and how it was made, and writes its pictures to files.

    \b
    python -m pipeline show hide_multi/sealed.container
    python -m pipeline show scores.public_scores --all       STAGE.OUTPUT is enough if there is only one of that name
    python -m pipeline show 3fa9c1d2                         the start of a digest, as printed by `show`
    python -m pipeline show hide_multi/cover.scene --pictures seen --limit 4
    python -m pipeline show 'message_views[reef]' --reveal   a private one, with its values

    Of a private artifact, only names, shapes and sizes are shown, unless --reveal is given. Its pictures are written as
    files that only you can read, and only to private places: folders that only you can enter, because they or a folder
    above them are yours and closed to others (mode 0700), and that are not in a git work tree. With --reveal they are
    written anywhere. Existing files are never overwritten.
    """
    with reported(store):
        from pipeline.console.showing import lines_of
        from pipeline.results.description import as_json as description_as_json
        from pipeline.results.description import describe
        from pipeline.results.naming import finding
        from pipeline.results.pictures import write_pictures
        from pipeline.results.privacy import check_place

        with finding(artifact, store) as (found, its_store):
            if pictures:
                check_place(found, pictures, reveal)
            description = describe(found, its_store, reveal)
            if as_json:
                print(json.dumps(description_as_json(description)))
            else:
                print("\n".join(lines_of(description, everything)))
            if pictures:
                with written_to(pictures):
                    paths, number = write_pictures(found, pictures, None if everything else limit)
                of, more = (f" of {number}", "; --all or --limit N writes more") if len(paths) < number else ("", "")
                words = f"{len(paths)}{of} pictures, in {near(pictures.absolute())}{more}"
                say(words if number else "It contains no pictures.")


def export(
    artifact: ArtifactName,
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="Where to copy it; must not exist yet.")],
    store: StoreAddress = "store",
    zipped: Annotated[bool, typer.Option("--zip", help="One .zip file; implied if TARGET ends in .zip.")] = False,
    reveal: Reveal = False,
) -> None:
    """Copies an artifact out of the store, checking every byte: to a folder, or to one .zip file of the same layout.

    \b
    python -m pipeline export hide_multi/sealed.container container
    python -m pipeline export hide_multi/sealed.container container.zip
    mkdir -m 700 ~/secrets && python -m pipeline export hide_multi/hide.secret ~/secrets/reef

    `pipeline.artifact.load` opens the folder, and `show` shows it. A private artifact is copied so that only you can
    read it, and only to private places: folders that only you can enter, because they or a folder above them are yours
    and closed to others (mode 0700), and that are not in a git work tree. With --reveal it is copied anywhere.
    """
    with reported(store):
        from pipeline.results.exporting import export_artifact
        from pipeline.results.naming import finding
        from pipeline.results.privacy import check_place

        with finding(artifact, store) as (found, its_store):
            check_place(found, target, reveal)
            with written_to(target):
                export_artifact(found, target, zipped or target.suffix == ".zip", its_store)
            say(f"{found.kind} {found.digest[:12]} is in {near(target.absolute())}")

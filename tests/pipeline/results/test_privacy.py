"""Which places are public, and how the files of private artifacts are written."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import CommandError
from pipeline.results.exporting import export_artifact
from pipeline.results.privacy import check_place, make_folder, new_file, why_public


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that others can enter, unlike those of pytest."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        Path(name).chmod(0o755)
        yield Path(name)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def artifact(folder: Path, private: bool) -> Artifact:
    with create(folder / "artifact", "numbers", private) as writer:
        writer.attributes["count"] = 1
    return load(folder / "artifact")


def test_a_place_that_others_can_enter(open_folder: Path) -> None:
    assert why_public(open_folder / "new" / "deep") == f"others can enter {open_folder}"
    assert why_public(open_folder) == f"others can enter {open_folder}"


def test_a_closed_folder_anywhere_above_is_enough(open_folder: Path) -> None:
    closed = open_folder / "closed"
    closed.mkdir(mode=0o700)
    (closed / "open").mkdir(mode=0o755)
    for path in (closed, closed / "new", closed / "open" / "new"):
        assert why_public(path) is None
    closed.chmod(0o710)
    assert why_public(closed / "open") is not None


def test_a_closed_folder_of_another_user_is_no_private_place(
    open_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = open_folder / "closed"
    closed.mkdir(mode=0o700)
    another = closed.stat().st_uid + 1
    monkeypatch.setattr(os, "geteuid", lambda: another)
    assert why_public(closed / "new") == f"others can enter {closed}"


def test_a_git_work_tree_is_public_however_closed(open_folder: Path) -> None:
    tree = open_folder / "tree"
    (tree / ".git").mkdir(parents=True)
    tree.chmod(0o700)
    assert why_public(tree / "results") == f"it is in the git work tree {tree}"
    (tree / "deep" / "results").mkdir(parents=True, mode=0o700)
    assert why_public(tree / "deep" / "results") == f"it is in the git work tree {tree}"


def test_dots_count_as_where_they_lead_once_the_folder_before_them_is_there(open_folder: Path) -> None:
    closed = open_folder / "closed"
    closed.mkdir(mode=0o700)
    assert why_public(closed / "new" / ".." / ".." / "copy") == f"others can enter {open_folder}"
    assert why_public(closed / "new" / ".." / "copy") is None


def test_a_link_counts_as_where_it_leads(open_folder: Path, tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    (closed / "out").symlink_to(open_folder)
    assert why_public(closed / "out" / "new") is not None


def test_private_artifacts_and_public_places(open_folder: Path, tmp_path: Path) -> None:
    secret = artifact(tmp_path, private=True)
    with pytest.raises(CommandError, match=r"public place: others can enter .* add --reveal"):
        check_place(secret, open_folder / "out", reveal=False)
    check_place(secret, open_folder / "out", reveal=True)
    (tmp_path / "public").mkdir()
    check_place(artifact(tmp_path / "public", private=False), open_folder / "out", reveal=False)


def test_the_remedy_for_a_public_place_works_to_the_letter(open_folder: Path, tmp_path: Path) -> None:
    secret, folder = artifact(tmp_path, private=True), open_folder / "FOLDER"
    with pytest.raises(CommandError) as refused:
        check_place(secret, folder, reveal=False)
    command, place = re.findall(r"mkdir -m 700 FOLDER|FOLDER/\w+", str(refused.value))
    subprocess.run(command.split(), cwd=open_folder, check=True)
    check_place(secret, open_folder / place, reveal=False)
    export_artifact(secret, open_folder / place, zipped=False)
    assert load(open_folder / place).digest == secret.digest


def test_files_and_folders_are_closed_from_the_start(open_folder: Path) -> None:
    before = os.umask(0)
    try:
        make_folder(open_folder / "a" / "b", private=True)
        make_folder(open_folder / "c", private=False)
        for name, private in (("a/x", True), ("c/x", False)):
            (open_folder / name).write_text("old")
            (open_folder / name).chmod(0o666)
            with new_file(open_folder / name, private) as file:
                assert mode(open_folder / name) == (0o600 if private else 0o666)
                file.write(b"new")
    finally:
        os.umask(before)
    assert (mode(open_folder / "a"), mode(open_folder / "a/b"), mode(open_folder / "c")) == (0o700, 0o700, 0o777)
    assert (open_folder / "a/x").read_text() == "new"
    assert mode(open_folder) == 0o755, "what was there stays as it was"


def test_a_link_in_place_of_the_file_is_not_followed(open_folder: Path) -> None:
    (open_folder / "target").write_text("kept")
    (open_folder / "x").symlink_to("target")
    with new_file(open_folder / "x", private=True) as file:
        file.write(b"secret")
    assert (open_folder / "target").read_text() == "kept"

"""What is outside the store: its digest, and links of strangers, which may lead to the whole disk."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from pipeline.errors import UserError
from pipeline.store.external import contents_of


@pytest.mark.parametrize("target", ["/", "..", "../..", "."])
def test_a_link_that_leads_above_itself_is_told_before_all_that_is_there_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    folder = tmp_path / "above" / "photos"
    folder.mkdir(parents=True)
    (tmp_path / "above" / "other" / "deeper").mkdir(parents=True)
    (folder / "link").symlink_to(target, target_is_directory=True)
    listed: list[Path] = []
    scan = os.scandir

    def scanned(path: str | int) -> object:
        if not isinstance(path, int):  # a descriptor: what is removed meanwhile, when Python collects its garbage
            listed.append(Path(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", scanned)
    with pytest.raises(UserError, match="photos/link: a link leads back to a folder above it"):
        contents_of(folder)
    assert set(listed) <= {folder, folder / "link"}


def test_a_link_to_a_folder_elsewhere_is_followed(tmp_path: Path) -> None:
    """Many people keep photos on another disk."""
    for name in ("photos", "elsewhere"):
        (tmp_path / name).mkdir()
    (tmp_path / "elsewhere" / "a.png").write_bytes(b"a")
    (tmp_path / "photos" / "images").symlink_to(tmp_path / "elsewhere")
    assert list(contents_of(tmp_path / "photos").files) == ["images/a.png"]


@pytest.mark.parametrize("is_folder", [False, True])
def test_the_same_bytes_of_another_name_have_another_digest(tmp_path: Path, is_folder: bool) -> None:
    """Poses refer to photos by name; where the photos lie does not matter."""
    digests = []
    for folder, name in (("here", "a.png"), ("there", "a.png"), ("there", "b.png")):
        file = tmp_path / folder / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"a")
        digests.append(contents_of(file.parent if is_folder else file).digest)
        file.unlink()
    here, there, renamed = digests
    assert here == there != renamed


def test_a_pipe_or_a_device_is_refused_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for path in (tmp_path / "pipe", tmp_path / "link", Path("/dev/zero")):
        with pytest.raises(UserError, match=f"{path}: is neither a file nor a folder. Copy"):
            contents_of(path)


def test_what_is_not_there_is_told_as_that(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot be read; found No such file or directory. Check the path"):
        contents_of(tmp_path / "nowhere")


def test_what_one_may_not_read_is_told_with_a_way_out(tmp_path: Path) -> None:
    photo = tmp_path / "photos" / "a.png"
    photo.parent.mkdir()
    photo.write_bytes(b"a")

    def refused(path: Path) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    with pytest.raises(UserError, match=f"{photo}: cannot be read; found Permission denied. Give yourself the right"):
        contents_of(photo.parent, refused)


def test_the_digest_is_of_names_and_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "deep").mkdir(parents=True)
        (tmp_path / name / "deep" / "x.jpg").write_bytes(b"1")
        (tmp_path / name / "y.jpg").write_bytes(b"2")
    digest = contents_of(tmp_path / "a").digest
    assert contents_of(tmp_path / "b").digest == digest
    (tmp_path / "b" / "y.jpg").rename(tmp_path / "b" / "z.jpg")
    assert contents_of(tmp_path / "b").digest != digest
    (tmp_path / "a" / "deep" / "x.jpg").write_bytes(b"3")
    assert contents_of(tmp_path / "a").digest != digest


def test_links_that_lead_nowhere_or_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.jpg").symlink_to("missing")
    with pytest.raises(UserError, match="neither a file nor a folder"):
        contents_of(tmp_path / "a")
    (tmp_path / "a" / "x.jpg").unlink()
    (tmp_path / "a" / "again").symlink_to(tmp_path / "a")
    with pytest.raises(UserError, match="back to a folder above it"):
        contents_of(tmp_path / "a")

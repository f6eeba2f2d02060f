"""Captures whose poses come in one file for each split, as those of NeRF's synthetic scenes, which Blender rendered.

`transforms_train.json` and `transforms_test.json` name pictures of the same name in the folders `train` and `test`, so
names begin with the split here: `train_r_0.png`. Where a split's pictures lie in several folders, these are in the
names, too: `train_left_r_0.png`. The split `val` is left out, as others leave it out.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.errors import UserError
from stages.scene.capture import PoseSource
from stages.scene.colmap import PosedPhoto
from stages.scene.photo_folder import SUFFIXES, PhotoFolder, named_photos, read_poses, refuse_unwritten_names
from stages.scene.transforms import frame_files

TRAIN, TEST = "train", "test"


def find_splits(folder: Path) -> dict[str, Path]:
    """The file of poses of each split of a capture; empty where it has none for training.

    A split for tests without frames is left out. Raises `UserError` for one that cannot be read.
    """
    files = {split: folder / f"transforms_{split}.json" for split in (TRAIN, TEST)}
    if not files[TRAIN].is_file():
        return {}
    return {TRAIN: files[TRAIN]} | ({TEST: files[TEST]} if files[TEST].is_file() and frame_files(files[TEST]) else {})


def find_split_photos(folder: Path, splits: Mapping[str, Path]) -> PhotoFolder:
    """The photos that the splits' frames name, which may leave the extension out, and no others.

    Raises `UserError` where one is not there, or lies outside of `folder`, since what does could change unseen, and for
    names as `named_photos` does.
    """
    photos: dict[str, Path] = {}
    for split, file in splits.items():
        own = list(dict.fromkeys(_photo_of(folder, file, frame) for frame in frame_files(file)))
        if own:
            shared = Path(os.path.commonpath([photo.parent for photo in own]))
            photos |= {f"{split}_{name}": photo for name, photo in named_photos(shared, own).items()}
    refuse_unwritten_names(folder, photos)
    return PhotoFolder(dict(sorted(photos.items())), 0)


def _photo_of(folder: Path, file: Path, frame: str) -> Path:
    inside = not Path(frame).is_absolute() and ".." not in Path(frame).parts
    candidates = [folder / f"{frame}{suffix}" for suffix in ("", *SUFFIXES)] if inside and "\0" not in frame else []
    for candidate in candidates:
        if candidate.suffix.lower() in SUFFIXES and _is_file(candidate):
            return candidate
    raise UserError(
        "poses came for photos that do not exist",
        where=file,
        found=repr(frame[:80]),
        expected=f"a file_path of a photo in the capture's folder, with or without {', '.join(SUFFIXES)}",
        remedy="Put the photo there, or take the frame out.",
    )


def _is_file(candidate: Path) -> bool:
    try:
        return candidate.is_file()
    except OSError:  # a name that no file system has room for
        return False


def read_split_poses(
    splits: Mapping[str, Path], sizes: Mapping[str, tuple[int, int]]
) -> tuple[PoseSource, list[PosedPhoto]]:
    """The poses of all splits under the names in `sizes`, sorted. Raises `UserError` as `read_poses` does."""
    posed: list[PosedPhoto] = []
    for split, file in splits.items():
        before = f"{split}_"
        own = {name.removeprefix(before): size for name, size in sizes.items() if name.startswith(before)}
        posed += [replace(photo, name=before + photo.name) for photo in read_poses(file, own)[1]]
    return "transforms", sorted(posed, key=lambda photo: photo.name)

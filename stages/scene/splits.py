"""Captures whose poses come in one file for each split, as those of NeRF's synthetic scenes, which Blender rendered.

`transforms_train.json` and `transforms_test.json` name pictures of the same name in the folders `train` and `test`, so
names begin with the split here: `train_r_0.png`. Where a split's pictures lie in several folders, these are in the
names, too: `train_left_r_0.png`. The split `val` is left out, as others leave it out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from stages.scene.capture import PoseSource
from stages.scene.colmap import PosedPhoto
from stages.scene.given_poses import read_poses
from stages.scene.named_frames import photo_of_frame, under_one_folder
from stages.scene.photo_folder import PhotoFolder, refuse_unwritten_names
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
        own = list(dict.fromkeys(photo_of_frame(folder, file, frame) for frame in frame_files(file)))
        photos |= {f"{split}_{name}": photo for name, photo in under_one_folder(own).items()}
    refuse_unwritten_names(folder, photos)
    return PhotoFolder(dict(sorted(photos.items())), 0)


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

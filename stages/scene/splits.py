"""Captures with one file of poses per split, such as NeRF's synthetic scenes, rendered in Blender.

`transforms_train.json` and `transforms_test.json` name pictures with the same names in the folders `train` and `test`,
so here names begin with the split: `train_r_0.png`. If a split's pictures are in several folders, names include these,
too: `train_left_r_0.png`. The split `val` is left out, as is usual.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from stages.scene.capture import PoseSource
from stages.scene.colmap import PosedPhoto
from stages.scene.given_poses import read_poses
from stages.scene.named_frames import photo_of_frame, photos_there, under_one_folder
from stages.scene.photo_folder import PhotoFolder, refuse_unwritten_names
from stages.scene.transforms import frame_files

TRAIN, TEST = "train", "test"


def find_splits(folder: Path) -> dict[str, Path]:
    """The file of poses of each split of a capture; empty if it has none for training.

    A test split of which no photo exists is left out: BlenderNeRF writes its cameras without rendering them. Raises
    `UserError` if its file cannot be read.
    """
    files = {split: folder / f"transforms_{split}.json" for split in (TRAIN, TEST)}
    if not files[TRAIN].is_file():
        return {}
    if files[TEST].is_file() and photos_there(folder, files[TEST], frame_files(files[TEST])):
        return files
    return {TRAIN: files[TRAIN]}


def find_split_photos(folder: Path, splits: Mapping[str, Path]) -> PhotoFolder:
    """The photos that the splits' frames name, with or without extension, and no others.

    Raises `UserError` if all of a split are missing, or outside `folder`, where they could change unseen, and as
    `named_photos` does.
    """
    photos: dict[str, Path] = {}
    for split, file in splits.items():
        frames = frame_files(file)
        own = photos_there(folder, file, frames) or [photo_of_frame(folder, file, frame) for frame in frames[:1]]
        photos |= {f"{split}_{name}": photo for name, photo in under_one_folder(own).items()}
    refuse_unwritten_names(folder, photos)
    return PhotoFolder(dict(sorted(photos.items())), 0)


def read_split_poses(
    splits: Mapping[str, Path], sizes: Mapping[str, tuple[int, int]]
) -> tuple[PoseSource, list[PosedPhoto], list[str]]:
    """What `read_poses` returns of each split, together, under the names in `sizes`; raises `UserError` as it does."""
    posed: list[PosedPhoto] = []
    missing: list[str] = []
    for split, file in splits.items():
        before = f"{split}_"
        own = {name.removeprefix(before): size for name, size in sizes.items() if name.startswith(before)}
        _, of_split, missing_of_split = read_poses(file, own)
        posed += [replace(photo, name=before + photo.name) for photo in of_split]
        missing += missing_of_split
    return "transforms", sorted(posed, key=lambda photo: photo.name), missing

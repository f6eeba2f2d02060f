"""What the structure-from-motion process receives and returns: plain numbers in JSON and NumPy files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from stages.scene.lens import Lens
from stages.scene.pairing import Pair

JOB, FACTS, ARRAYS, CORNERS = "job.json", "facts.json", "arrays.npz", "corners.npy"
PHASES = ("features", "matching", "mapping")


def working_name(row: int) -> str:
    """The file name of photo number `row` while structure from motion works on it."""
    return f"{row:06d}.png"


@dataclass(frozen=True)
class Job:
    """V working pictures in `folder`, named by `working_name`, and what to do with them.

    `lenses` are initial values, or known if `poses` (world to camera) are given; photos with equal lenses share one
    camera if their `taken_by` is equal, too. `pairs` are the photos to match, `pairs_in_need` those to match as well if
    the first place too few. `width` and `height` are the training size. `photo_size` is the photos' size if they all
    share one that is not reduced, else None. If `points_known`, only the lenses are used: there are no pictures.
    """

    folder: Path
    lenses: tuple[Lens, ...]
    focal_known: tuple[bool, ...]
    taken_by: tuple[int, ...]
    poses: tuple[tuple[tuple[float, ...], ...], ...] | None
    pairs: tuple[Pair, ...]
    pairs_in_need: tuple[Pair, ...]
    max_features: int
    width: int
    height: int
    seed: int
    threads: int
    photo_size: tuple[int, int] | None = None
    points_known: bool = False

    def write(self) -> Path:
        """Write the job beside the pictures, and return the file's path."""
        path = self.folder / JOB
        path.write_text(json.dumps(asdict(self) | {"folder": str(self.folder)}))
        return path


def read_job(path: Path) -> Job:
    """Read what `Job.write` wrote."""
    content = json.loads(path.read_text())
    poses = content["poses"]
    return Job(
        **content
        | {
            "folder": Path(content["folder"]),
            "lenses": tuple(
                Lens(one["model"], tuple(one["parameters"]), one["width"], one["height"]) for one in content["lenses"]
            ),
            "focal_known": tuple(content["focal_known"]),
            "taken_by": tuple(content["taken_by"]),
            "poses": None if poses is None else tuple(tuple(tuple(row) for row in pose) for pose in poses),
            "photo_size": None if content["photo_size"] is None else tuple(content["photo_size"]),
            "pairs": tuple((first, second) for first, second in content["pairs"]),
            "pairs_in_need": tuple((first, second) for first, second in content["pairs_in_need"]),
        }
    )


@dataclass(frozen=True)
class Reconstruction:
    """R registered photos (`rows`, ascending, of the job's V), P points, and one pinhole for all pictures.

    `lens_of`: each registered photo's lens, a row of `read_corners` and of `lens_shares`. The latter are the fractions
    that the pinhole shows of the picture that each lens alone would give (see `shares_shown`). `points_seen`: how many
    of the points each registered photo sees. The reprojection error is in working pixels; if points came with the
    photos it is theirs, or None if unknown. If too few photos registered, there are no rows, lenses, points or corners.
    `folded`: rows left out because their lens folds over (see `folded_lenses`). `cropping`: rows left out because they
    would have cropped all others (see `cropping_lenses`).
    """

    rows: tuple[int, ...]
    world_to_camera: Float64[np.ndarray, "R 4 4"]
    intrinsics: Float64[np.ndarray, "3 3"]
    lens_of: tuple[int, ...]
    lens_shares: tuple[float, ...]
    points_seen: tuple[int, ...]
    points: Float32[np.ndarray, "P 3"]
    point_colors: UInt8[np.ndarray, "P 3"]
    mean_reprojection_error: float | None
    lens_parameters: tuple[str, ...]
    folded: tuple[int, ...]
    cropping: tuple[int, ...]
    seconds: dict[str, float]
    version: str

    def write(self, folder: Path) -> None:
        """Write what `read_reconstruction` reads into `folder`."""
        facts = {
            "rows": self.rows,
            "lens_of": self.lens_of,
            "lens_shares": self.lens_shares,
            "points_seen": self.points_seen,
            "mean_reprojection_error": self.mean_reprojection_error,
            "lens_parameters": self.lens_parameters,
            "folded": self.folded,
            "cropping": self.cropping,
            "seconds": self.seconds,
            "version": self.version,
        }
        np.savez(
            folder / ARRAYS,
            world_to_camera=self.world_to_camera,
            intrinsics=self.intrinsics,
            points=self.points,
            point_colors=self.point_colors,
        )
        (folder / FACTS).write_text(json.dumps(facts))


def read_reconstruction(folder: Path) -> Reconstruction:
    """Read what `Reconstruction.write` wrote."""
    facts = json.loads((folder / FACTS).read_text())
    for name in ("rows", "lens_of", "lens_shares", "points_seen", "lens_parameters", "folded", "cropping"):
        facts[name] = tuple(facts[name])
    with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
        return Reconstruction(**facts, **{name: arrays[name] for name in arrays.files})


def write_corners(
    folder: Path, shape: tuple[int, ...], corners: Iterable[Float32[np.ndarray, "rows columns 2"]]
) -> None:
    """Write the corners of `shape[0]` lenses one by one: all together, with one lens per photo, would take gigabytes.

    The file is not memory-mapped: on a full disk, that would kill the process without a message.
    """
    with (folder / CORNERS).open("wb") as file:
        header = {"descr": np.lib.format.dtype_to_descr(np.dtype(np.float32)), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for positions in corners:
            file.write(positions.astype(np.float32, copy=False).tobytes())


def read_corners(folder: Path) -> Float32[np.ndarray, "C rows columns 2"]:
    """For each of C lenses, where the corners of the pinhole's pixels lie in its working pictures (see `undistort`).

    Memory-mapped: only what is accessed is read.
    """
    corners: np.ndarray = np.load(folder / CORNERS, mmap_mode="r", allow_pickle=False)
    return corners

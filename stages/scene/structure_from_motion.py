"""Structure from motion of a capture: working pictures, the reconstructing process, and undistorted pictures."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from pipeline.companion import Said, work_together
from pipeline.errors import Interrupted, UserError
from stages.imaging.pictures import read_picture, resize_picture
from stages.scene.cameras import Cameras
from stages.scene.capture import Capture, KnownPoses, in_order_of_numbers
from stages.scene.feature_database import drop_damaged_database
from stages.scene.known_points import KnownPoints
from stages.scene.lens import MODELS, Lens
from stages.scene.pairing import Matching, choose_pairs
from stages.scene.reconstruction_job import (
    ARRAYS,
    CORNERS,
    FACTS,
    Job,
    Reconstruction,
    read_corners,
    read_reconstruction,
    working_name,
)
from stages.scene.scene import Scene, held_out_by_number
from stages.scene.undistortion import even_sides, training_size, undistort

PROCESS = "stages.scene.reconstruction_process"
"""The module that runs as a separate process; it is not imported here, for the reasons it gives."""

SHARES = {
    "reading": (0.0, 0.05),
    "features": (0.05, 0.25),
    "matching": (0.25, 0.7),
    "mapping": (0.7, 0.95),
    "undistortion": (0.95, 1.0),
}
"""Start and end of each phase, as fractions of the overall progress."""
SHARES_WITH_POINTS = {"lenses": (0.0, 0.1), "undistortion": (0.1, 1.0)}
"""The same if points came with the photos, so that nothing is matched."""

WHERE = "where SFM is the stage's name in the workflow, such as cover_scene"
"""Explains SFM in a remedy: a stage does not know its name in a workflow."""
FEWEST_PHOTOS, FEWEST_POINTS = 3, 10
MOST_NAMED = 5  # photos, in an error
MOST_THREADS = 8  # each extracts features of one photo, in an estimated half gibibyte for 1.6 megapixels
GUESSED_FOCAL_LENGTH = 1.2  # times the longer side: COLMAP's own guess without EXIF


@dataclass(frozen=True)
class Settings:
    """How to reconstruct; sizes are long sides in pixels. See the parameters of the stage `sfm`."""

    width: int
    matching_size: int
    matching: Matching
    max_features: int
    camera_model: str
    minimum_registered: float
    seed: int


@dataclass(frozen=True)
class Watcher:
    """The stage's callbacks: overall progress from 0 to 1, lines for the log, and whether to stop."""

    progress: Callable[[float], None]
    log: Callable[[str], None]
    stop_requested: Callable[[], bool]
    shares: Mapping[str, tuple[float, float]] = field(default_factory=lambda: SHARES)

    def phase(self, name: str, done: float, total: float) -> None:
        """Report progress within a phase. Raises `Interrupted` if asked to stop."""
        start, end = self.shares[name]
        self.progress(start + (end - start) * done / max(total, 1))
        if self.stop_requested():
            raise Interrupted(f"stopped while {name} was under way")


def reconstruct(
    capture: Capture,
    pictures: Mapping[str, Path],
    poses: KnownPoses | None,
    settings: Settings,
    scratch: Path,
    watcher: Watcher,
) -> tuple[Scene, Reconstruction]:
    """The scene of a capture with its photos at `pictures`, and how the reconstruction went.

    Given `poses` are kept, with the points that came with them; without points, these are triangulated. If `poses` is
    None, cameras are estimated. Work of an interrupted run in `scratch` is reused. Raises `UserError` for fewer than
    three photos, for fewer placed than `minimum_registered`, for hardly any points, for given lenses that fold over,
    and if the process fails; `Interrupted` if the watcher asks to stop.
    """
    if len(capture.names) < FEWEST_PHOTOS:
        raise UserError(
            "too few photos for structure from motion",
            found=f"{len(capture.names)} ({', '.join(capture.names)})",
            expected=f"at least {FEWEST_PHOTOS} that overlap, for a good scene 20 to 200",
            remedy="Give the folder of all of them to the stage photos; its parameter images names one in it.",
        )
    folder = scratch / "reconstruction"
    folder.mkdir(parents=True, exist_ok=True)
    points = None if poses is None else poses.points
    if points is None:
        sizes = write_working_pictures(capture, pictures, settings.matching_size, folder, watcher)
    else:
        sizes, watcher = list(capture.sizes), replace(watcher, shares=SHARES_WITH_POINTS)
    job = job_of(capture, sizes, poses, settings, folder)
    run_process(job, watcher)
    result = read_reconstruction(folder)
    if points is not None:
        result = with_points(result, points)
    if poses is not None:
        refuse_folded(capture, result)
    refuse_few(capture, result, settings, given=poses is not None)
    return scene_of(capture, pictures, sizes, job, result, watcher), result


def write_working_pictures(
    capture: Capture, pictures: Mapping[str, Path], matching_size: int, folder: Path, watcher: Watcher
) -> list[tuple[int, int]]:
    """Write upright pictures for matching, with long sides of at most `matching_size`; returns their sizes."""
    sizes = []
    for row, name in enumerate(capture.names):
        watcher.phase("reading", row, len(capture.names))
        picture = read_picture(pictures[name])
        height, width = picture.shape[:2]
        factor = min(1.0, matching_size / max(width, height))
        picture = resize_picture(picture, max(1, round(width * factor)), max(1, round(height * factor)))
        target = folder / working_name(row)
        if not cv2.imwrite(str(target), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1]):
            raise UserError("a working picture cannot be written", where=target, remedy="Is the disk full?")
        sizes.append((picture.shape[1], picture.shape[0]))
    return sizes


def job_of(
    capture: Capture, sizes: list[tuple[int, int]], poses: KnownPoses | None, settings: Settings, folder: Path
) -> Job:
    """The job for the process."""
    if poses is not None:
        lenses = [lens.resized(*size) for lens, size in zip(poses.lenses, sizes, strict=True)]
        known = [True] * len(lenses)
    else:
        known = [focal is not None for focal in capture.focal_pixels]
        lenses = [starting_lens(capture, row, size, settings.camera_model) for row, size in enumerate(sizes)]
    points_known = poses is not None and poses.points is not None
    known_poses = None if poses is None else poses.world_to_camera
    order = in_order_of_numbers(capture.names)
    pairs, in_need = choose_pairs(settings.matching, order, capture.ordered, known_poses)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    size, count = Counter(capture.sizes).most_common(1)[0]
    width, height = training_size(size, settings.width)
    is_kept = count == len(capture.sizes) and (width, height) == even_sides(size)
    return Job(
        folder=folder,
        lenses=tuple(lenses),
        focal_known=tuple(known),
        taken_by=capture.taken_by or (0,) * len(lenses),
        poses=None if poses is None else tuple(tuple(map(tuple, pose)) for pose in poses.world_to_camera.tolist()),
        pairs=() if points_known else tuple(sorted(pairs)),
        pairs_in_need=() if points_known else tuple(sorted(in_need)),
        max_features=settings.max_features,
        width=width,
        height=height,
        seed=settings.seed,
        threads=min(MOST_THREADS, cores),
        photo_size=size if is_kept else None,
        points_known=points_known,
    )


def starting_lens(capture: Capture, row: int, size: tuple[int, int], model: str) -> Lens:
    """An initial lens: EXIF's focal length or a guess, without distortion. Photos with equal ones share a camera."""
    focal_pixels = capture.focal_pixels[row]
    scale = max(size) / max(capture.sizes[row])
    focal = GUESSED_FOCAL_LENGTH * max(size) if focal_pixels is None else round(focal_pixels * scale, 3)
    focal_lengths, distortions = MODELS[model]
    parameters = (*[focal] * focal_lengths, size[0] / 2, size[1] / 2, *[0.0] * distortions)
    return Lens(model, parameters, *size)


def run_process(job: Job, watcher: Watcher) -> None:
    """Run the process to its end; it is killed if the watcher asks to stop."""
    for name in (FACTS, ARRAYS, CORNERS):
        (job.folder / name).unlink(missing_ok=True)
    damage = drop_damaged_database(job.folder, len(job.lenses))
    if damage is not None:
        watcher.log(f"the features of an interrupted run are damaged and found anew: {damage}")
    at: tuple[str, float, float] = ("lenses" if job.points_known else "features", 0.0, 1.0)

    def heard(said: Said) -> None:
        nonlocal at
        phase, done, total = said["phase"], said["done"], said["total"]
        if phase != at[0]:
            watcher.log(f"{phase} of {total}")
        at = (phase, done, total)
        watcher.phase(*at)

    work_together(
        "structure from motion",
        PROCESS,
        [job.write()],
        heard,
        watch=lambda: watcher.phase(*at),
        remedy="Less memory is needed with a smaller matching_size, max_features or width.",
    )


def with_points(result: Reconstruction, points: KnownPoints) -> Reconstruction:
    """The reconstruction with the points that came with the photos."""
    return replace(
        result,
        points=points.positions.astype(np.float32),
        point_colors=points.colors,
        points_seen=tuple(int(points.seen[row]) for row in result.rows),
        mean_reprojection_error=points.error,
    )


def refuse_folded(capture: Capture, result: Reconstruction) -> None:
    """Raise `UserError` if lenses that came with the photos fold over."""
    if result.folded:
        raise UserError(
            "lenses that came with the photos fold over, or cannot be inverted within them",
            found=f"that of {_named(capture, result.folded)}",
            expected="the distortion of a real lens",
            remedy="Correct them in the file of poses, or take these photos out of it; or have poses and lenses "
            f"estimated: add --set SFM.poses=estimate to the command, {WHERE}.",
        )


def _named(capture: Capture, rows: tuple[int, ...]) -> str:
    """How many photos, and the names of the first few."""
    more = ", …" if len(rows) > MOST_NAMED else ""
    return f"{len(rows)} photos ({', '.join(capture.names[row] for row in rows[:MOST_NAMED])}{more})"


def refuse_few(capture: Capture, result: Reconstruction, settings: Settings, given: bool) -> None:
    """Raise `UserError` if too little was reconstructed for training."""
    registered, total = len(result.rows), len(capture.names)
    if registered < max(1, settings.minimum_registered * total - 1e-9):  # 0.07 * 100 is more than 7
        raise UserError(
            f"structure from motion placed {registered} of {total} photos",
            found=f"besides, {_named(capture, result.folded)} placed by lenses that fold over, as those of panoramas do"
            if result.folded
            else None,
            expected=f"at least {settings.minimum_registered:.0%} of them (minimum_registered)",
            remedy="Take photos that overlap more (each point in three or more), or add --set SFM.matching=exhaustive "
            f"or --set SFM.camera_model=OPENCV to the command, {WHERE}; in the same way raise SFM.matching_size (now "
            f"{settings.matching_size}) or SFM.max_features (now {settings.max_features}), or accept fewer with "
            "SFM.minimum_registered.",
        )
    if len(result.points) < FEWEST_POINTS:
        raise UserError(
            "hardly any point is seen by three photos",
            found=f"{len(result.points)} points",
            expected=f"at least {FEWEST_POINTS}",
            remedy=f"The poses do not fit the photos: add --set SFM.poses=estimate to the command, {WHERE}."
            if given
            else "Take photos that overlap more.",
        )


def scene_of(
    capture: Capture,
    pictures: Mapping[str, Path],
    sizes: list[tuple[int, int]],
    job: Job,
    result: Reconstruction,
    watcher: Watcher,
) -> Scene:
    """The scene of the registered photos, undistorted directly from the photos at full size."""
    names = tuple(capture.names[row] for row in result.rows)
    corners = read_corners(job.folder)
    undistorted = np.empty((len(names), job.height, job.width, 3), np.uint8)
    for place, (row, lens) in enumerate(zip(result.rows, result.lens_of, strict=True)):
        watcher.phase("undistortion", place, len(names))
        scale = np.array(capture.sizes[row], np.float32) / np.array(sizes[row], np.float32)
        undistorted[place] = undistort(read_picture(pictures[capture.names[row]]), np.asarray(corners[lens]) * scale)
    cameras = Cameras(
        names, result.world_to_camera, np.tile(result.intrinsics, (len(names), 1, 1)), job.width, job.height
    )
    return Scene(cameras, undistorted, result.points, result.point_colors, held_out_by_number(names))

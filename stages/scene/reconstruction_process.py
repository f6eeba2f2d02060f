"""Structure from motion, alone in a companion of `sfm`: `python -m stages.scene.reconstruction_process JOB`.

pycolmap brings its own zlib, which breaks that of a process that loads pycolmap first. It holds the interpreter lock
for minutes, and a crash in it must not take down a worker. No other module may import this one.
"""

from __future__ import annotations

import sys
import time
import zlib  # noqa: F401 - loaded before pycolmap, for the reason above
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Float64

from pipeline.companion import end_with_stage, say
from stages.scene.feature_database import DATABASE, PAIRS_IN_NEED, UNFINISHED
from stages.scene.lens import Lens
from stages.scene.pairing import Pair, in_batches
from stages.scene.reconstruction_job import PHASES, Job, Reconstruction, read_job, working_name, write_corners
from stages.scene.undistortion import (
    LensView,
    corner_positions,
    cropping_lenses,
    folded_lenses,
    own_pinhole,
    shared_pinhole,
    shares_shown,
)

SMALLEST_MODEL = 3  # photos
SHORTEST_TRACK = 3  # photos that must see a point for it to be kept
FAR_AWAY = 1e9
UNPROJECTED_WITHIN = 0.1  # pixels: largest error of a position that is unprojected and projected again
ENOUGH = 0.9  # fraction of photos placed, below which the pairs in need are matched too


def main() -> None:
    """Run the job in the file named on the command line, and write the result beside it."""
    end_with_stage()
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING)
    job = read_job(Path(sys.argv[1]))
    pycolmap.set_random_seed(job.seed)
    seconds = dict.fromkeys(PHASES, 0.0)
    folded = () if job.poses is None else folded_as_given(job)
    if folded:
        nothing(seconds, folded).write(job.folder)
        return
    if job.points_known:
        say(phase="lenses", done=0, total=len(job.lenses))
        describe(job, as_posed(job, np.array(job.poses)), seconds).write(job.folder)
        return
    with timed(seconds, "features"):
        extract(job)
    in_need = job.folder / PAIRS_IN_NEED
    # An interrupted run that had begun to match these had too few photos placed without them, and would not again: an
    # estimate is made from all matches that are there.
    model = None if in_need.exists() else reconstruct(job, job.pairs, seconds)
    if job.pairs_in_need and (model is None or model.num_reg_images() < ENOUGH * len(job.lenses)):
        in_need.touch()
        model = reconstruct(job, job.pairs_in_need, seconds)
    describe(job, model, seconds).write(job.folder)


@contextmanager
def timed(seconds: dict[str, float], phase: str) -> Iterator[None]:
    """Add the time that the block takes to `seconds[phase]`."""
    start = time.monotonic()
    yield
    seconds[phase] = round(seconds[phase] + time.monotonic() - start, 2)


def reconstruct(job: Job, pairs: Sequence[Pair], seconds: dict[str, float]) -> pycolmap.Reconstruction | None:
    """Match these pairs, then reconstruct from all that have been matched so far."""
    with timed(seconds, "matching"):
        match(job, pairs)
    with timed(seconds, "mapping"):
        return estimate(job) if job.poses is None else triangulate(job, np.array(job.poses))


def extract(job: Job) -> None:
    """Extract SIFT features of every picture; keeps those of an interrupted run, whose database the stage has checked.

    Pictures enter the database in order, one group of equal lenses after the other, before any thread works on them. So
    their ids, on which mapping depends, are always the same.
    """
    path, names = job.folder / DATABASE, [working_name(row) for row in range(len(job.lenses))]
    longest = max(max(lens.width, lens.height) for lens in job.lenses)  # COLMAP would shrink what is beyond 3200
    options = pycolmap.FeatureExtractionOptions(num_threads=job.threads, use_gpu=False, max_image_size=longest)
    options.sift.max_num_features = job.max_features
    if not path.exists():
        enter_pictures(job, job.folder / UNFINISHED)
        (job.folder / UNFINISHED).rename(path)
    step = 4 * job.threads
    for start in range(0, len(names), step):
        say(phase="features", done=start, total=len(names))
        pycolmap.extract_features(
            path, job.folder, names[start : start + step], extraction_options=options, device=pycolmap.Device.cpu
        )


def enter_pictures(job: Job, path: Path) -> None:
    """Create a database of all pictures, with one camera for each group of equal lenses."""
    pycolmap.Database.open(path).close()
    cameras = list(zip(job.lenses, job.focal_known, job.taken_by, strict=True))
    for camera in dict.fromkeys(cameras):
        lens, known, _ = camera
        group = [working_name(row) for row, own in enumerate(cameras) if own == camera]
        options = pycolmap.ImageReaderOptions(camera_model=lens.model, camera_params=written(lens))
        pycolmap.import_images(path, job.folder, pycolmap.CameraMode.SINGLE, group, options)
        if not known:
            forget_focal_length(path, group[0])


def written(lens: Lens) -> str:
    """A lens's parameters as the text that COLMAP expects."""
    return ", ".join(repr(value) for value in lens.parameters)


def forget_focal_length(path: Path, name: str) -> None:
    """Mark a picture's focal length as a guess: COLMAP takes given parameters as known."""
    with pycolmap.Database.open(path) as database:
        camera = database.read_camera(database.read_image_with_name(name).camera_id)
        camera.has_prior_focal_length = False
        database.update_camera(camera)


def match(job: Job, pairs: Sequence[Pair]) -> None:
    """Match the pairs; keeps matches of an interrupted run.

    On one thread: with two, COLMAP 4.2.1 sometimes finds nothing in a pair that otherwise has hundreds of matches.
    """
    options = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=False)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job.seed
    listed, done = job.folder / "pairs.txt", 0
    for batch in in_batches(set(pairs)):
        say(phase="matching", done=done, total=len(pairs))
        listed.write_text("".join(f"{working_name(one)} {working_name(other)}\n" for one, other in batch))
        pycolmap.match_image_pairs(
            job.folder / DATABASE,
            options,
            pycolmap.ImportedPairingOptions(match_list_path=listed),
            verification,
            pycolmap.Device.cpu,
        )
        done += len(batch)


def mapping_options(job: Job) -> pycolmap.IncrementalPipelineOptions:
    """On one thread: with two, mapping does not register the same photos every time."""
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=job.seed, min_model_size=SMALLEST_MODEL)
    options.mapper.num_threads = 1
    options.mapper.random_seed = job.seed
    options.triangulation.random_seed = job.seed
    return options


def estimate(job: Job) -> pycolmap.Reconstruction | None:
    """Incremental mapping: the largest model, the first of equals; None if nothing could be reconstructed."""
    registered = 2

    def count() -> None:
        nonlocal registered
        registered += 1
        say(phase="mapping", done=min(registered, len(job.lenses)), total=len(job.lenses))

    say(phase="mapping", done=0, total=len(job.lenses))
    output = job.folder / "models"
    output.mkdir(exist_ok=True)
    models = pycolmap.incremental_mapping(
        job.folder / DATABASE, job.folder, output, mapping_options(job), next_image_callback=count
    )
    return max((models[key] for key in sorted(models)), key=lambda model: model.num_reg_images(), default=None)


def triangulate(job: Job, poses: Float64[np.ndarray, "V 4 4"]) -> pycolmap.Reconstruction:
    """Triangulate points from known poses and lenses, which stay fixed."""
    say(phase="mapping", done=0, total=len(job.lenses))
    model, output = pycolmap.Reconstruction(), job.folder / "models"
    output.mkdir(exist_ok=True)
    with pycolmap.Database.open(job.folder / DATABASE) as database:
        for camera in database.read_all_cameras():
            model.add_camera_with_trivial_rig(camera)
        for image in database.read_all_images():
            entered = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            model.add_image_with_trivial_frame(entered, pycolmap.Rigid3d(poses[row_of(image.name), :3]))
    return pycolmap.triangulate_points(
        model, job.folder / DATABASE, job.folder, output, options=mapping_options(job), refine_intrinsics=False
    )


def as_posed(job: Job, poses: Float64[np.ndarray, "V 4 4"]) -> pycolmap.Reconstruction:
    """A model of the photos with their known poses and lenses, without points."""
    model, cameras = pycolmap.Reconstruction(), list(zip(job.lenses, job.taken_by, strict=True))
    numbers = {camera: number for number, camera in enumerate(dict.fromkeys(cameras), start=1)}
    for (lens, _), number in numbers.items():
        model.add_camera_with_trivial_rig(camera_of(lens, number))
    for row, (camera, pose) in enumerate(zip(cameras, poses, strict=True)):
        image = pycolmap.Image(name=working_name(row), camera_id=numbers[camera], image_id=row + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    return model


def camera_of(lens: Lens, number: int) -> pycolmap.Camera:
    """The lens as pycolmap's camera with this number."""
    parameters = list(lens.parameters)
    return pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=parameters, camera_id=number)


def row_of(name: str) -> int:
    """The row of the photo whose working picture has this name."""
    return int(Path(name).stem)


def view_of(camera: pycolmap.Camera) -> LensView:
    """What undistortion needs of a camera."""

    def unproject(pixels: Float64[np.ndarray, "N 2"]) -> Float64[np.ndarray, "N 2"]:
        points = np.array(camera.cam_from_img(pixels))
        return beyond_a_half_space(camera, pixels, points) if "FISHEYE" in camera.model.name else points

    return LensView(camera.img_from_cam, unproject, camera.width, camera.height)


def beyond_a_half_space(
    camera: pycolmap.Camera, pixels: Float64[np.ndarray, "N 2"], points: Float64[np.ndarray, "N 2"]
) -> Float64[np.ndarray, "N 2"]:
    """The points, but those that a fisheye sees at 90 degrees or more moved far away: none is on the plane at depth 1.

    There pycolmap returns angles in place of tangents: no points of that plane, and as small as tangents of 58 degrees.
    """
    again = np.array(camera.img_from_cam(np.column_stack([points, np.ones(len(points))])))
    angles = np.linalg.norm(points, axis=1)
    beyond = ~(np.abs(again - pixels).max(axis=1) <= UNPROJECTED_WITHIN) & (angles >= np.pi / 2)
    return np.where(beyond[:, None], FAR_AWAY * points, points)


def folded_as_given(job: Job) -> tuple[int, ...]:
    """Rows of the photos whose known lens folds over, found before any work on them."""
    lenses = list(dict.fromkeys(job.lenses))
    views = [view_of(camera_of(lens, number)) for number, lens in enumerate(lenses, start=1)]
    folded = {lenses[number] for number in folded_lenses(views, job.width, job.height)}
    return tuple(row for row, lens in enumerate(job.lenses) if lens in folded)


def leave_out_folded(job: Job, model: pycolmap.Reconstruction) -> tuple[int, ...]:
    """Remove the photos whose estimated lens folds over from the model, and return their rows.

    Now and then a phone's panorama is placed, with an impossible lens; no other photo may suffer from that.
    """
    images = [model.images[key] for key in model.reg_image_ids()]
    numbers = sorted({image.camera_id for image in images})
    folded = folded_lenses([view_of(model.cameras[number]) for number in numbers], job.width, job.height)
    return leave_out(model, [numbers[place] for place in folded])


def leave_out_cropping(job: Job, model: pycolmap.Reconstruction) -> tuple[int, ...]:
    """Remove the few photos that would crop all others from the model, and return their rows.

    When a phone points down, some photos come out in portrait among landscape ones; they would crop the others by half.
    """
    photos = Counter(model.images[key].camera_id for key in model.reg_image_ids())
    numbers = sorted(photos)
    lenses = [view_of(model.cameras[number]) for number in numbers]
    cropping = cropping_lenses(lenses, [photos[number] for number in numbers], job.width, job.height)
    return leave_out(model, [numbers[place] for place in cropping])


def leave_out(model: pycolmap.Reconstruction, cameras: Sequence[int]) -> tuple[int, ...]:
    """Remove the photos of these cameras from the model, and return their rows."""
    images = [image for key in model.reg_image_ids() if (image := model.images[key]).camera_id in cameras]
    for image in images:
        model.deregister_frame(image.frame_id)
    return tuple(sorted(row_of(image.name) for image in images))


def describe(job: Job, model: pycolmap.Reconstruction | None, seconds: dict[str, float]) -> Reconstruction:
    """The model in the job's terms, with the pinhole for undistortion; writes the lenses' corners."""
    folded = () if model is None else leave_out_folded(job, model)
    cropping = leave_out_cropping(job, model) if model is not None and job.poses is None else ()
    if model is None or model.num_reg_images() < SMALLEST_MODEL:
        return nothing(seconds, folded, cropping)
    images = sorted((model.images[key] for key in model.reg_image_ids()), key=lambda image: image.name)
    numbers = sorted({image.camera_id for image in images})
    cameras = [model.cameras[number] for number in numbers]
    lenses = [view_of(camera) for camera in cameras]
    own = own_pinhole(lenses, job.photo_size) if job.photo_size is not None else None
    pinhole = own or shared_pinhole(lenses, job.width, job.height)
    shape = (len(lenses), job.height + 1, job.width + 1, 2)
    write_corners(job.folder, shape, (corner_positions(lens, pinhole) for lens in lenses))
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    poses[:, :3] = [image.cam_from_world().matrix() for image in images]
    kept = [point for _, point in sorted(model.points3D.items()) if point.track.length() >= SHORTEST_TRACK]
    seen = Counter(number for point in kept for number in {element.image_id for element in point.track.elements})
    return Reconstruction(
        rows=tuple(row_of(image.name) for image in images),
        world_to_camera=poses,
        intrinsics=pinhole.intrinsics,
        lens_of=tuple(numbers.index(image.camera_id) for image in images),
        lens_shares=shares_shown(lenses, job.width, job.height),
        points_seen=tuple(seen[image.image_id] for image in images),
        points=np.array([point.xyz for point in kept], np.float32).reshape(-1, 3),
        point_colors=np.array([point.color for point in kept], np.uint8).reshape(-1, 3),
        mean_reprojection_error=model.compute_mean_reprojection_error() if kept else 0.0,
        lens_parameters=tuple(f"{camera.model_name} {camera.params_to_string()}" for camera in cameras),
        folded=folded,
        cropping=cropping,
        seconds=seconds,
        version=pycolmap.__version__,
    )


def nothing(seconds: dict[str, float], folded: tuple[int, ...], cropping: tuple[int, ...] = ()) -> Reconstruction:
    """The result if no photo was placed."""
    return Reconstruction(
        rows=(),
        world_to_camera=np.empty((0, 4, 4)),
        intrinsics=np.eye(3),
        lens_of=(),
        lens_shares=(),
        points_seen=(),
        points=np.empty((0, 3), np.float32),
        point_colors=np.empty((0, 3), np.uint8),
        mean_reprojection_error=0.0,
        lens_parameters=(),
        folded=folded,
        cropping=cropping,
        seconds=seconds,
        version=pycolmap.__version__,
    )


if __name__ == "__main__":
    main()

"""`sfm`: structure from motion, from a capture to a posed scene with undistorted pictures at training size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.scene.cameras import Cameras
from stages.scene.capture import Capture, KnownPoses, picture_path, read_capture
from stages.scene.drawn_depths import drawn_scene
from stages.scene.known_points import KnownPoints
from stages.scene.pairing import Matching
from stages.scene.pose_errors import pose_errors
from stages.scene.reconstruction_job import Reconstruction
from stages.scene.scene import Scene, write_scene
from stages.scene.structure_from_motion import FEWEST_POINTS, PROCESS, WHERE, Settings, Watcher, reconstruct
from stages.scene.world_scale import stated

CameraModel = Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]


class SfmParameters(Parameters):
    """Settings of the reconstruction. Sizes are long sides, in pixels."""

    width: int = Field(192, ge=16, description="Long side of the training pictures; photos are never enlarged.")
    matching_size: int = Field(1600, ge=64, description="Maximum long side at which photos are matched.")
    matching: Matching = Field(
        "auto",
        description="Which pairs of photos are compared: all, or neighbours in a sequence. auto: all pairs for up to "
        "30 photos; for more, cameras near each other if poses are kept, else a sequence if photos are ordered (then "
        "all pairs of up to 120 photos if too few were placed), else all pairs.",
    )
    max_features: int = Field(
        8192, ge=64, description="Approximate maximum of features per photo; beyond it, COLMAP drops the finest scales."
    )
    camera_model: CameraModel = Field("SIMPLE_RADIAL", description="COLMAP camera model to estimate.")
    poses: Literal["auto", "estimate", "given"] = Field(
        "auto",
        description="auto: keep given poses, except for synthetic captures, where they only check estimated ones.",
    )
    points: Literal["auto", "given", "triangulate"] = Field(
        "auto",
        description="auto: if poses are kept and points came with them (a COLMAP model's, or the PLY of a "
        "transforms.json), these are used, as 3DGS does, and no photos are compared; otherwise points are "
        "triangulated.",
    )
    test_views: Literal["auto", "every_eighth"] = Field(
        "auto",
        description="auto: the views that the capture's pose files hold out for tests, if any, provided that some are "
        "left to train on; otherwise every eighth view by name.",
    )
    minimum_registered: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Minimum share of photos that must be placed, from 0 to 1; with fewer, the stage fails.",
    )
    seed: int = Field(0, ge=0, description="Random seed.")


@stage(
    inputs={"capture": Input("capture")},
    outputs={"scene": Output("scene")},
    version=1,
    modules=lambda parameters: [PROCESS],
    remarks="stages.scene.remarks:photos_missing_or_cropped",
)
def sfm(context: Context, parameters: SfmParameters) -> None:
    """Estimate cameras and points, or keep the poses that came with the photos, and their points if they have any.

    If poses are kept and have no points, points are triangulated. Raises `UserError` if poses or points are to be given
    and none came with the photos.
    """
    artifact = context.input("capture")
    capture = read_capture(artifact)
    poses = poses_to_keep(capture, parameters)
    points = points_to_keep(poses, parameters)
    poses = poses and replace(poses, points=points)
    settings = Settings(**parameters.model_dump(exclude={"poses", "points", "test_views"}))
    watcher = Watcher(lambda done: context.progress(round(100 * done, 1), 100), context.log, context.stop_requested)
    pictures = {name: picture_path(artifact, name) for name in capture.names}
    scene, result = reconstruct(capture, pictures, poses, settings, context.scratch, watcher)
    factor = 1.0
    if poses is not None:
        scene, factor = drawn_scene(scene)
        if factor != 1:
            context.log(
                f"the poses' world is small: enlarged {factor:.3g} times, so that it is not clipped by the near plane"
            )
    if parameters.test_views == "auto" and capture.test_names:
        scene = with_views_held_out(scene, capture.test_names, context.log)
    errors = errors_against_truth(capture, scene) if poses is None else {}
    write_scene(
        context.output("scene"),
        scene,
        registered=len(scene.cameras),
        total=len(capture.names),
        mean_reprojection_error=result.mean_reprojection_error,
        pose_source="estimated" if poses is None else poses.source,
        **stated(factor),
        **errors,
    )
    _record(context, capture, poses, scene, result)


def _record(context: Context, capture: Capture, poses: KnownPoses | None, scene: Scene, result: Reconstruction) -> None:
    """Log how many photos were placed, and record how, and which photos are to be doubted."""
    error = result.mean_reprojection_error
    points = poses is not None and poses.points is not None
    context.log(
        f"{len(scene.cameras)} of {len(capture.names)} photos placed, {len(scene.points)} points"
        f"{' that came with the poses' if points else ''}, reprojection error "
        f"{'unknown' if error is None else f'{error:.2f} pixels'}"
    )
    context.record(
        point_source=poses.source if poses and points else "triangulated",
        pycolmap=result.version,
        device="cpu",
        lenses=list(result.lens_parameters),
        seconds_of_phases=dict(result.seconds),
    )
    if min(result.lens_shares, default=1.0) < 1:
        context.record(shares_shown=[round(result.lens_shares[lens], 3) for lens in result.lens_of])
    if poses is not None:
        context.record(unsure_poses=[*photos_without_points(scene, result)])
    if result.folded:
        context.record(folded=[capture.names[row] for row in result.folded])
    if result.cropping:
        context.record(cropping=[capture.names[row] for row in result.cropping])


def photos_without_points(scene: Scene, result: Reconstruction) -> tuple[str, ...]:
    """The photos that see hardly any of the points; if their poses were given, these may be wrong."""
    seen = zip(scene.cameras.names, result.points_seen, strict=True)
    return tuple(name for name, points in seen if points < FEWEST_POINTS)


def with_views_held_out(scene: Scene, held_out: Sequence[str], log: Callable[[str], None]) -> Scene:
    """The scene with the test views that its capture holds out, as far as they were placed.

    If that leaves no view for testing, or none for training, the scene is returned as it is, with every eighth held
    out.
    """
    names, given = scene.cameras.names, set(held_out)
    test_names = tuple(name for name in names if name in given)
    if not 0 < len(test_names) < len(names):
        log(f"{len(test_names)} of the {len(names)} views were held out for tests: every eighth is a test view instead")
        return scene
    log(f"{len(test_names)} of {len(names)} views are test views according to the pose files")
    return replace(scene, test_names=test_names)


def poses_to_keep(capture: Capture, parameters: SfmParameters) -> KnownPoses | None:
    """The poses to keep, or None to estimate them. Raises `UserError` if poses must be given and none came."""
    if parameters.poses == "given" and capture.poses is None:
        raise UserError(
            "poses must be given, but none came with the photos",
            found=f"{len(capture.names)} photos without poses",
            expected="a COLMAP model (sparse/0: cameras and images, .bin or .txt), a transforms.json or a "
            "transforms_train.json in the folder of photos",
            remedy="Put one there, or set the parameter poses of the stage photos to it; or, to estimate the poses, "
            f"add --set SFM.poses=auto to the command, {WHERE}.",
        )
    if parameters.poses == "estimate" or capture.poses is None:
        return None
    return None if parameters.poses == "auto" and capture.poses.source == "synthetic" else capture.poses


def points_to_keep(poses: KnownPoses | None, parameters: SfmParameters) -> KnownPoints | None:
    """The points to keep, or None to triangulate them. Raises `UserError` if points must be given and too few came."""
    points = None if poses is None else poses.points
    count = 0 if points is None else len(points.positions)
    if parameters.points == "given" and count < FEWEST_POINTS:
        raise UserError(
            "points must be given, but too few came with the photos",
            found="estimated poses, whose coordinates do not match given points"
            if poses is None
            else f"{count} points",
            expected=f"at least {FEWEST_POINTS} points: of a COLMAP model, in its points3D.bin or .txt, seen by "
            "photos; of a transforms.json, in the PLY of its ply_file_path",
            remedy=f"Put that file there, or add --set SFM.points=auto to the command, {WHERE}.",
        )
    return points if parameters.points != "triangulate" and count >= FEWEST_POINTS else None


def errors_against_truth(capture: Capture, scene: Scene) -> dict[str, float]:
    """Largest errors of estimated cameras of a synthetic capture: as a share of the rig's radius, and in degrees.

    Empty for other captures, and with fewer than three cameras.
    """
    if capture.poses is None or capture.poses.source != "synthetic" or len(scene.cameras) < 3:
        return {}
    true = Cameras(
        capture.names,
        capture.poses.world_to_camera,
        np.stack([lens.matrix() for lens in capture.poses.lenses]),
        *capture.sizes[0],
    )
    errors = pose_errors(scene.cameras, true)
    return {
        "pose_error_position": float(errors.position.max()),
        "pose_error_rotation": float(errors.rotation.max()),
    }

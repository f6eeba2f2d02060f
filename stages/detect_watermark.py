"""`detect_watermark`: is the watermark detected in renders, and in nothing else?"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from itertools import chain
from typing import Literal

import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact
from pipeline.checkpoint import Checkpoints, State
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.attacks.target import Target
from stages.analysis.distorted_negatives import most_distorted, with_distorted
from stages.analysis.measurements import Measurement, write_measurements
from stages.analysis.watermark_readers import shown_by_decoder, shown_by_grain
from stages.analysis.watermark_trials import (
    COVER_AFTER,
    COVER_BEFORE,
    COVER_CONTROL,
    OTHER_SCENES,
    OWN_SCENE,
    AttackedRenders,
    Detector,
    Negative,
    Positives,
    Shown,
    trial_rows,
)
from stages.analysis.watermarked_containers import attacked_containers
from stages.hiding.method import move_networks
from stages.hiding.method_names import PLAIN, MethodName, module_of
from stages.hiding.storage import check_drawn, read_gaussians, read_method
from stages.hiding.watermark.reading import FOUND_SHARE, owners_reader
from stages.hiding.watermark.rendering import each_render, renders
from stages.hiding.watermark.storage import read_codec
from stages.imaging.distortions import noisy
from stages.imaging.image import filling, read_image
from stages.imaging.photo_digests import HELD_OUT
from stages.imaging.pictures import Picture, picture_to_tensor
from stages.imaging.psnr import psnr
from stages.imaging.shipped_photos import ShippedPhotos, longest_for, read_photo
from stages.imaging.windows import is_as_large, windows_of_all
from stages.scene.camera_path import camera_path
from stages.scene.cameras import Cameras
from stages.scene.scene import Scene, read_scene
from stages.training.checkpoints import checkpoints_on
from stages.training.codec_photos import read_photos
from stages.training.threads import Threads

COVER_SCENE = "the cover"
OWN_PHOTOS, OTHER_PHOTOS = "test photos of the cover", "photos of other things"
OWN_RENDERS, OTHER_RENDERS = "renders from before", "renders of other scenes"
NOISY_PHOTOS = "photos of other things, noise of 5 levels"
"""Counted separately: a watermark in a picture is itself faint noise, and decoders may mistake noise for it."""

PHOTO_NOISE = noisy(5.0)

SEEN = "seen"
"""Checkpoint array of the reader's results, a row for each picture."""

Pictures = UInt8[np.ndarray, "V H W 3"]


class DetectWatermarkParameters(Parameters):
    """Which reader is tested, and on how many pictures of each kind."""

    method: MethodName = Field("gs_hider", description="The container's method; plain for splats of 3DGS.")
    reader: Literal["decoder", "grain"] = Field(
        "decoder",
        description="What looks for the watermark. decoder: the codec's decoder, as in the paper. grain: the owner's "
        "test for grain, using the container from before it and the key or seed of the coins.",
    )
    grain_seed: int = Field(0, ge=0, description="The seed given to add_grain; used if there is no key.")
    renders: int = Field(
        400,
        ge=2,
        description="Number of new cameras along the rig. With a decoder, every other one sets its threshold and the "
        "rest are scored; the threshold for grain is known, so all are scored.",
    )
    negatives: int = Field(
        3200,
        ge=1,
        description="Number of pictures of other scenes, split equally among the sources; as many of the cover without "
        "the watermark are added, and as many noisy ones as one source has. A source whose photos are hardly larger "
        "than the scene's pictures has fewer; rates and their bounds count what there is. Photos smaller than the "
        "scene's pictures are left out; the log says how many of the shipped ones.",
    )
    distorted_of: int = Field(
        20,
        ge=0,
        description="One in this many pictures of other scenes is also tested after each distortion; 0: none.",
    )
    shipped_photos: ShippedPhotos = Field(
        HELD_OUT, description="File names of photos shipped with Python packages; those not installed are skipped."
    )
    seed: int = Field(0, ge=0, description="Random seed for photo crops and distortions.")
    threads: Threads = 1


@stage(
    inputs={
        "container": Input("container"),
        "before": Input("container or splats"),
        "control": Input("container", optional=True),
        "cover": Input("scene"),
        "codec": Input("codec", optional=True),
        "key": Input("key", optional=True),
        "watermark": Input("image"),
        "photos": Input("capture"),
        "other_photos": Input("capture", many=True, optional=True),
        "other_scenes": Input("scene", many=True, optional=True),
        "other_splats": Input("splats", many=True, optional=True),
    },
    outputs={"scores": Output("measurements", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method), module_of(PLAIN)],
)
def detect_watermark(context: Context, parameters: DetectWatermarkParameters) -> None:
    """Run the watermark's reader on renders with the watermark, as they are and attacked, and on many without it.

    Positives are renders of the container, as they are and after every distortion, and renders after attacks on the
    container. Negatives are windows of photos, at random places and of random sizes, and renders from cameras along the
    rigs. Each capture is one scene, photos and renders together, and so is each shipped photo. Shipped photos are also
    tried with noise, which is counted separately, and a share of all pictures of other scenes after every distortion.
    Negatives of the cover are photos of its test views, which no decoder was trained on, and renders of the container
    from before. They are counted separately, since decoders know that scene.
    """
    torch.set_num_threads(parameters.threads)
    _check_what_is_drawn(context, parameters.method)
    scene = read_scene(context.input("cover"))
    cameras = scene.cameras
    watermark = filling(read_image(context.input("watermark"))[1], cameras.width, cameras.height)
    checkpoints = checkpoints_on(context, working_device())
    detector = _detector(context, parameters, scene, watermark, _seen_before(context, checkpoints))
    amounts = _amounts(context, parameters)
    positives = _positives(context, parameters, scene)
    total = positives.looked_at + amounts.total
    done = 0

    def seen() -> State:
        return State({SEEN: np.array([astuple(shown) for shown in detector.seen])}, {})

    def after_each() -> None:
        nonlocal done
        done += 1
        context.progress(done, total)
        checkpoints.save_or_stop(seen, f"stopped before picture {done} of at most {total}")

    negatives = _negatives(context, parameters, scene, amounts)
    negatives = with_distorted(negatives, parameters.distorted_of, parameters.seed)
    rows = chain(
        _fidelity(context, scene, positives),
        trial_rows(detector, positives, negatives, parameters.seed, after_each),
    )
    write_measurements(context.output("scores"), [replace(row, method=parameters.method) for row in rows])
    context.record(device=describe_drawing(working_device()))


def _seen_before(context: Context, checkpoints: Checkpoints) -> list[Shown]:
    """The reader's results for the pictures before an interruption; empty without a checkpoint."""
    found = checkpoints.newest()
    if found is None:
        return []
    seen = [Shown(*row) for row in found.state.arrays[SEEN].tolist()]
    context.log(f"goes on after picture {len(seen)} (checkpoint of {found.written})")
    return seen


def _check_what_is_drawn(context: Context, method: str) -> None:
    """Checked before any work: the pictures that need them come last, after hours."""
    cover, before = context.input("cover"), context.input("before")
    check_drawn(context.input("container"), method, cover)
    check_drawn(before, PLAIN if before.kind == "splats" else method, cover)
    if (control := context.input_optional("control")) is not None:
        check_drawn(control, method, cover)
    for splats, scene in zip(context.input_many("other_splats"), context.input_many("other_scenes"), strict=False):
        check_drawn(splats, PLAIN, scene)


def _detector(
    context: Context, parameters: DetectWatermarkParameters, scene: Scene, watermark: Picture, seen: Sequence[Shown]
) -> Detector:
    if parameters.reader == "decoder":
        codec = context.input_optional("codec")
        if codec is None:
            raise UserError(
                "there is no decoder to detect the watermark with",
                found="no codec among the inputs, and reader: decoder",
                remedy="give detect_watermark the input codec, or set reader: grain for a container with grain",
            )
        return Detector(shown_by_decoder(read_codec(codec).to(working_device())), watermark, seen=seen)
    key = context.input_optional("key")
    before, stop = context.input("before"), context.stop_if_requested
    reader = owners_reader(before, scene, key, parameters.grain_seed, working_device(), stop)
    return Detector(shown_by_grain(reader, watermark), watermark, FOUND_SHARE, seen)


def _positives(context: Context, parameters: DetectWatermarkParameters, scene: Scene) -> Positives:
    container = context.input("container")
    tests = _renders(container, scene.cameras.select(scene.test_names), context.stop_if_requested)
    path = camera_path(scene.cameras, scene.points, parameters.renders)
    new = _renders(container, path, context.stop_if_requested)
    is_known = parameters.reader == "grain"
    return Positives(
        list(zip(scene.test_names, tests, strict=True)),
        [] if is_known else [*new[::2]],
        [*new] if is_known else [*new[1::2]],
        _attacked(container, parameters.seed, path.select(path.names[1::2])),
    )


def _attacked(container: Artifact, seed: int, cameras: Cameras) -> list[AttackedRenders]:
    target, device = Target(read_gaussians(container), read_method(container)), working_device()

    def shown(attacked: Callable[[], Target]) -> Iterator[Picture]:
        changed = attacked()
        method = copy.deepcopy(changed.method)
        move_networks(method, device)
        yield from each_render(changed.gaussians.to(device), method, cameras)

    return [
        AttackedRenders(name, severity, len(cameras), partial(shown, attacked))
        for name, severity, attacked in attacked_containers(target, seed)
    ]


def _fidelity(context: Context, scene: Scene, positives: Positives) -> Iterator[Measurement]:
    """PSNR of the cover on test views: before watermarking, after it, and of the control, if there is one."""
    containers = {COVER_BEFORE: context.input("before"), COVER_CONTROL: context.input_optional("control")}
    cameras, truths = scene.cameras.select(scene.test_names), scene.pictures[scene.rows(scene.test_names)]
    shown: dict[str, Sequence[Picture]] = {
        condition: [*_renders(container, cameras, context.stop_if_requested)]
        for condition, container in containers.items()
        if container is not None
    }
    shown[COVER_AFTER] = [picture for _, picture in positives.tests]
    for condition, pictures in shown.items():
        for view, picture, truth in zip(scene.test_names, pictures, truths, strict=True):
            value = psnr(picture_to_tensor(picture), picture_to_tensor(truth))
            yield Measurement("psnr", value, condition, view=view, split="test")


@dataclass(frozen=True)
class Amounts:
    """Largest numbers of negatives: `own` photos and as many renders of the cover, `each` of every other source.

    `total` includes noisy and distorted ones.
    """

    own: int
    each: int
    total: int


def _amounts(context: Context, parameters: DetectWatermarkParameters) -> Amounts:
    scenes, splats = context.input_many("other_scenes"), context.input_many("other_splats")
    if len(scenes) != len(splats):
        raise UserError(
            "the clean models' scenes and splats do not pair up",
            found=f"{len(scenes)} scenes and {len(splats)} splats",
            expected="as many scenes as splats, in the same order",
        )
    if splats and (photos := len(context.input_many("other_photos"))) not in (0, len(splats)):
        raise UserError(
            "the other captures' photos and splats do not pair up",
            found=f"photos of {photos} captures and splats of {len(splats)}",
            expected="as many of one as of the other, in the same order: photos and renders of a capture count as one "
            "scene",
            remedy="give both for every capture, or only one of the two inputs",
        )
    is_shipped = bool(parameters.shipped_photos)
    sources = len(context.input_many("other_photos")) + len(splats) + is_shipped
    own, each = -(-parameters.negatives // 2), -(-parameters.negatives // max(1, sources))
    distorted = most_distorted(sources * each, parameters.distorted_of)
    return Amounts(own, each, 2 * own + (sources + is_shipped) * each + distorted)


def _negatives(
    context: Context, parameters: DetectWatermarkParameters, scene: Scene, amounts: Amounts
) -> Iterator[tuple[Negative, Picture]]:
    generator, size = np.random.default_rng(parameters.seed), (scene.cameras.width, scene.cameras.height)

    def windows(photos: Sequence[tuple[str, Picture]], count: int) -> Iterator[tuple[str, Picture]]:
        return windows_of_all(photos, count, *size, generator)

    def seen(model: Artifact, of: Scene, count: int) -> Iterator[Picture]:
        path = camera_path(of.cameras, of.points, count)
        device = working_device()
        return each_render(read_gaussians(model, device), read_method(model, device=device), path)

    tests = [(COVER_SCENE, photo) for photo in _test_photos(context.input("photos"), scene)]
    for name, window in windows(tests, amounts.own):
        yield Negative(OWN_PHOTOS, name, OWN_SCENE), window
    for picture in seen(context.input("before"), scene, amounts.own):
        yield Negative(OWN_RENDERS, COVER_SCENE, OWN_SCENE), picture
    for number, capture in enumerate(context.input_many("other_photos"), start=1):
        photos = [(f"capture {number}", photo) for photo in read_photos(capture, longest=longest_for(*size))]
        for name, window in windows(photos, amounts.each):
            yield Negative(OTHER_PHOTOS, name, OTHER_SCENES), window
    shipped = [(name, read_photo(name, longest_for(*size))) for name in parameters.shipped_photos]
    large = sum(is_as_large(photo, *size) for _, photo in shipped)
    if large < (every := len(shipped)):
        context.log(f"{large} of {every} shipped photos are as large as the scene's pictures; the others are left out")
    for name, window in windows(shipped, amounts.each if shipped else 0):
        yield Negative(OTHER_PHOTOS, name, OTHER_SCENES), window
    for name, window in windows(shipped, amounts.each if shipped else 0):
        yield Negative(NOISY_PHOTOS, name, None), PHOTO_NOISE.apply(window, generator)
    others = zip(context.input_many("other_scenes"), context.input_many("other_splats"), strict=True)
    for number, (other, model) in enumerate(others, start=1):
        for picture in seen(model, read_scene(other), amounts.each):
            yield Negative(OTHER_RENDERS, f"capture {number}", OTHER_SCENES), picture


def _test_photos(capture: Artifact, scene: Scene) -> list[Picture]:
    """The capture's photos of the test views, with sides of at most `longest_for`.

    If it has no photo of their names, the scene's own pictures of these views.
    """
    longest = longest_for(scene.cameras.width, scene.cameras.height)
    return read_photos(capture, scene.test_names, longest) or [*scene.pictures[scene.rows(scene.test_names)]]


def _renders(container: Artifact, cameras: Cameras, after_each: Callable[[], None]) -> Pictures:
    device = working_device()
    return renders(read_gaussians(container, device), read_method(container, device=device), cameras, after_each)

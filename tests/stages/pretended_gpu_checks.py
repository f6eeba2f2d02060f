"""On a pretended GPU, stages make exactly the bits that they make on the CPU.

Its name is not that of a test file: `test_pretended_gpu.py` runs it in a process of its own, as the pretence needs.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from opencl import routes
from tests.pretended_gpu import NAME, pretend_gpu, pretending

CPU, GPU = torch.device("cpu"), pretend_gpu()
working_on = [CPU]
routes.working_device = lambda: working_on[0]  # before stages import it

from pipeline.artifact import Artifact  # noqa: E402
from pipeline.stage import Parameters, Stage  # noqa: E402
from stages.add_grain import AddGrainParameters, add_grain  # noqa: E402
from stages.analysis.attacks.target import Knowledge  # noqa: E402
from stages.analysis.attacks.unread_directions import sensitivity  # noqa: E402
from stages.analysis.attacks.view_weights import blending_weights, influences  # noqa: E402
from stages.analysis.measurements import read_measurements  # noqa: E402
from stages.analysis.residual_detector import Views, detector_scores, train_detector, views_of  # noqa: E402
from stages.analysis.secrecy import painting  # noqa: E402
from stages.attack import AttackParameters, attack  # noqa: E402
from stages.detect_watermark import DetectWatermarkParameters, detect_watermark  # noqa: E402
from stages.draw_key import DrawKeyParameters, draw_key  # noqa: E402
from stages.evaluate import EvaluateParameters, evaluate  # noqa: E402
from stages.find_grain import FindGrainParameters, find_grain  # noqa: E402
from stages.finetune_rtws import FinetuneRtwsParameters, finetune_rtws  # noqa: E402
from stages.hide_image import HideImageParameters, hide_image  # noqa: E402
from stages.hide_scenes import HideScenesParameters, hide_scenes  # noqa: E402
from stages.hiding import convolution, decoders, placing_alone  # noqa: E402
from stages.hiding.method import move_networks  # noqa: E402
from stages.hiding.methods import homogeneous  # noqa: E402
from stages.imaging.metric_table import read_rows  # noqa: E402
from stages.imprint_watermark import ImprintWatermarkParameters, imprint_watermark  # noqa: E402
from stages.probe_secrecy import ProbeSecrecyParameters, probe_secrecy  # noqa: E402
from stages.render_hidden import RenderHiddenParameters, render_hidden  # noqa: E402
from stages.render_path import RenderPathParameters, render_path  # noqa: E402
from stages.render_views import RenderViewsParameters, render_views  # noqa: E402
from stages.reveal import RevealParameters, reveal  # noqa: E402
from stages.scene.gaussians import Gaussians  # noqa: E402
from stages.seal import SealParameters, seal  # noqa: E402
from stages.time_frames import TimeFramesParameters, time_frames  # noqa: E402
from stages.train_codec import TrainCodecParameters, train_codec  # noqa: E402
from stages.train_scene import TrainSceneParameters, train_scene  # noqa: E402
from stages.training.averaging import Averages  # noqa: E402
from stages.training.density_control import DensitySettings  # noqa: E402
from stages.training.loop import Training  # noqa: E402
from stages.training.schedules import DensitySchedule  # noqa: E402
from stages.training.state import set_state, state_of  # noqa: E402
from stages.tune_watermark_decoder import TuneWatermarkDecoderParameters, tune_watermark_decoder  # noqa: E402
from tests.benchmarks import nvidia_checks, nvidia_timing, nvidia_training, training_iteration  # noqa: E402
from tests.opencl.test_nvidia_script import SMALL, few_inputs  # noqa: E402
from tests.running import run_stage  # noqa: E402
from tests.stages import small, watermarks  # noqa: E402
from tests.stages.analysis.attacks.containers import knowledge, target_and_owner  # noqa: E402
from tests.stages.hiding.relocalisation import scenes  # noqa: E402
from tests.stages.training.trainings import prepared  # noqa: E402

HEAVY = {
    f"aten::{name}"
    for name in ("convolution", "convolution_backward", "_fused_adam_", "sigmoid", "exp", "sigmoid_backward")
}
"""Operations on networks, Gaussians and their gradients: none is left to the CPU."""

OF_WHAT_IS_SEALED = ("scores_of_what_is_sealed", "revealed_of_what_is_sealed", "videos_of_what_is_sealed")
ON_BOTH = ("attacked", "watermark_detected", "secrecy", *OF_WHAT_IS_SEALED)
"""Jobs of which a part stays on the CPU: attacks but trainings and renders, readings but surrogates, opening a seal."""

SLOW = (
    *("views_of_splats_alone", "scores_of_an_image", "revealed", "finetuned", "imprinted_splats"),
    *OF_WHAT_IS_SEALED[1:],
    *("codec_trained", "decoder_tuned", "watermark_detected", "grain_found"),
    *("imprinted", "secrecy", "grained"),
)
"""Jobs that move to a GPU what others move, too, or that hide nothing; `pytest -m slow` runs them."""

Inputs = dict[str, Artifact | tuple[Artifact, ...]]

HIDING = {"iterations": 6, "decoder_width": 8, "feature_dim": 8}


@dataclass(frozen=True)
class Job:
    """A stage, and where its inputs come from: `FILES`, or the outputs of another job."""

    stage: Stage
    parameters: Parameters
    inputs: dict[str, str]


def hiding(method: str, **changed: int) -> Job:
    return Job(
        hide_scenes,
        HideScenesParameters.model_validate({**HIDING, "method": method, **changed}),
        {"cover": "cover", "messages": "views"},
    )


SECRET_SCENE = {"container": "homogeneous.container", "secret": "homogeneous.secret", "cover": "cover"}
SEALED_SCENE = {"container": "sealed.container", "secret": "sealed.secret", "cover": "cover"}
TRIED = {"container": "imprinted.container", "before": "image.container", "cover": "cover", "watermark": "emblem"}
SECRET_IMAGE = {"container": "image.container", "secret": "image.secret", "cover": "cover"}

JOBS = {
    "plain": Job(
        train_scene, TrainSceneParameters.model_validate({"iterations": 6, "opacity_weight": 0.1}), {"scene": "cover"}
    ),
    "views_of_a_message": Job(
        render_hidden,
        RenderHiddenParameters(name="statue", search_width=8),
        {"splats": "plain.splats", "message": "cover", "cover": "cover"},
    ),
    "views_of_splats_alone": Job(
        render_hidden,
        RenderHiddenParameters(name="statue", search_width=8),
        {"splats": "plain.splats", "cover": "cover"},
    ),
    **{method: hiding(method) for method in ("gs_hider", "homogeneous", "sh", "decoder")},
    "image": Job(
        hide_image,
        HideImageParameters.model_validate(HIDING),
        {"cover": "cover", "image": "emblem"},
    ),
    "scores": Job(
        evaluate,
        EvaluateParameters(method="homogeneous", threads=1),
        {**SECRET_SCENE, "messages": "views", "reference": "plain.splats"},
    ),
    "scores_of_what_is_sealed": Job(
        evaluate, EvaluateParameters(method="homogeneous", threads=1), {**SEALED_SCENE, "messages": "views"}
    ),
    "scores_of_an_image": Job(evaluate, EvaluateParameters(threads=1), {**SECRET_IMAGE, "image": "emblem"}),
    "revealed": Job(
        reveal,
        RevealParameters(method="homogeneous", threads=1),
        {**SECRET_SCENE, "published": "homogeneous.container"},
    ),
    "revealed_of_what_is_sealed": Job(
        reveal,
        RevealParameters(method="homogeneous", threads=1),
        {**SEALED_SCENE, "published": "sealed.container"},
    ),
    "renders": Job(
        render_views,
        RenderViewsParameters(views=5, feature_maps=2, threads=1),
        {"container": "gs_hider.container", "cover": "cover"},
    ),
    "videos": Job(render_path, RenderPathParameters(frames=3, threads=1), SECRET_IMAGE),
    "videos_of_what_is_sealed": Job(
        render_path, RenderPathParameters(method="homogeneous", frames=3, threads=1), SEALED_SCENE
    ),
    "timings": Job(
        time_frames,
        TimeFramesParameters(frames=2, threads=1),
        {"container": "gs_hider.container", "cover": "cover"},
    ),
    "attacked": Job(
        attack,
        AttackParameters(method="homogeneous", attacks=("reoptimisation",), reoptimised=(3, 6), seeds=(0,)),
        {**SECRET_SCENE, "messages": "views"},
    ),
    "finetuned": Job(
        finetune_rtws,
        FinetuneRtwsParameters(iterations=6),
        {**SECRET_IMAGE, "image": "emblem", "codec": "codec", "watermark": "emblem"},
    ),
    "imprinted": Job(
        imprint_watermark,
        ImprintWatermarkParameters(iterations=6, shipped_photos=(), distorted=True),
        {**SECRET_IMAGE, "codec": "codec", "watermark": "emblem"},
    ),
    "imprinted_splats": Job(
        imprint_watermark,
        ImprintWatermarkParameters(iterations=6, shipped_photos=(), method="plain"),
        {"container": "plain.splats", "cover": "cover", "codec": "codec", "watermark": "emblem"},
    ),
    "codec_trained": Job(
        train_codec,
        TrainCodecParameters(iterations=6, blocks=1, width=8, window=16, batch=2, shipped_photos=()),
        {"photos": "photos", "watermarks": "emblem"},
    ),
    "decoder_tuned": Job(
        tune_watermark_decoder,
        TuneWatermarkDecoderParameters(
            iterations=4,
            batch=2,
            hardest_of=2,
            between=2,
            whole_pictures=True,
            tinted=True,
            distorted=True,
            negatives="photos_and_clean_renders",
        ),
        {**TRIED, "codec": "codec", "photos": "photos"},
    ),
    "grained": Job(add_grain, AddGrainParameters(method="homogeneous"), SECRET_SCENE),
    "grain_found": Job(find_grain, FindGrainParameters(), {"before": "cloud", "cover": "clouds", "pictures": "copies"}),
    "secrecy": Job(
        probe_secrecy,
        ProbeSecrecyParameters(method="homogeneous", wrong_decoders=1, shares=(0.2,), seeds=(0,), steps=4, crop=8),
        {**SECRET_SCENE, "messages": "views"},
    ),
    "watermark_detected": Job(
        detect_watermark,
        DetectWatermarkParameters(renders=4, negatives=6, shipped_photos=()),
        {**TRIED, "codec": "decoder_tuned.codec", "photos": "photos"},
    ),
}
ON_THE_CPU = {
    "wide": hiding("homogeneous", feature_dim=16, iterations=1),
    "key": Job(draw_key, DrawKeyParameters(seed=3), {}),
    "sealed": Job(
        seal,
        SealParameters(method="homogeneous"),
        {"container": "wide.container", "secret": "wide.secret", "key": "key"},
    ),
}
"""Jobs that others need, themselves no work for a GPU or that of another."""

FILES: dict[str, Callable[[Path], Artifact]] = {
    "cover": small.scene,
    "views": small.message_views,
    "emblem": watermarks.emblem,
    "codec": watermarks.codec,
    "photos": watermarks.capture,
    "cloud": lambda folder: watermarks.stored_splats(folder, *scenes.cloud()),
    "clouds": lambda folder: watermarks.stored_scene(folder, *scenes.cloud(), scenes.rig(views=12)),
    "copies": lambda folder: watermarks.stored_capture(
        folder, {"copy.png": scenes.photograph(*scenes.cloud(), scenes.beside(scenes.rig(views=12)))}
    ),
}


@pytest.fixture(autouse=True)
def little_work_and_the_same_kernels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Tensors on the CPU have special kernels, which would make other bits than those for a GPU."""
    monkeypatch.setattr(convolution, "can_convolve", lambda *_: False)
    monkeypatch.setattr(decoders, "works_in_place", lambda _: False)
    monkeypatch.setattr(homogeneous, "works_in_place", lambda _: False)
    monkeypatch.setattr(placing_alone, "TURNS", 1)
    monkeypatch.setattr(painting, "STEPS", 4)
    torch.set_num_threads(1)
    yield
    working_on[0] = CPU


@pytest.fixture(scope="module")
def on_cpu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, Artifact]]:
    """What each job makes on the CPU; for a name in `FILES`, that file."""
    folder = tmp_path_factory.mktemp("cpu")

    @functools.cache
    def made(name: str) -> dict[str, Artifact]:
        if name in FILES:
            return {name: FILES[name](folder / name)}
        job = JOBS[name] if name in JOBS else ON_THE_CPU[name]
        return run_stage(job.stage, job.parameters, inputs_of(job, made), folder / name)

    return made


def inputs_of(job: Job, made: Callable[[str], dict[str, Artifact]]) -> Inputs:
    found: Inputs = {}
    for port, source in job.inputs.items():
        maker, _, output = source.partition(".")
        artifact = made(maker)[output or maker]
        found[port] = (artifact,) if job.stage.inputs[port].many else artifact
    return found


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in JOBS]
)
def test_a_stage(name: str, on_cpu: Callable[[str], dict[str, Artifact]], tmp_path: Path) -> None:
    job, expected = JOBS[name], on_cpu(name)
    working_on[0] = GPU
    with pretending() as mode:
        found = run_stage(job.stage, job.parameters, inputs_of(job, on_cpu), tmp_path)
    assert mode.on_device & HEAVY
    assert not mode.on_cpu & HEAVY or name in ON_BOTH
    if "curves" in found or name == "attacked":
        assert "aten::_fused_adam_" in mode.on_device
    for output, artifact in found.items():
        assert list(artifact.names) == list(expected[output].names)
        for array in artifact.names:
            np.testing.assert_array_equal(artifact.read(array), expected[output].read(array), f"{output}/{array}")
        if artifact.kind == "metrics" and name != "timings":
            assert repr(read_rows(artifact)) == repr(read_rows(expected[output]))
        if artifact.kind == "measurements":
            assert repr(read_measurements(artifact)) == repr(read_measurements(expected[output]))


def test_what_attackers_learn_of_a_container() -> None:
    target, _ = target_and_owner("homogeneous", 40)
    known = knowledge()
    learn: dict[str, Callable[[Knowledge], torch.Tensor]] = {
        "weights": lambda known: blending_weights(target, known),
        "influences": lambda known: influences(target, 0, known),
        "sensitivity": lambda known: sensitivity(target, 0, known),
    }
    for name, learnt in learn.items():
        expected = learnt(known)
        with pretending() as mode:
            found = learnt(replace(known, device=GPU))
        assert torch.equal(found, expected), name
        assert "aten::sigmoid" in mode.on_device, name
        assert not mode.on_cpu & HEAVY, name


def test_a_detector_of_what_hides() -> None:
    generator = np.random.default_rng(0)
    shapes = {"pictures": (4, 32, 40, 3), "feature maps": (4, 32, 40, 5)}
    for number, shape in enumerate(shapes.values()):
        values = generator.integers(0, 256, (2, *shape), np.uint8)
        hidden, clean = (views_of(each if number == 0 else each.astype(np.float16)) for each in values)

        def scores(device: torch.device, hidden: Views = hidden, clean: Views = clean) -> list[float]:
            return detector_scores(train_detector([(hidden, clean)], 0, 3, 4, 28, device=device), hidden)

        expected = scores(CPU)
        with pretending() as mode:
            assert scores(GPU) == expected
        assert not mode.on_cpu & HEAVY


ITERATIONS = 46


def training_on(device: torch.device, method: str) -> Training:
    """A training that refines Gaussians six times, resets opacities twice, and takes averages."""
    density = DensitySettings(gradient_threshold=1e-7, dense_fraction=0.2, largest_fraction=2, maximum_gaussians=70)
    made = prepared(method, ITERATIONS, density=density)
    move_networks(made.method, device)
    settings = replace(made.settings, opacity_weight=0.1, scale_weight=0.1)
    gaussians = Gaussians({name: tensor.detach() for name, tensor in made.gaussians.parameters.items()})
    training = Training(gaussians.to(device), made.method, made.views, made.terms, settings)
    training.schedule = DensitySchedule(start=4, stop=40, interval=6, opacity_reset_interval=15)
    training.averages = Averages(0.7, ITERATIONS)
    return training


@pytest.mark.parametrize(
    "method", [*(pytest.param(name, marks=pytest.mark.slow) for name in ("plain", "gs_hider")), "homogeneous"]
)
def test_a_training_that_goes_on_from_a_checkpoint(method: str) -> None:
    undisturbed = training_on(CPU, method)
    expected_rows = undisturbed.run(lambda: None)
    with pretending():
        stopped, training = training_on(GPU, method), training_on(GPU, method)
        while stopped.iteration < 39:  # averages are being taken
            stop_after_one(stopped)
        set_state(training, state_of(stopped))
        rows = training.run(lambda: None)
        found = state_of(training)
    assert all(tensor.device == GPU for tensor in training.gaussians.parameters.values())
    assert repr(rows) == repr(expected_rows)
    expected = state_of(undisturbed)
    assert found.values == expected.values
    assert found.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array, name)


def test_the_script_to_run_first_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """The script's own tensors are on the device that it names."""
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    monkeypatch.setattr(torch.cuda, "Stream", lambda: None)
    monkeypatch.setattr(torch.cuda, "stream", lambda stream: nullcontext())
    monkeypatch.setattr(nvidia_checks, "_BUSY", 4)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    monkeypatch.setattr(nvidia_timing, "REPETITIONS", 1)
    monkeypatch.setattr(nvidia_training, "ITERATIONS", 14)
    monkeypatch.setattr(nvidia_training, "STOPPED_AT", 12)
    with pretending() as mode:
        assert nvidia_checks.check_against_cpu(nvidia_checks.drawn_on(GPU), ((3, 60), (3, 0)))
        assert nvidia_checks.check_streams(GPU)
        nvidia_timing.time_workload(GPU, few_inputs())
        assert nvidia_training.check_training(GPU, "float32", SMALL)
    assert mode.on_device >= HEAVY - {"aten::exp"} | {"aten::mm"}


def test_the_benchmark_of_an_iteration(tmp_path: Path) -> None:
    small.scene(tmp_path / "scene")
    small.splats(tmp_path / "splats")
    small.message_views(tmp_path / "views")
    folders = [str(tmp_path / name) for name in ("scene", "splats", "views")]
    arguments = training_iteration.parser().parse_args(["homogeneous", *folders, "--precision", "float32"])
    expected = training_iteration.prepared(arguments, CPU).step(1)
    with pretending() as mode:
        training = training_iteration.prepared(arguments, GPU)
        assert training.step(1) == expected
        assert training_iteration.checkpoint_seconds(training, tmp_path, 1)
    assert not mode.on_cpu & HEAVY - {"aten::sigmoid", "aten::exp"}


class Stopped(Exception):
    pass


def stop_after_one(training: Training) -> None:
    def stop() -> None:
        raise Stopped

    with pytest.raises(Stopped):
        training.run(stop)


def test_the_pretence_refuses_what_cuda_refuses() -> None:
    with pretending():
        there, here = torch.ones(3, device=GPU), torch.ones(3)
        assert (there * torch.tensor(2.0) + here.to(GPU)).cpu().tolist() == [3, 3, 3]
        assert there[torch.tensor([0, 2])].device.type == NAME
        for mixed in (lambda: there + here, lambda: torch.cat([here, there]), lambda: here.add_(there)):
            with pytest.raises(RuntimeError, match="one of shape"):
                mixed()
        with pytest.raises(RuntimeError):
            there.numpy()
        adam = torch.optim.Adam([there.requires_grad_()], fused=True)
        there.sum().backward()
        adam.state[there] = {"step": torch.tensor(1.0), "exp_avg": there.detach(), "exp_avg_sq": there.detach()}
        with pytest.raises(RuntimeError, match="_fused_adam_"):
            adam.step()

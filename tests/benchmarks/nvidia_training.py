"""The checks of trainings in `tests.benchmarks.nvidia`: they begin as on the CPU, and resuming changes no bit."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import torch

from pipeline.checkpoint import State
from stages.hiding.method import build_method, move_networks
from stages.hiding.rendering import COVER
from stages.scene.cameras import Cameras, single_cameras
from stages.scene.gaussians import gaussians_at
from stages.training.density_control import DensitySettings
from stages.training.loop import Training, TrainingSettings, TrainingViews
from stages.training.objectives import hiding_terms
from stages.training.schedules import DensitySchedule
from stages.training.state import set_state, state_of
from tests.benchmarks.nvidia_checks import report

MESSAGE = "message"
VIEWS = 3
ITERATIONS, STOPPED_AT = 50, 43
"""Gaussians are refined until iteration 40; averaging begins there."""
_FIGURES_DIFFERENCE = {"float32": 1e-3, "tf32": 1e-3, "bfloat16": 1e-2}
"""Limit of the first iteration's relative difference from the CPU; thresholds and decoders' rounding cause less."""


@dataclass(frozen=True)
class Size:
    """The size of a training."""

    points: int
    width: int
    height: int
    feature_dim: int
    layers: int
    decoder_width: int
    kernel_size: int = 3


WHOLE = Size(points=5000, width=200, height=132, feature_dim=16, layers=5, decoder_width=64)
"""Like the trainings of the CPU profile, whose decoders are as wide as the released code's."""

OURS = replace(WHOLE, decoder_width=32, kernel_size=1)
"""With the decoders that `homogeneous` has by default."""


def prepared(device: torch.device, precision: str, size: Size) -> Training:
    """A training by `homogeneous` on pictures of noise, before its first iteration; the same every time."""
    torch.manual_seed(0)
    decoder = {
        "layers": size.layers,
        "decoder_width": size.decoder_width,
        "kernel_size": size.kernel_size,
        "precision": precision,
    }
    method = build_method("homogeneous", {"feature_dim": size.feature_dim, **decoder, "messages": [MESSAGE]})
    random = np.random.default_rng(0)
    points = random.uniform([-1.2, -0.8, 2], [1.2, 0.8, 4], (size.points, 3))
    colors = {name: random.uniform(0, 1, (size.points, 3)) for name in (COVER, MESSAGE)}
    shape = (VIEWS, size.height, size.width, 3)
    pictures = {name: torch.from_numpy(random.integers(0, 256, shape, np.uint8)) for name in (COVER, MESSAGE)}
    gaussians = gaussians_at(points, method.initial_attributes(colors, random)).to(device)
    move_networks(method, device)
    most = size.points * 6 // 5
    density = DensitySettings(gradient_threshold=1e-7, dense_fraction=0.02, largest_fraction=2, maximum_gaussians=most)
    settings = TrainingSettings(ITERATIONS, extent=1.0, seed=0, averaging=0.7, density=density)
    views = TrainingViews(single_cameras(rig(size)), pictures)
    training = Training(gaussians, method, views, hiding_terms([MESSAGE], 0.5), settings)
    training.schedule = DensitySchedule(start=4, stop=40, interval=6, opacity_reset_interval=15)
    return training


def rig(size: Size) -> Cameras:
    """Cameras side by side, looking along +z."""
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = np.linspace(-0.3, 0.3, VIEWS)
    focal = float(size.width)
    intrinsics = np.array([[focal, 0, size.width / 2], [0, focal, size.height / 2], [0, 0, 1]])
    names = tuple(f"{view}.png" for view in range(VIEWS))
    return Cameras(names, poses, np.tile(intrinsics, (VIEWS, 1, 1)), size.width, size.height)


def check_training(device: torch.device, precision: str, size: Size) -> bool:
    """Check that it begins as on the CPU, and gives the same bits if another training goes on from a saved state."""
    begins = check_first_figures(device, precision, size)
    undisturbed = prepared(device, precision, size)
    undisturbed.run(lambda: None)
    stopped, resumed = (prepared(device, precision, size) for _ in range(2))
    run_until(stopped, STOPPED_AT)
    set_state(resumed, state_of(stopped))
    resumed.run(lambda: None)
    different = differences(state_of(resumed), state_of(undisturbed))
    found = f"other {', '.join(different[:6])}" if different else f"the same bits, {len(resumed.gaussians)} Gaussians"
    same = report(f"{precision}, a training that goes on from iteration {STOPPED_AT}", not different, found)
    return begins and same


def check_first_figures(device: torch.device, precision: str, size: Size) -> bool:
    """Compare the loss and each picture's squared error in the first iteration with the CPU's."""
    found, expected = (prepared(one, precision, size).step(1) for one in (device, torch.device("cpu")))
    furthest = max(abs(found[name] - value) / value for name, value in expected.items())
    name = f"{precision}, the first iteration of a training"
    return report(name, furthest < _FIGURES_DIFFERENCE[precision], f"figures at most {furthest:.1e} from the CPU's")


class _Stopped(Exception):
    pass


def run_until(training: Training, iteration: int) -> None:
    """Run a training and interrupt it after an iteration."""

    def stop() -> None:
        if training.iteration == iteration:
            raise _Stopped

    with suppress(_Stopped):
        training.run(stop)


def differences(found: State, expected: State) -> list[str]:
    """Names of the arrays that differ between two states or contain NaN, and "values" if those differ."""
    names = sorted(found.arrays.keys() | expected.arrays.keys())
    different = [name for name in names if not _are_equal(found.arrays.get(name), expected.arrays.get(name))]
    return different + ([] if found.values == expected.values else ["values"])


def _are_equal(found: np.ndarray | None, expected: np.ndarray | None) -> bool:
    return found is not None and expected is not None and np.array_equal(found, expected)

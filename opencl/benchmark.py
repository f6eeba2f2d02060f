"""How fast the rasterizer is on this device: two workloads, forward and with gradients."""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.program import TILE
from opencl.projection import Project, pack_camera
from opencl.rasterizer import rasterize
from opencl.tiling import TileLists, sort_into_tiles


@dataclass(frozen=True)
class Workload:
    """A box of Gaussians before a camera of 60 degrees; sizes log-normal, most of them a few pixels."""

    name: str
    count: int
    width: int
    height: int
    feature_dim: int


@dataclass(frozen=True)
class Gaussians:
    """The rasterizer's inputs for a workload."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    features: Float[Tensor, "N M"]
    world_to_camera: Float[Tensor, "4 4"]
    intrinsics: Float[Tensor, "3 3"]

    @property
    def trained(self) -> tuple[Tensor, ...]:
        return self.means, self.quats, self.scales, self.opacities, self.features


WORKLOADS = (
    Workload("A", 50_000, 400, 304, 16),
    Workload("B", 200_000, 1216, 800, 16),
    Workload("training, features", 15_000, 192, 144, 16),
    Workload("training, colours", 15_000, 192, 144, 3),
)


def make_gaussians(workload: Workload, seed: int = 0) -> Gaussians:
    """Reproducible Gaussians that fill the view and a little more, with a mean 3-sigma radius of about 5.5 pixels."""
    random = torch.Generator().manual_seed(seed)
    count, width, height = workload.count, workload.width, workload.height
    focal = width / (2 * 0.57735)
    depths = 2 + 4 * torch.rand(count, generator=random)
    offsets = (torch.rand(count, 2, generator=random) - 0.5) * 1.1 * torch.tensor([width, height]) / focal
    sizes = 0.55 * torch.randn(count, 1, generator=random) + 0.45 * torch.randn(count, 3, generator=random)
    return Gaussians(
        means=torch.cat([offsets * depths[:, None], depths[:, None]], dim=1),
        quats=torch.randn(count, 4, generator=random),
        scales=sizes.exp() * depths[:, None] / focal * 5.5 / 3 / 1.45,
        opacities=torch.sigmoid(2 * torch.randn(count, generator=random)),
        features=torch.rand(count, workload.feature_dim, generator=random),
        world_to_camera=torch.eye(4),
        intrinsics=torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]),
    )


def evaluated_pixels(records: Float[Tensor, "N 8"], lists: TileLists, width: int) -> int:
    """Pixels of which alpha is computed: whole rows of the tiles, where a Gaussian reaches the row."""
    columns = -(-width // TILE)
    tiles = torch.repeat_interleave(torch.arange(lists.tiles), lists.starts.diff())
    gaussians = records[lists.entries.long()]
    centres = gaussians[:, 1] - tiles // columns * TILE
    half_heights = (gaussians[:, 6] / gaussians[:, 4]).sqrt()
    first = (centres - half_heights - 0.5).ceil().clamp_min(0)
    last = (centres + half_heights - 0.5).floor().clamp_max(TILE - 1)
    return int((last - first + 1).clamp_min(0).sum()) * TILE


def _tile_lists(backend: Backend, workload: Workload, gaussians: Gaussians) -> tuple[Float[Tensor, "N 8"], TileLists]:
    settings, size = RasterSettings(), (workload.width, workload.height)
    receive = backend.memory.receive
    camera = receive(pack_camera(gaussians.world_to_camera, gaussians.intrinsics, *size, settings))
    _, records, radii, depth_keys = Project.apply(backend, settings, camera, size, *map(receive, gaussians.trained))
    lists = sort_into_tiles(backend, settings, *size, records, radii, depth_keys, True)
    with backend.session() as session:
        session.finish(records, lists.starts, lists.entries)
    return records, lists


def _draw(workload: Workload, gaussians: Gaussians, trained: Sequence[Tensor]) -> Tensor:
    means, quats, scales, opacities, features = trained
    view = (gaussians.world_to_camera, gaussians.intrinsics, workload.width, workload.height)
    return rasterize(means, quats, scales, opacities, features, *view).features


def _medians(work: Callable[[], object], repetitions: int) -> tuple[float, float]:
    """Seconds on the clock and seconds of processors, which other work on the machine disturbs less."""
    clock, processors = [], []
    for _ in range(repetitions + 2):
        start, start_processors = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - start)
        processors.append(time.process_time() - start_processors)
    return statistics.median(clock[2:]), statistics.median(processors[2:])


def measure(backend: Backend, workload: Workload, repetitions: int = 11) -> str:
    """A few lines: medians over `repetitions` calls, after two that are not counted."""
    gaussians = make_gaussians(workload)
    leaves = [tensor.clone().requires_grad_() for tensor in gaussians.trained]
    gradient = torch.rand(workload.height, workload.width, workload.feature_dim)

    def forward() -> None:
        with torch.no_grad():
            _draw(workload, gaussians, gaussians.trained)

    records, lists = _tile_lists(backend, workload, gaussians)
    pixels = evaluated_pixels(records, lists, workload.width)
    lines = [
        f"{workload.name}: {workload.count} Gaussians, {workload.width} x {workload.height}, M={workload.feature_dim}, "
        f"{len(lists.entries)} (tile, Gaussian) and {pixels / 1e6:.1f} million (pixel, Gaussian) pairs"
    ]
    for name, work in (
        ("forward", forward),
        ("forward + backward", lambda: _draw(workload, gaussians, leaves).backward(gradient)),
    ):
        seconds, processors = _medians(work, repetitions)
        lines.append(
            f"  {name:19} {seconds * 1e3:8.1f} ms, {processors * 1e3:8.1f} ms of processors, "
            f"{seconds / pixels * 1e9:6.2f} ns a (pixel, Gaussian) pair"
        )
    return "\n".join(lines)


def peak_memory() -> str:
    """Of this process so far."""
    return f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"

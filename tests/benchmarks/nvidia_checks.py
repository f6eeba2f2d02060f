"""The checks of `tests.benchmarks.nvidia`: a GPU's results against the CPU's, repeated runs, and streams.

Compared are pictures, gradients, tile lists, similarities and harmonics. A number that is not finite fails, whatever it
is compared with: none of these scenes produces one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from opencl.backend import Backend, default_backend
from opencl.contract import RasterOutput
from opencl.harmonics import _Colors
from opencl.projection import Project, pack_camera
from opencl.rasterizer import _rasterize_on, rasterize
from opencl.ssim import _MeanSsim
from opencl.tile_lists import TileLists
from opencl.tiling import sort_into_tiles
from tests.opencl.comparison import FLOAT32
from tests.opencl.scenes import Scene, make_scene

CASES = ((1, 1), (3, 60), (16, 2000), (17, 300), (70, 300), (3, 0))
"""(Feature dimension, number of Gaussians)."""
MANY = 300_000
"""Gaussians of the large case: from 131,072 on, the counts of one pass of the sort are scanned in several chunks."""
RUNS = 20
SIMILAR = ((1, 1), (37, 53), (2, 130, 171))
"""Shapes of pictures whose similarity is compared."""
HARMONICS = ((0, 0, 300), (3, 15, 3000), (1, 15, 1), (3, 15, 0))
"""(Degree, number of harmonics besides the constant one, number of Gaussians)."""
_LARGEST_DIFFERENCE = 1e-9
"""Limit for `largest_difference` in float64."""
_PIXEL_DIFFERENCE, _SHARE_APART = 1e-4, 1e-3
"""In float32: a pixel that differs by more has a Gaussian at a threshold, and there are few such pixels."""
_BUSY = 4000
"""Rows and columns of a matrix whose products keep a GPU busy for a while."""
_SMALL_NORM = 1e-3
"""Gradients smaller than this are nothing but rounding."""


@dataclass(frozen=True)
class Drawing:
    """A rasterizer's results for a scene, on the CPU."""

    picture: Tensor
    others: tuple[Tensor, ...]
    """Alphas, radii, centres and all gradients."""

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        return (self.picture, *self.others)


Draw = Callable[[Scene], Drawing]


def drawn(scene: Scene, device: torch.device, draw: Callable[..., RasterOutput] = rasterize) -> Drawing:
    """Draw a scene with its tensors on a torch device, by `rasterize` or a function with the same arguments."""
    leaves = [tensor.to(device, copy=True).requires_grad_() for tensor in (*scene.gaussians, scene.background)]
    output = draw(*leaves[:5], *scene.camera, leaves[5], scene.settings)
    random = torch.Generator().manual_seed(0)
    weights = torch.randn(output.features.shape, generator=random, dtype=torch.float64).to(output.features)
    loss = (output.features * weights).sum() + output.alphas.square().sum()
    gradients = torch.autograd.grad(loss, [*leaves, output.means2d])
    picture, *others = (
        tensor.detach().cpu() for tensor in (output.features, output.alphas, output.radii, output.means2d, *gradients)
    )
    return Drawing(picture, tuple(others))


def drawn_on(device: torch.device) -> Draw:
    """Draws with the backend that `rasterize` selects for tensors of the device."""
    return partial(drawn, device=device)


def drawn_by(backend: Backend) -> Draw:
    """Draws with this backend, whichever `rasterize` would select."""
    return partial(drawn, device=backend.tensor_device, draw=partial(_rasterize_on, backend))


drawn_by_cpu = drawn_on(torch.device("cpu"))


def report(name: str, holds: bool, found: str) -> bool:
    print(f"{'holds' if holds else 'FAILS'}: {name}: {found}", flush=True)
    return holds


def largest_difference(found: Tensor, expected: Tensor) -> float:
    """The largest difference, relative to 1 plus the largest expected value; infinite if a number is not finite."""
    if not _are_finite(found, expected):
        return torch.inf
    if not expected.numel():
        return 0.0
    return float((found - expected).abs().max() / (1 + expected.abs().max()))


def relative_error(found: Tensor, expected: Tensor) -> float:
    """The norm of the difference, relative to that of `expected`; infinite if a number is not finite."""
    if not _are_finite(found, expected):
        return torch.inf
    return float((found.double() - expected.double()).norm() / (expected.double().norm() + _SMALL_NORM))


def share_apart(found: Tensor, expected: Tensor) -> float:
    """The share of pixels that differ visibly; infinite if a number is not finite."""
    if not _are_finite(found, expected):
        return torch.inf
    return float(((found - expected).abs().amax(dim=-1) > _PIXEL_DIFFERENCE).double().mean())


def _are_finite(*tensors: Tensor) -> bool:
    return all(bool(tensor.isfinite().all()) for tensor in tensors)


def check_float64(name: str, found: Drawing, expected: Drawing) -> bool:
    """Check that all results are the same up to rounding."""
    pairs = zip(found.tensors, expected.tensors, strict=True)
    worst = max(largest_difference(one, other) for one, other in pairs)
    return report(f"float64, {name}", worst < _LARGEST_DIFFERENCE, f"at most {worst:.1e} apart")


def check_float32(name: str, found: Drawing, expected: Drawing) -> bool:
    """Check that results are the same, except for pixels at thresholds and their part in the gradients."""
    share = share_apart(found.picture, expected.picture)
    error = max(relative_error(one, other) for one, other in zip(found.others, expected.others, strict=True))
    holds = share < _SHARE_APART and error < FLOAT32.gradients_at_thresholds
    return report(f"float32, {name}", holds, f"{share:.1e} of pixels apart, gradients by {error:.1e}")


def check_against_cpu(draw: Draw, cases: Sequence[tuple[int, int]]) -> bool:
    """Compare small scenes with the CPU, in float64 and in float32."""
    results = []
    for feature_dim, count in cases:
        scene = make_scene(count=count, feature_dim=feature_dim, width=130, height=90, size=0.1)
        name = f"{count} Gaussians, M={feature_dim}"
        results.append(check_float64(name, draw(scene), drawn_by_cpu(scene)))
        scene = scene.to(torch.float32)
        results.append(check_float32(name, draw(scene), drawn_by_cpu(scene)))
    return all(results)


def large_scene(count: int, dtype: torch.dtype) -> Scene:
    return make_scene(count=count, feature_dim=16, width=1216, height=800, size=0.01, dtype=dtype)


def check_similarities(backend: Backend) -> bool:
    """Compare structural similarities of pictures, and their gradients, with the CPU."""
    results = [check_computed(f"similarities of {shape}", partial(similarity, shape), backend) for shape in SIMILAR]
    return all(results)


def check_harmonics(backend: Backend) -> bool:
    """Compare colours of spherical harmonics, and their gradients, with the CPU."""
    results = []
    for degree, rest, count in HARMONICS:
        name = f"harmonics of degree {degree}, {count} Gaussians"
        results.append(check_computed(name, partial(colors, degree, rest, count), backend))
    return all(results)


Compute = Callable[[Backend, torch.dtype], tuple[Tensor, ...]]


def check_computed(name: str, compute: Compute, backend: Backend) -> bool:
    """Compare what a backend computes with the CPU, in both types. It must not depend on thresholds."""
    found, expected = (compute(one, torch.float64) for one in (backend, default_backend()))
    worst = max(map(largest_difference, found, expected))
    holds = report(f"float64, {name}", worst < _LARGEST_DIFFERENCE, f"at most {worst:.1e} apart")
    found, expected = (compute(one, torch.float32) for one in (backend, default_backend()))
    worst = max(map(relative_error, found, expected))
    return report(f"float32, {name}", worst < FLOAT32.gradients, f"apart by {worst:.1e}") and holds


def similarity(shape: tuple[int, ...], backend: Backend, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Similarity of two pictures, summed over pixels and channels, and its gradient, both on the CPU."""
    random = torch.Generator().manual_seed(0)
    picture, noise = (torch.rand(*shape, 3, generator=random, dtype=torch.float64) for _ in range(2))
    both = (picture, 0.6 * picture + 0.4 * noise)
    picture, truth = (tensor.to(backend.tensor_device, dtype, copy=True) for tensor in both)
    total = _MeanSsim.apply(backend, picture.requires_grad_(), truth) * picture.numel()
    (gradient,) = torch.autograd.grad(total, picture)
    return total.detach().reshape(1).cpu(), gradient.cpu()


def colors(degree: int, rest: int, count: int, backend: Backend, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Colours of random harmonics, and the gradients of base, rest and means, all on the CPU."""
    random = torch.Generator().manual_seed(0)
    shapes = ((count, 3), (count, rest, 3), (count, 3))
    drawn = [torch.randn(*shape, generator=random, dtype=torch.float64) for shape in shapes]
    leaves = [tensor.to(backend.tensor_device, dtype).requires_grad_() for tensor in drawn]
    centre = torch.tensor([0.1, -0.2, 0.3], dtype=dtype)
    found = _Colors.apply(backend, degree, *(backend.memory.receive(tensor) for tensor in (*leaves, centre)))
    gradients = torch.autograd.grad(found.square().sum(), leaves)
    return tuple(tensor.detach().cpu() for tensor in (found, *gradients))


def check_large(backend: Backend, draw: Draw, count: int) -> bool:
    """Check lists, picture and gradients of many Gaussians. `backend` is the one that draws, with the GPU schedule."""
    results = [check_lists(backend, large_scene(count, dtype)) for dtype in (torch.float64, torch.float32)]
    scene = large_scene(count, torch.float32)
    return all([*results, check_float32(f"{count} Gaussians, M=16", draw(scene), drawn_by_cpu(scene))])


def check_lists(backend: Backend, scene: Scene) -> bool:
    """Check a backend's tile lists for a projection that is computed on the CPU.

    In float64, they must equal the CPU's. In float32, quotients and roots in OpenCL may be rounded differently on two
    devices, so that a Gaussian reaches a tile on only one of them; but the lists of a device must be consistent.
    """
    cpu = default_backend()
    camera = pack_camera(*scene.camera, scene.settings)
    projected = Project.apply(cpu, scene.settings, camera, (scene.width, scene.height), *scene.gaussians)[1:]
    found, expected = (_lists_on(one, scene, projected) for one in (backend, cpu))
    faults = faults_of(found)
    if scene.means.dtype == torch.float64:
        names = ("starts", "entries", "tile_counts")
        faults += [f"other {one} than the CPU's" for one in names if not _are_equal(found, expected, one)]
    share = float((found.tile_counts != expected.tile_counts).double().mean())
    name = f"{scene.means.dtype}, lists of {len(scene.means)} Gaussians, {len(found.entries)} entries"
    said = "; ".join(faults) or f"{share:.1e} of Gaussians reach more or fewer tiles than on the CPU"
    return report(name, not faults and share < _SHARE_APART, said)


def _lists_on(backend: Backend, scene: Scene, projected: Sequence[Tensor]) -> TileLists:
    records, radii, depth_keys = (backend.memory.receive(tensor) for tensor in projected)
    lists = sort_into_tiles(backend, scene.settings, scene.width, scene.height, records, radii, depth_keys, True)
    with backend.session() as session:  # copies them from the device if they are there
        given = session.give(*vars(lists).values())
    return TileLists(*(tensor.cpu() for tensor in given))


def _are_equal(found: TileLists, expected: TileLists, name: str) -> bool:
    return torch.equal(getattr(found, name), getattr(expected, name))


def faults_of(lists: TileLists) -> list[str]:
    """The contradictions within tile lists on the CPU; empty if there are none."""
    entries, slots = lists.entries.long(), lists.slots.long()
    tile_counts, first_slots = lists.tile_counts.long(), lists.first_slots.long()
    if not torch.equal(slots.sort().values, torch.arange(len(entries))):
        return ["slots are no permutation"]
    if bool(((entries < 0) | (entries >= len(tile_counts))).any()):
        return ["entries that are no Gaussian's"]
    faults = []
    if int(lists.starts[0]) != 0 or bool((lists.starts.diff() < 0).any()):
        faults.append("tiles that do not follow each other")
    if int(lists.starts[-1]) != len(entries):
        faults.append("tiles that are counted and not found again")
    if not torch.equal(entries.bincount(minlength=len(tile_counts)), tile_counts):
        faults.append("Gaussians with more or fewer entries than were counted")
    places = slots - first_slots[entries]
    if bool(((places < 0) | (places >= tile_counts[entries])).any()):
        faults.append("slots of a Gaussian that do not lie side by side")
    return faults


def check_runs(draw: Draw) -> bool:
    """Check that every run gives the same bits."""
    scene = make_scene(count=5000, feature_dim=16, width=400, height=300, size=0.05, dtype=torch.float32)
    first = draw(scene).tensors
    same = all(
        torch.equal(one, other) for _ in range(RUNS) for one, other in zip(first, draw(scene).tensors, strict=True)
    )
    return report(f"{RUNS} runs", same, "the same bits" if same else "different bits, or NaN")


def check_streams(device: torch.device) -> bool:
    """Check drawing on another stream, between torch's kernels that make the inputs and those that read the output."""
    scene = make_scene(count=3000, feature_dim=8, width=300, height=200, size=0.05, dtype=torch.float32)
    gaussians = [tensor.to(device) for tensor in scene.gaussians]
    background = scene.background.to(device)
    expected = rasterize(*gaussians, *scene.camera, background, scene.settings).features * 2
    busy, found = torch.randn(_BUSY, _BUSY, device=device), []
    torch.cuda.synchronize()  # so that everything the streams read is there
    for _ in range(10):
        with torch.cuda.stream(torch.cuda.Stream()):
            delay = (busy @ busy @ busy).sum() * 0
            late = [tensor + delay for tensor in gaussians]
            found.append(rasterize(*late, *scene.camera, background, scene.settings).features * 2)
    torch.cuda.synchronize()
    same = all(torch.equal(one, expected) for one in found)
    return report("torch's streams", same, "in order" if same else "read before they were written, or NaN")

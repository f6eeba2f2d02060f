"""Running sums, sorts and tile lists of the GPU schedule."""

from __future__ import annotations

import pyopencl
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

import opencl.memory
from opencl.backend import Backend
from opencl.contract import RasterSettings
from opencl.device import choose_device
from opencl.program import SCAN_CHUNK, SORT_CHUNK, TILE, ProgramKey
from opencl.projection import Project, pack_camera
from opencl.radix_sort import scan, sort_by_keys
from opencl.tile_lists import TileLists
from opencl.tiling import sort_into_tiles
from tests.opencl.runtimes import bits, draw_on, draw_with_gradients
from tests.opencl.scenes import Scene, make_scene

KEYS = {torch.float32: torch.int32, torch.float64: torch.int64}
NOT_WRITTEN = {torch.float32: float("nan"), torch.int32: -7, torch.int64: -7}


@pytest.fixture(scope="module")
def backend() -> Backend:
    return Backend(choose_device(), schedule="gpu")


def program(dtype: torch.dtype) -> ProgramKey:
    return ProgramKey("geometry", "gpu", dtype, RasterSettings())


def scanned(backend: Backend, values: Tensor) -> tuple[Tensor, int]:
    sums = values.clone()
    with backend.session() as session:
        total = scan(session, program(torch.float32), sums)
        session.finish(sums, total)
    return sums, total.item()


def sort(backend: Backend, keys: Tensor, bits: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    payloads = torch.arange(len(keys), dtype=torch.int32)
    with backend.session() as session:
        sorted_keys, sorted_payloads = sort_by_keys(session, program(dtype), bits, keys.clone(), payloads)
        session.finish(sorted_keys, sorted_payloads)
    return sorted_keys, sorted_payloads


@pytest.mark.parametrize(
    "count", [0, 1, 255, 256, 257, SCAN_CHUNK - 1, SCAN_CHUNK, SCAN_CHUNK + 1, 100_000, SCAN_CHUNK**2 + 1]
)
def test_running_sums(backend, count):
    # Totals may exceed 2^31, as the number of pairs does for Gaussians that are too large.
    values = torch.randint(0, 10**6, (count,), generator=torch.Generator().manual_seed(count))
    sums, total = scanned(backend, values)
    assert torch.equal(sums, values.cumsum(0) - values)
    assert total == values.sum()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, SORT_CHUNK - 1, SORT_CHUNK, SORT_CHUNK + 1, 100_000])
def test_sorts_of_any_length(backend, dtype, count):
    bits = torch.iinfo(KEYS[dtype]).bits
    random = torch.Generator().manual_seed(count)
    keys = torch.randint(0, torch.iinfo(KEYS[dtype]).max, (count,), generator=random, dtype=KEYS[dtype])
    keys[::3] = keys[: len(keys[::3])].clone()  # equal keys, far from each other
    sorted_keys, payloads = sort(backend, keys, bits, dtype)
    expected = torch.sort(keys, stable=True)
    assert torch.equal(sorted_keys, expected.values)
    assert torch.equal(payloads.long(), expected.indices)


@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_sorts_are_stable_and_take_keys_as_unsigned(backend, data):
    bits = data.draw(st.sampled_from([1, 4, 5, 12, 31, 32]))
    few = st.sampled_from(data.draw(st.lists(st.integers(0, 2**bits - 1), min_size=1, max_size=5)))
    values = data.draw(st.lists(few | st.integers(0, 2**bits - 1), max_size=600))
    repeated = torch.tensor(values * data.draw(st.integers(1, 5)), dtype=torch.int64)
    keys = torch.where(repeated < 2**31, repeated, repeated - 2**32).to(torch.int32)
    sorted_keys, payloads = sort(backend, keys, bits, torch.float32)
    expected = torch.sort(repeated, stable=True)
    assert torch.equal(payloads.long(), expected.indices)
    assert torch.equal(sorted_keys, keys[expected.indices])


def test_equal_keys_keep_their_order_over_many_chunks(backend):
    keys = torch.zeros(5 * SORT_CHUNK + 7, dtype=torch.int32)
    assert torch.equal(sort(backend, keys, 32, torch.float32)[1], torch.arange(len(keys), dtype=torch.int32))


def lists_of(backend: Backend, scene: Scene) -> tuple[TileLists, Tensor]:
    """A scene's tile lists, and which of its Gaussians are visible."""
    camera = pack_camera(*scene.camera, scene.settings)
    size = (scene.width, scene.height)
    _, records, radii, depth_keys = Project.apply(backend, scene.settings, camera, size, *scene.gaussians)
    return sort_into_tiles(backend, scene.settings, *size, records, radii, depth_keys, True), radii > 0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [(150, 90), (16, 16), (3, 40)])
def test_lists_are_those_of_the_other_schedule(backend, dtype, size):
    scene = make_scene(count=5000, feature_dim=1, width=size[0], height=size[1], dtype=dtype)
    scene.means[::7] = scene.means[1]  # equal depths
    scene.means[1000:1500] *= -1  # behind the camera
    other = Backend(choose_device(), schedule="cpu")
    (lists, visible), (expected, _) = lists_of(backend, scene), lists_of(other, scene)
    assert visible.any()
    assert not visible.all()
    for name in ("starts", "entries", "tile_counts"):
        assert torch.equal(getattr(lists, name), getattr(expected, name)), name


def test_slots_of_a_gaussian_lie_side_by_side(backend):
    scene = make_scene(count=3000, feature_dim=1, width=150, height=90, dtype=torch.float32)
    lists, _ = lists_of(backend, scene)
    gaussians = torch.empty_like(lists.entries)
    gaussians[lists.slots.long()] = lists.entries
    assert torch.equal(lists.slots.sort().values, torch.arange(len(lists.slots), dtype=torch.int32))
    for gaussian in lists.tile_counts.nonzero().flatten().tolist():
        first, count = int(lists.first_slots[gaussian]), int(lists.tile_counts[gaussian])
        assert (gaussians[first : first + count] == gaussian).all()
    assert lists.tile_counts.sum() == len(lists.entries)


def miscount(monkeypatch: pytest.MonkeyPatch, change: int) -> None:
    """Make only the kernel that counts tiles find `change` more for each visible Gaussian."""
    text = ProgramKey.text
    counted = "tile_counts[gaussian] = total;"
    wrong = f"if (radii[gaussian] > 0) total = max(total + {change}, 0); {counted}"
    monkeypatch.setattr(ProgramKey, "text", lambda key: text(key).replace(counted, wrong))


CROWDED = make_scene(count=400, feature_dim=3, width=150, height=90, dtype=torch.float32)
CROWDED.means[::9] *= -1  # behind the camera


@pytest.mark.parametrize("change", [1, 3])
def test_slots_that_are_counted_and_not_filled_hurt_nobody(backend, monkeypatch, change):
    (expected, _), (output, found) = lists_of(backend, CROWDED), draw_with_gradients(backend, CROWDED)
    miscount(monkeypatch, change)
    # Values that nothing writes are NaN, or -7 as integers.
    monkeypatch.setattr(
        opencl.memory, "empty", lambda *size, dtype: torch.empty(size, dtype=dtype).fill_(NOT_WRITTEN[dtype])
    )
    wrong = Backend(choose_device(), schedule="gpu")
    (lists, visible), (again, found_again) = lists_of(wrong, CROWDED), draw_with_gradients(wrong, CROWDED)
    assert len(lists.entries) == len(expected.entries) + change * visible.sum()
    assert torch.equal(lists.starts, expected.starts)
    assert torch.equal(lists.entries[: len(expected.entries)], expected.entries)
    assert torch.equal(lists.tile_counts, expected.tile_counts)
    assert torch.equal(lists.slots.sort().values, torch.arange(len(lists.slots), dtype=torch.int32))
    assert bits(again.features) == bits(output.features)
    assert [bits(one) for one in found_again] == [bits(one) for one in found]


def test_tiles_that_are_not_counted_are_left_out(backend, monkeypatch):
    expected, _ = lists_of(backend, CROWDED)
    last_slots = expected.first_slots + expected.tile_counts - 1
    kept = expected.slots != last_slots[expected.entries.long()]
    miscount(monkeypatch, -1)
    wrong = Backend(choose_device(), schedule="gpu")
    (lists, _), (output, found) = lists_of(wrong, CROWDED), draw_with_gradients(wrong, CROWDED)
    assert torch.equal(lists.entries, expected.entries[kept])
    assert torch.equal(lists.tile_counts, (expected.tile_counts - 1).clamp(min=0))
    dropped_before = (~kept).cumsum(0)
    starts = expected.starts.clone()
    starts[1:] -= torch.cat([dropped_before.new_zeros(1), dropped_before])[expected.starts[1:].long()].int()
    assert torch.equal(lists.starts, starts)
    assert all(tensor.isfinite().all() for tensor in (output.features, *found))


def test_a_gaussian_over_the_whole_picture_among_small_ones(backend):
    scene = make_scene(count=300, feature_dim=1, width=20 * TILE, height=15 * TILE, size=0.02, dtype=torch.float32)
    scene.scales[17] = 100.0
    scene.opacities[17] = 1.0
    lists, _ = lists_of(backend, scene)
    assert lists.tile_counts[17] == 300
    places = (lists.entries == 17).nonzero().flatten()
    assert ((places >= lists.starts[:-1]) & (places < lists.starts[1:])).all()


def test_pictures_of_every_size_are_blended_by_one_program():
    # Only the CPU schedule has other instructions to write a picture that exceeds its caches.
    blended = Backend(choose_device(), schedule="gpu")
    for side in (16, 1600):
        draw_on(blended, make_scene(count=1, feature_dim=4, width=side, height=side, dtype=torch.float32))
    assert [key.part for key in blended._programs] == ["geometry", "blending"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("feature_dim", [1, 16, 17, 32, 64])
def test_local_memory_fits_the_smallest_gpus(backend, dtype, feature_dim):
    blending = ProgramKey("blending", "gpu", dtype, RasterSettings(), feature_dim)
    kernels = dict.fromkeys(("blend", "blend_backward", "sum_gradients", "sum_background"), blending)
    kernels |= dict.fromkeys(("scan_chunks", "count_digits", "move_by_digit"), program(dtype))
    for name, key in kernels.items():
        used = backend.kernel(key, name).get_work_group_info(
            pyopencl.kernel_work_group_info.LOCAL_MEM_SIZE, backend.device.handle
        )
        assert used <= 32 * 1024, f"{name}: {used} bytes"

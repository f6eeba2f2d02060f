"""Devices with memory of their own: what is copied there and back, and that nothing stale is ever used."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pyopencl
import pytest
import torch

from opencl import staging
from opencl.backend import Backend
from opencl.device import choose_device
from opencl.program import TILING_RUNS, ProgramKey
from opencl.projection import RECORD
from opencl.rasterizer import RasterSettings, _rasterize_on
from opencl.staging import StagedMemory
from tests.opencl.runtimes import SCHEDULES
from tests.opencl.scenes import gradients, make_scene


@pytest.fixture(scope="module", params=SCHEDULES)
def staged(request) -> Backend:
    return Backend(choose_device(), schedule=request.param, shares_memory=False)


@pytest.fixture(scope="module")
def shared(staged) -> Backend:
    return Backend(choose_device(), schedule=staged.schedule, shares_memory=True)


def draw(backend, scene):
    return _rasterize_on(backend, *scene.gaussians, *scene.camera, scene.background, scene.settings)


def trainable(scene):
    """New leaves, and the scene made of them."""
    leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
    means, quats, scales, opacities, features, background = leaves
    return leaves, replace(
        scene, means=means, quats=quats, scales=scales, opacities=opacities, features=features, background=background
    )


def everything(backend, scene):
    """Outputs and gradients of a drawing."""
    leaves, scene = trainable(scene)
    output = draw(backend, scene)
    return (output.features, output.alphas, output.radii, output.means2d, *gradients(output, leaves))


def total(*tensors):
    return sum(tensor.nbytes for tensor in tensors)


@pytest.mark.parametrize("feature_dim", [3, 70])
def test_the_same_bits_as_shared_memory(staged, shared, feature_dim):
    scene = make_scene(count=80, feature_dim=feature_dim, dtype=torch.float32)
    for one, other in zip(everything(staged, scene), everything(shared, scene), strict=True):
        assert torch.equal(one, other)


def test_the_same_bits_in_small_pieces(staged, shared, monkeypatch):
    monkeypatch.setattr(staging, "_PINNED_BYTES", 1000)
    scene = make_scene(count=80, dtype=torch.float32)
    pieces = Backend(choose_device(), schedule=staged.schedule, shares_memory=False)
    for one, other in zip(everything(pieces, scene), everything(shared, scene), strict=True):
        assert torch.equal(one, other)


def test_empty_and_invisible_scenes(staged, shared):
    for scene in (make_scene(count=0), make_scene(count=5, opacity=(0.0, 0.001))):
        for one, other in zip(everything(staged, scene), everything(shared, scene), strict=True):
            assert torch.equal(one, other)


def test_only_inputs_and_outputs_are_copied(staged):
    """In a forward and a backward pass, lists, records and gradient rows stay on the device."""
    memory = staged.memory
    assert isinstance(memory, StagedMemory)
    leaves, scene = trainable(make_scene(count=200, feature_dim=16, width=64, height=48, dtype=torch.float32))
    camera_bytes = 20 * 4

    before = memory.uploaded, memory.downloaded
    output = draw(staged, scene)
    output_bytes = total(output.features, output.alphas, output.radii, output.means2d)
    totals = {"cpu": TILING_RUNS + 1, "gpu": 1}  # numbers of entries, for which torch allocates memory
    totals_bytes = totals[staged.schedule] * 8
    assert memory.uploaded - before[0] == total(*leaves) + camera_bytes
    assert memory.downloaded - before[1] == output_bytes + totals_bytes

    before = memory.uploaded, memory.downloaded
    found = gradients(output, leaves)
    assert memory.uploaded - before[0] == total(output.features, output.alphas, output.means2d)
    assert memory.downloaded - before[1] == total(*found)


def test_gradients_of_records_are_copied_where_torch_reads_them(staged, shared):
    """torch sums those of several passes, and looks for NaN if it is asked to."""
    memory = staged.memory
    assert isinstance(memory, StagedMemory)
    for feature_dim, passes, anomalies in ((70, 2, False), (3, 1, True)):
        leaves, scene = trainable(make_scene(count=80, feature_dim=feature_dim, dtype=torch.float32))
        output = draw(staged, scene)
        before = memory.downloaded
        with torch.autograd.set_detect_anomaly(anomalies):
            found = gradients(output, leaves)
        records_bytes = len(scene.means) * RECORD * 4
        centres_bytes = (passes - 1) * total(output.means2d)
        assert memory.downloaded - before == total(*found) + centres_bytes + passes * records_bytes


def test_without_gradients_nothing_stays_on_the_device(staged):
    memory = staged.memory
    assert isinstance(memory, StagedMemory)
    with torch.no_grad():
        pictures = [draw(staged, make_scene(count=20, dtype=torch.float32)) for _ in range(3)]
    memory.empty(1, dtype=torch.int32)  # forgets what is gone
    assert len(pictures) == 3
    assert sum(not kept.storage.expired() for kept in memory._residents.values()) <= 1


@pytest.mark.parametrize(
    "change",
    [lambda given: given.mul_(0.5), lambda given: given.data.mul_(0.5), lambda given: given.numpy().fill(0.3)],
    ids=["torch", "data", "numpy"],
)
def test_inputs_changed_in_place_are_seen(staged, shared, change):
    scene = make_scene(count=30, dtype=torch.float32)
    first = draw(staged, scene).features
    change(scene.opacities)
    second = draw(staged, scene).features
    assert not torch.equal(first, second)
    assert torch.equal(second, draw(shared, scene).features)


def test_gradients_are_those_of_what_was_drawn(staged, shared):
    """Whatever the caller does to inputs and outputs between the passes."""
    scene = make_scene(count=30, dtype=torch.float32)
    expected = everything(shared, scene)
    leaves, scene = trainable(scene)
    output = draw(staged, scene)
    for tensor in (*leaves, output.features, output.alphas, output.means2d):
        tensor.data.fill_(7)
    assert all(torch.equal(one, other) for one, other in zip(gradients(output, leaves), expected[4:], strict=True))


def test_outputs_may_come_in_again(staged, shared):
    scene = make_scene(count=30, feature_dim=2, dtype=torch.float32)
    centres = draw(staged, scene).means2d
    centres.data.mul_(0.01)
    again = replace(scene, features=centres)
    assert torch.equal(draw(staged, again).features, draw(shared, again).features)


def test_gradients_changed_on_their_way_are_seen(staged, shared):
    def triple(gradient):
        gradient.data.mul_(3)

    results = []
    for backend in (staged, shared):
        leaves, scene = trainable(make_scene(count=30, dtype=torch.float32))
        output = draw(backend, scene)
        output.means2d.register_hook(triple)
        results.append(gradients(output, leaves))
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))


def test_memory_at_the_same_address_is_not_mistaken(staged, shared):
    """torch frees and allocates the same memory all the time."""
    for seed in range(10):
        scene = make_scene(count=30, seed=seed, dtype=torch.float32)
        assert torch.equal(draw(staged, scene).features, draw(shared, scene).features)


def test_copies_of_what_only_the_device_holds_are_refused(staged, shared):
    """Hooks on saved tensors make such copies: gradients would be computed from whatever that memory holds."""
    leaves, scene = trainable(make_scene(count=20, dtype=torch.float32))
    expected = gradients(draw(shared, scene), leaves)
    for backend in (shared, staged):
        with torch.autograd.graph.saved_tensors_hooks(lambda kept: kept.clone(), lambda kept: kept):
            output = draw(backend, scene)
        if backend is staged:
            with pytest.raises(RuntimeError, match=r"found a copy of what was kept .* Draw outside of such hooks"):
                gradients(output, leaves)
        else:
            assert all(torch.equal(*pair) for pair in zip(gradients(output, leaves), expected, strict=True))


def test_a_part_of_what_only_the_device_holds_is_refused(staged):
    program = ProgramKey("geometry", staged.schedule, torch.float32, RasterSettings())
    whole = staged.memory.empty(8, dtype=torch.int32)
    with staged.session() as session, pytest.raises(RuntimeError, match="found a part of what only the device holds"):
        session.launch(program, "project", 1, whole[:4])
    whole.zero_()
    with staged.session() as session, pytest.raises(RuntimeError, match="found a change on the CPU"):
        session.launch(program, "project", 1, whole)


@pytest.mark.parametrize(
    "make",
    [
        lambda memory: memory.empty(1, dtype=torch.int32),
        lambda memory: memory.zeros(1, dtype=torch.int32),
        lambda memory: memory.resident(memory.receive(torch.zeros(1))),
    ],
    ids=["empty", "zeros", "received"],
)
def test_no_room_on_the_device_is_named(staged, make, monkeypatch):
    def full(size):
        raise pyopencl.MemoryError("memory_pool::allocate", -4, "failed to free memory for allocation")

    memory = staged.memory
    pool = SimpleNamespace(
        allocate=full, active_bytes=0, managed_bytes=0, bin_number=lambda size: size, alloc_size=lambda number: number
    )
    monkeypatch.setattr(memory, "_pool", pool)
    with pytest.raises(RuntimeError, match=r"no room for 0\.00 GiB in one piece.*at most .*Take a smaller picture"):
        make(memory)


class WatchedPool:
    """A pool that notes how many bytes are in use at each allocation."""

    def __init__(self, pool):
        self._pool, self.in_use = pool, []

    def allocate(self, size):
        self.in_use.append(self._pool.active_bytes)
        return self._pool.allocate(size)

    def __getattr__(self, name):
        return getattr(self._pool, name)


def test_buffers_of_what_is_gone_make_room_before_others_are_allocated(staged, monkeypatch):
    """Otherwise the gradient rows of two cameras or passes, the largest of all buffers, would be held at once."""
    memory = StagedMemory(staged.context, staged.queue)
    watched = WatchedPool(memory._pool)
    monkeypatch.setattr(memory, "_pool", watched)
    for _ in range(3):
        tensor = memory.empty(2**16, dtype=torch.uint8)
        del tensor
    assert watched.in_use == [0, 0, 0]


def test_pinned_memory_that_was_refused_once_is_asked_for_again(staged, shared, monkeypatch):
    """Half a pair of areas must not remain: every later copy would fail."""
    backend = Backend(choose_device(), schedule=staged.schedule, shares_memory=False)
    mapped, calls = backend.memory._pinned._mapped_area, []

    def second_fails():
        calls.append(1)
        if len(calls) == 2:
            raise pyopencl.MemoryError("clEnqueueMapBuffer", -4)
        return mapped()

    monkeypatch.setattr(staging, "_PINNED_BYTES", 1000)
    monkeypatch.setattr(backend.memory._pinned, "_mapped_area", second_fails)
    scene = make_scene(count=80, dtype=torch.float32)
    with pytest.raises(RuntimeError, match=r"no room for 0\.00 GiB in one piece"):
        draw(backend, scene)
    assert torch.equal(draw(backend, scene).features, draw(shared, scene).features)


def test_resources_that_are_missing_only_at_a_launch_are_a_runtime_error(staged):
    error = pyopencl.MemoryError("clEnqueueNDRangeKernel", -5)
    with (
        pytest.raises(RuntimeError, match=r"device .*clEnqueueNDRangeKernel.*Take a smaller picture"),
        staged.session(),
    ):
        raise error


def test_buffers_of_what_grows_are_given_back(staged):
    """The size of gradient rows changes in each iteration: the pool would keep every size until the device is full."""
    memory = StagedMemory(staged.context, staged.queue)
    size = 2**16
    while size < 2**22:
        tensor = memory.empty(size, dtype=torch.uint8)
        del tensor
        memory.empty(1, dtype=torch.uint8)  # notices that the one before is gone
        size = size * 103 // 100
    assert memory._pool.managed_bytes <= 2 * 2**22


def test_buffers_of_one_size_are_used_again(staged):
    memory = StagedMemory(staged.context, staged.queue)
    for _ in range(5):
        tensors = [memory.empty(2**16, dtype=torch.uint8) for _ in range(3)]
        held = memory._pool.managed_bytes
        del tensors
    assert held == memory._pool.managed_bytes <= 5 * 2**16


def test_a_piece_of_nearly_the_largest_size_is_not_rounded_beyond_it(staged):
    memory = StagedMemory(staged.context, staged.queue)
    size = 2**20 + 5
    assert memory._allocate(size).size > size, "the pool rounds"
    memory._largest = size
    assert memory._allocate(size).size == size
    assert memory._allocate(2**19).size <= size


def test_buffers_that_nothing_stands_for_are_given_back_when_a_stage_has_ended(staged):
    """Other processes may draw on the device next."""
    memory = StagedMemory(staged.context, staged.queue)
    tensors = [memory.empty(2**16, dtype=torch.uint8) for _ in range(3)]
    in_use = memory._pool.managed_bytes
    staging.return_held_memory()
    assert memory._pool.managed_bytes == in_use
    del tensors[1:]
    staging.return_held_memory()
    assert memory._pool.managed_bytes == in_use // 3


def test_zeros_are_zeros(staged):
    zeros = staged.memory.zeros(3, 5, dtype=torch.float64)
    zeros.data.numpy().fill(1)  # what the device holds is what counts
    with staged.session() as session:
        (given,) = session.give(zeros)
    assert torch.equal(given, torch.zeros(3, 5, dtype=torch.float64))


def test_inference_mode(staged, shared):
    scene = make_scene(count=30, dtype=torch.float32)
    with torch.inference_mode():
        assert torch.equal(draw(staged, scene).features, draw(shared, scene).features)

"""The route through the CUDA driver, on a fake driver that runs the kernels by OpenCL on the CPU."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import opencl.harmonics
import opencl.ssim
from opencl.backend import Backend
from opencl.cuda import CudaBackend, Resources
from opencl.cuda_driver import CudaDriver
from opencl.device import choose_device
from opencl.harmonics import colors_of_harmonics
from opencl.memory import moved
from opencl.program import ProgramKey
from opencl.projection import Project, pack_camera
from opencl.rasterizer import RasterSettings, _rasterize_on
from opencl.ssim import mean_ssim
from opencl.tiling import sort_into_tiles
from tests.opencl.fake_cuda import PRIMARY_CONTEXT, STREAM, FakeCuda, backend_on
from tests.opencl.scenes import gradients, make_scene

GEOMETRY = ProgramKey("geometry", "cpu", torch.float32, RasterSettings())
NOTHING = torch.empty(0)


@pytest.fixture
def cuda() -> FakeCuda:
    return FakeCuda(Backend(choose_device()).context)


@pytest.fixture
def backend(cuda, monkeypatch) -> CudaBackend:
    return backend_on(cuda, monkeypatch)


def place_tiles(session, *, tiles=3, places=None, starts=None, totals=None, **options):
    """Launch a small kernel with the parameters (int, int *, int *, long *)."""
    places = torch.ones(32 * 3, dtype=torch.int32) if places is None else places
    starts = torch.empty(4, dtype=torch.int32) if starts is None else starts
    totals = torch.zeros(33, dtype=torch.int64) if totals is None else totals
    session.launch(GEOMETRY, "place_tiles", 1, tiles, places, starts, totals, **options)
    return starts


class StandIn:
    """A fake tensor that records how it is copied."""

    def __init__(self, **facts):
        self.facts = {"is_cpu": True, "nbytes": 80, "pinned": False, "requires_grad": False} | facts
        self.copies = []

    def __getattr__(self, name):
        return self.facts[name]

    def is_pinned(self):
        return self.facts["pinned"]

    def pin_memory(self):
        self.copies.append("pinned memory of torch's own")
        return self

    def to(self, device, non_blocking=False):
        self.copies.append((device, "later" if non_blocking else "at once"))


def test_a_small_tensor_is_copied_by_memory_that_nobody_changes_or_frees():
    """The device may read it after the rasterizer has freed its own tensor, such as a camera."""
    camera = StandIn()
    moved(camera, torch.device("cuda:0"))
    assert camera.copies == ["pinned memory of torch's own", (torch.device("cuda:0"), "later")]


@pytest.mark.parametrize(
    ("facts", "device"),
    [
        ({"pinned": True}, "cuda:0"),  # its owner may change it
        ({"nbytes": 2**20}, "cuda:0"),
        ({"requires_grad": True}, "cuda:0"),
        ({"is_cpu": False}, "cpu"),
        ({}, "mps"),
    ],
)
def test_other_copies_are_waited_for(facts, device):
    tensor = StandIn(**facts)
    moved(tensor, torch.device(device))
    assert tensor.copies == [(torch.device(device), "at once")]


@pytest.mark.parametrize("schedule", ["cpu", "gpu"])
@pytest.mark.parametrize("feature_dim", [3, 70])
def test_the_same_bits_as_opencl(backend, feature_dim, schedule):
    backend.schedule = schedule
    scene = make_scene(count=80, feature_dim=feature_dim, dtype=torch.float32)
    results = []
    for one in (backend, Backend(choose_device(), schedule=schedule)):
        leaves = tuple(tensor.clone().requires_grad_() for tensor in (*scene.gaussians, scene.background))
        output = _rasterize_on(one, *leaves[:5], *scene.camera, leaves[5], scene.settings)
        results.append((output.features, output.alphas, output.radii, output.means2d, *gradients(output, leaves)))
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_similarities_and_harmonics_are_the_same_bits_too(cuda, backend, dtype, monkeypatch):
    backend.schedule = "gpu"
    results = []
    for one in (backend, Backend(choose_device(), schedule="gpu")):
        for module in (opencl.ssim, opencl.harmonics):
            monkeypatch.setattr(module, "backend_for", lambda tensor_device, one=one: one)
        results.append([*similarity_and_gradient(dtype), *colors_and_gradients(dtype)])
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))
    launched = {kernel for kernel, *_ in cuda.launches}
    fused = {"similarities", "similarity_gradient", "colors_of_harmonics", "colors_of_harmonics_backward"}
    assert launched == fused


def similarity_and_gradient(dtype):
    random = torch.Generator().manual_seed(0)
    picture, truth = (torch.rand(37, 53, 3, generator=random, dtype=dtype) for _ in range(2))
    picture.requires_grad_()
    similarity = mean_ssim(picture, truth)
    return similarity.detach(), *torch.autograd.grad(similarity, picture)


def colors_and_gradients(dtype):
    """For the constant harmonic alone, whose empty `rest` has no address for the kernel, and for all harmonics."""
    random = torch.Generator().manual_seed(0)
    found = []
    for degree in (0, 3):
        shapes = ((300, 3), (300, (degree + 1) ** 2 - 1, 3), (300, 3))
        leaves = [torch.randn(*shape, generator=random, dtype=dtype).requires_grad_() for shape in shapes]
        colors = colors_of_harmonics(*leaves, torch.zeros(3, dtype=dtype), degree)
        found += [colors.detach(), *torch.autograd.grad(colors.square().sum(), leaves)]
    return found


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_sorts_as_the_kernels_do(cuda, backend, dtype):
    backend.schedule = "gpu"
    scene = make_scene(count=3000, feature_dim=1, width=150, height=90, dtype=dtype)
    scene.means[::7] = scene.means[1]  # equal depths
    scene.means[1000:1500] *= -1  # behind the camera
    lists = []
    for one in (backend, Backend(choose_device(), schedule="gpu")):
        camera = pack_camera(*scene.camera, scene.settings)
        size = (scene.width, scene.height)
        _, records, radii, depth_keys = Project.apply(one, scene.settings, camera, size, *scene.gaussians)
        lists.append(sort_into_tiles(one, scene.settings, *size, records, radii, depth_keys, True))
    assert (radii == 0).any()
    found, expected = lists
    have_slots = expected.tile_counts > 0  # the first slots of others are undefined
    for name in ("starts", "entries", "slots", "tile_counts"):
        assert torch.equal(getattr(found, name), getattr(expected, name)), name
        assert getattr(found, name).dtype == torch.int32
    assert torch.equal(found.first_slots[have_slots], expected.first_slots[have_slots])
    launched = [kernel for kernel, *_ in cuda.launches if kernel not in ("scan_chunks", "add_chunk_starts")]
    assert launched == ["project", "key_by_depth", "count_tiles", "fill_slots", "start_tiles", "fill_entries"]


def test_a_launch_in_torch_s_context_and_stream(cuda, backend):
    before = len(cuda.calls)
    starts = torch.full((4,), -1, dtype=torch.int32)
    places, totals = torch.ones(32 * 3, dtype=torch.int32), torch.zeros(33, dtype=torch.int64)
    with backend.session() as session:
        place_tiles(session, places=places, starts=starts, totals=totals)
        cuda.runs = False
        place_tiles(session, tiles=-1, starts=torch.empty(0, dtype=torch.int32), places=places, totals=totals)
    assert starts.tolist() == [0, 32, 64, 96]
    addresses = [places.data_ptr(), starts.data_ptr(), totals.data_ptr()]
    assert cuda.launches == [
        ("place_tiles", 1, 1, STREAM, [3, *addresses]),
        ("place_tiles", 1, 1, STREAM, [-1, addresses[0], 0, addresses[2]]),
    ]
    assert cuda.calls[before:] == [
        *("torch.cuda.device", "cuCtxPushCurrent_v2"),
        *("cuModuleLoadDataEx", "cuModuleGetFunction", "cuFuncGetAttribute"),
        *("cuLaunchKernel", "cuLaunchKernel", "cuCtxPopCurrent_v2"),
    ]
    assert cuda.current == []


def test_what_is_loaded_is_rewritten(cuda, backend):
    with backend.session() as session:
        place_tiles(session)
    (image,) = cuda.images
    assert "envreg" not in image
    assert ".ptr" not in image
    assert "texmode_independent" not in image


def test_the_footprints_program_alone_is_rounded_as_written(cuda, backend):
    backend._compile = lambda program: cuda.compile_program(program).replace(b"ret;", b"mul.f32 %f1, %f2, %f3; ret;")
    with backend.session() as session:
        place_tiles(session)
        session.launch(replace(GEOMETRY, part="harmonics"), "colors_of_harmonics", 1, *(0,) * 3, *(NOTHING,) * 5)
    geometry, harmonics = cuda.images
    assert "mul.rn.f32" in geometry
    assert "mul.f32" not in geometry
    assert "mul.rn.f32" not in harmonics


def test_groups_of_many_and_none(cuda, backend):
    with backend.session() as session:
        session.launch(GEOMETRY, "place_tiles", 0, 1, 2, 3)
        assert cuda.launches == []
        place_tiles(session, group_size=2)
    assert cuda.launches[0][1:3] == (1, 2)


def test_a_program_is_loaded_once(cuda, backend):
    for _ in range(2):
        with backend.session() as session:
            place_tiles(session)
    assert cuda.calls.count("cuModuleLoadDataEx") == cuda.calls.count("cuModuleGetFunction") == 1


def test_the_context_is_given_back_after_an_error(cuda, backend):
    def launch_nothing():
        with backend.session() as session:
            assert cuda.current == [PRIMARY_CONTEXT]
            session.launch(GEOMETRY, "nothing", 1)

    with pytest.raises(ValueError, match="nothing"):
        launch_nothing()
    assert cuda.current == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tiles": 2**31}, r"kernel place_tiles, argument 0: found 2147483648, expected a number of 32 bits"),
        ({"tiles": torch.ones(3)}, r"argument 0: found a tensor, expected what takes 4 bytes"),
        ({"places": 5}, r"argument 1: found an integer, expected what takes 8 bytes"),
        ({"starts": torch.empty(8, dtype=torch.int32)[::2]}, r"argument 2: .* strides \(2,\), expected a contiguous"),
        ({"totals": torch.empty(33, device="meta")}, r"argument 3: found a tensor on meta .* expected .* on cpu"),
        ({"starts": torch.empty(99, dtype=torch.int8)[1:]}, r"argument 2: found the address \d+, .* multiple of 4"),
        ({"group_size": 2048}, r"found groups of 2048 work-items, expected at most 1024"),
    ],
)
def test_arguments_are_checked(cuda, backend, change, message):
    with backend.session() as session, pytest.raises(ValueError, match=message):
        place_tiles(session, **change)
    assert cuda.launches == []


def test_the_number_of_arguments_is_checked(backend):
    with backend.session() as session, pytest.raises(ValueError, match="found 2 arguments, expected 4"):
        session.launch(GEOMETRY, "place_tiles", 1, 2, torch.ones(1))


def test_a_kernel_that_does_not_exist(backend):
    with backend.session() as session, pytest.raises(ValueError, match=r"kernel nothing: .*, place_tiles"):
        session.launch(GEOMETRY, "nothing", 1)


def test_the_driver_s_errors_name_call_and_kernel(cuda, backend):
    cuda.status["cuLaunchKernel"] = 701
    message = (
        r"^cuLaunchKernel of kernel place_tiles with 1 groups of 1 work-items and 4 arguments: "
        r"CUDA_ERROR_701 \(701\): what 701 means$"
    )
    with backend.session() as session, pytest.raises(RuntimeError, match=message):
        place_tiles(session)


def test_the_assembler_s_complaint_is_shown(cuda, backend):
    backend._compile = lambda program: cuda.compile_program(program).replace(b"ret;", b"refused;")
    with (
        backend.session() as session,
        pytest.raises(RuntimeError, match=r"CUDA_ERROR_218 .*the driver's assembler said: ptxas .* line 7"),
    ):
        place_tiles(session)


@pytest.mark.parametrize("function", ["cuInit", "cuDevicePrimaryCtxRetain", "cuDeviceGet"])
def test_a_driver_that_does_not_start(cuda, function):
    cuda.status[function] = 100
    with pytest.raises(RuntimeError, match=rf"{function}.*CUDA_ERROR_100"):
        CudaDriver(cuda.functions).primary_context(0)


def test_a_driver_that_gives_nothing(cuda):
    cuda._cuDevicePrimaryCtxRetain = lambda context, device: 0
    with pytest.raises(RuntimeError, match="null handle"):
        CudaDriver(cuda.functions).primary_context(0)


def test_an_error_without_a_name(cuda):
    cuda._cuGetErrorName = cuda._cuGetErrorString = lambda status, text: 1
    cuda.status["cuInit"] = 9999
    with pytest.raises(RuntimeError, match=r"an error that the driver does not know \(9999\)"):
        CudaDriver(cuda.functions)


def test_what_kernels_take(cuda, backend):
    assert backend.resources() == {}
    with backend.session() as session:
        place_tiles(session)
    assert backend.resources() == {"place_tiles": Resources(registers=40, private_bytes=16)}
    assert cuda.current == []


def test_launches_are_timed(cuda, backend, monkeypatch):
    class Event:
        clock = 0

        def __init__(self, enable_timing):
            assert enable_timing

        def record(self, stream):
            assert stream.cuda_stream == STREAM
            Event.clock += 1
            self.time = Event.clock

        def synchronize(self):
            assert self.time == 2

        def elapsed_time(self, other):
            return (other.time - self.time) * 0.25

    def sleep(cycles):
        assert cycles > 0
        assert Event.clock == 0  # nothing is recorded yet: both events and the launch are queued behind this
        cuda.calls.append("torch.cuda._sleep")

    monkeypatch.setattr(torch.cuda, "Event", Event)
    monkeypatch.setattr(torch.cuda, "_sleep", sleep)
    backend.profiled = []
    with backend.session() as session:
        place_tiles(session)
    ((kernel, event),) = backend.profiled
    assert kernel == "place_tiles"
    assert cuda.calls.index("torch.cuda._sleep") < cuda.calls.index("cuLaunchKernel")
    assert event.profile.end - event.profile.start == 250_000

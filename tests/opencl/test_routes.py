"""Which backend draws the tensors of which device, on fake machines."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from torch.nn.functional import conv2d

import opencl.device
from opencl import routes
from opencl.__main__ import main
from opencl.backend import default_backend
from opencl.convolution import can_convolve, convolve
from opencl.cuda_driver import CudaDriver
from opencl.device import DEVICE_VARIABLE, Device, list_devices
from opencl.nvidia import MISSING_ICD, opencl_device_of, pci_location, torch_device_of
from opencl.pixel_decoder import decode_pixels
from tests.opencl import test_convolution, test_pixel_decoder
from tests.opencl.fake_cuda import FakeCuda
from tests.opencl.pretended_devices import gpu

CUDA = torch.device("cuda", 0)


@pytest.fixture(autouse=True)
def no_answers_from_before():
    """Clears the caches of answers before and after each test."""
    kept = (routes._backend_for, routes._backend_in_place, routes._device_in_place)
    for answers in kept:
        answers.cache_clear()
    yield
    for answers in kept:
        answers.cache_clear()


@pytest.fixture
def driver() -> CudaDriver:
    """The fake driver of a machine with one GPU, at 0:65:0."""
    return CudaDriver(FakeCuda(default_backend().context).functions)


@pytest.fixture
def machine(monkeypatch, driver):
    """Sets which devices OpenCL sees, torch's build and GS_HIDER_DEVICE. Fake backends only say what they are."""
    monkeypatch.setattr(routes, "CudaBackend", lambda device, driver, where: ("zero-copy", device, where))
    monkeypatch.setattr(routes, "Backend", lambda device: ("copies", device))
    monkeypatch.setattr(routes, "default_backend", lambda: "default")
    monkeypatch.setattr(torch.cuda, "init", lambda: None)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)

    def become(*devices, torch_of="cuda", asked=""):
        monkeypatch.setattr(routes, "list_devices", lambda: list(devices))
        monkeypatch.setattr(torch.version, "cuda", "13.0" if torch_of == "cuda" else None)
        monkeypatch.setattr(torch.version, "hip", "7.0" if torch_of == "hip" else None)
        monkeypatch.setattr(torch.cuda, "is_available", lambda: torch_of in ("cuda", "hip"))
        monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
        monkeypatch.setattr(routes, "load_driver", lambda: driver if torch_of == "cuda" else None)
        monkeypatch.setenv(DEVICE_VARIABLE, asked)

    cudnn, filled = torch.backends.cudnn, torch.utils.deterministic.fill_uninitialized_memory
    flags = cudnn.allow_tf32, cudnn.deterministic, cudnn.benchmark
    precision = torch.get_float32_matmul_precision()
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    yield become
    cudnn.allow_tf32, cudnn.deterministic, cudnn.benchmark = flags
    torch.set_float32_matmul_precision(precision)
    torch.use_deterministic_algorithms(False)
    torch.utils.deterministic.fill_uninitialized_memory = filled


def test_tensors_of_the_cpu_go_where_the_variable_says(machine):
    machine(gpu())
    assert routes.backend_for(torch.device("cpu")) == "default"


@pytest.mark.parametrize("devices", [[], [gpu()]], ids=["none", "a GPU"])
def test_nothing_is_in_place_where_no_cpu_draws_and_no_device_is_set_up_to_say_so(monkeypatch, devices):
    see(monkeypatch, devices)
    monkeypatch.setenv(DEVICE_VARIABLE, "nvidia")
    monkeypatch.delattr(routes, "default_backend")
    assert not routes.works_in_place(torch.device("cpu"))
    with pytest.raises(ValueError, match="no OpenCL device works in the CPU's memory"):
        routes.backend_in_place()


def test_tensors_of_the_cpu_are_in_place_on_pocl():
    assert routes.works_in_place(torch.device("cpu"))
    assert not routes.works_in_place(CUDA)


def test_tensors_of_the_cpu_are_convolved_and_decoded_on_pocl_where_a_gpu_is_asked_for(monkeypatch):
    """torch's own convolutions take twice as long."""
    pocl = default_backend().device
    see(monkeypatch, [pocl, gpu()])
    monkeypatch.setenv(DEVICE_VARIABLE, "nvidia")
    monkeypatch.setattr(routes, "default_backend", lambda: pytest.fail("the GPU's"))
    values, weight, bias = test_convolution.inputs(1, 16, 16, 4, 4)
    assert can_convolve(values, weight)
    torch.testing.assert_close(convolve(values, weight, bias), conv2d(values, weight, bias, padding=1))
    assert decode_pixels(*test_pixel_decoder.decoder(4, 16, 3)).shape == (4, 3)
    assert routes.backend_in_place().device == pocl


def test_pocl_that_cannot_build_is_no_matter_where_a_gpu_is_asked_for(monkeypatch):
    def prepare(device):
        raise ValueError("this PoCL does not know the processor")

    see(monkeypatch, [default_backend().device, gpu()])
    monkeypatch.setattr(Device, "prepare", prepare)
    monkeypatch.setenv(DEVICE_VARIABLE, "nvidia")
    assert not routes.works_in_place(torch.device("cpu"))


def see(monkeypatch, devices):
    """Let OpenCL see these devices."""
    for module in (routes, opencl.device):
        monkeypatch.setattr(module, "list_devices", lambda: devices)


def test_cuda_tensors_are_drawn_in_place(machine):
    other, own = gpu(index="1:0", location=(0, 66, 0)), gpu(index="1:1")
    machine(other, own)
    assert routes.backend_for(CUDA) == ("zero-copy", own, CUDA)


def test_a_device_named_by_its_own_name_is_drawn_in_place(machine):
    own = gpu()
    machine(own, asked="nvidia")
    assert routes.backend_for(CUDA) == ("zero-copy", own, CUDA)


def test_another_device_is_used_where_it_is_asked_for(machine):
    machine(gpu(), asked="portable computing")
    assert routes.backend_for(CUDA) == "default"


@pytest.mark.parametrize("location", [(0, 66, 0), (0x10000, 65, 0)], ids=["a virtual GPU", "an odd domain"])
def test_the_only_gpu_is_the_only_one_wherever_it_says_it_is(machine, location):
    """Otherwise everything would be copied, for nothing."""
    own = gpu(location=location)
    machine(own)
    assert routes.backend_for(CUDA) == ("zero-copy", own, CUDA)
    assert "works in torch's memory on cuda:0 (PTX)" in routes.describe_route(own)


def test_cuda_tensors_with_another_nvidia_gpu_are_copied(machine):
    other = gpu(location=(0, 66, 0))
    machine(other, gpu(index="1:1", location=(0, 67, 0)))
    with pytest.warns(UserWarning, match=r"cuda:0: drawn on .*GPU of NVIDIA Corporation \(1:0\), with copies"):
        assert routes.backend_for(CUDA) == ("copies", other)


def test_a_missing_icd_file_is_explained(machine):
    machine(gpu("Intel", "Intel OpenCL"))
    with pytest.warns(UserWarning, match=r"(?s)cuda:0: drawn elsewhere, with copies.*libnvidia-opencl\.so\.1"):
        assert routes.backend_for(CUDA) == "default"


def test_amd_s_tensors_are_copied_to_amd_s_gpu(machine):
    amd = gpu("Advanced Micro Devices, Inc.", "AMD Accelerated Parallel Processing")
    machine(gpu("Intel", "Intel OpenCL"), amd, torch_of="hip")
    assert routes.backend_for(CUDA) == ("copies", amd)


def test_intel_s_tensors(machine):
    intel = gpu("Intel(R) Corporation", "Intel(R) OpenCL Graphics")
    machine(gpu(), intel, torch_of="xpu")
    assert routes.backend_for(torch.device("xpu", 0)) == ("copies", intel)
    with pytest.warns(UserWarning, match="mps:0: drawn elsewhere, with copies"):
        assert routes.backend_for(torch.device("mps", 0)) == "default"


def test_a_missing_driver_of_amd_s_is_explained(machine):
    machine(torch_of="hip")
    with pytest.warns(UserWarning, match=r"cuda:0: drawn elsewhere, with copies\. .*rocm-opencl-runtime"):
        assert routes.backend_for(CUDA) == "default"


def test_stages_work_on_the_cpu_where_torch_has_no_cuda(machine):
    machine(gpu(), torch_of="xpu")
    assert routes.working_device() == torch.device("cpu")


@pytest.mark.parametrize(("asked", "where"), [("", "cuda"), ("nvidia", "cuda"), ("1:0", "cuda"), ("portable", "cpu")])
def test_stages_work_on_the_gpu_unless_another_device_is_asked_for(machine, asked, where):
    machine(gpu(), asked=asked)
    assert routes.working_device().type == where
    assert (routes.backend_for(CUDA) == "default") == (where == "cpu")


@pytest.mark.parametrize(("asked", "where"), [("", "cuda"), ("portable", "cpu")])
def test_stages_work_on_a_gpu_that_opencl_does_not_see(machine, asked, where):
    machine(asked=asked)
    assert routes.working_device().type == where


def test_stages_work_on_the_gpu_that_torch_works_on(machine, monkeypatch):
    machine(gpu())
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    assert routes.working_device() == torch.device("cuda", 1)


def test_whoever_works_on_a_gpu_gets_float32_and_the_same_bits(machine):
    machine(gpu())
    torch.set_float32_matmul_precision("high")  # as TORCH_ALLOW_TF32_CUBLAS_OVERRIDE=1 does
    routes.working_device()
    assert not torch.backends.cudnn.allow_tf32
    assert torch.get_float32_matmul_precision() == "highest"
    assert torch.backends.cudnn.deterministic
    assert torch.are_deterministic_algorithms_enabled()


def test_stages_work_on_amd_s_gpu(machine):
    machine(gpu("Advanced Micro Devices, Inc.", "AMD Accelerated Parallel Processing"), torch_of="hip")
    assert routes.working_device().type == "cuda"


def test_what_draws_is_told_with_where_its_tensors_come_from(monkeypatch):
    described = default_backend().device.describe()
    assert routes.describe_drawing(torch.device("cpu")) == described
    monkeypatch.setattr(routes, "backend_for", lambda tensor_device: default_backend())
    assert routes.describe_drawing(CUDA) == f"{described}, tensors copied from cuda:0"
    in_place = SimpleNamespace(device=default_backend().device, tensor_device=CUDA)
    monkeypatch.setattr(routes, "backend_for", lambda tensor_device: in_place)
    assert routes.describe_drawing(CUDA) == described


def test_a_gpu_is_found_by_its_place_on_the_bus(driver, machine):
    own, other, third = gpu(), gpu(location=(1, 65, 0)), gpu(location=(2, 65, 0))
    devices = [*list_devices(), other, own]
    machine(*devices)
    assert opencl_device_of(CUDA, devices, driver) == own
    assert opencl_device_of(CUDA, [other, third], driver) is None
    assert torch_device_of(own, devices, driver) == CUDA
    assert torch_device_of(other, devices, driver) is None
    assert torch_device_of(devices[0], devices, driver) is None
    machine(own, torch_of="hip")
    assert torch_device_of(own, devices, driver) is None


def test_an_old_driver_tells_no_domain():
    assert pci_location(gpu(knows_domain=False)) == (0, 65, 0)
    assert pci_location(gpu(location=(3, 0xE4, 31))) == (3, 0xE4, 31)


def test_a_device_that_has_no_place_on_the_bus():
    assert pci_location(list_devices()[0]) is None


def test_the_listing_says_how_memory_is_reached(machine):
    machine(gpu())
    assert routes.describe_route(list_devices()[0]) == "cpu schedule, works in torch's memory"
    assert "works in torch's memory on cuda:0 (PTX)" in routes.describe_route(gpu())
    assert routes.describe_route(gpu("Intel", "Intel OpenCL")) == "gpu schedule, copies through pinned memory"
    machine(torch_of="")
    assert "with a torch that is built for CUDA" in routes.describe_route(gpu())


def test_what_is_missing_is_told(machine):
    machine()
    assert routes.missing_pieces([gpu()]) == ["No OpenCL for the CPU: pip install 'pyopencl[pocl]'"]
    assert routes.missing_pieces(list_devices()) == [MISSING_ICD]
    machine(torch_of="hip")
    assert "ROCm" in routes.missing_pieces(list_devices())[0]
    machine(torch_of="")
    assert routes.missing_pieces(list_devices()) == []


def test_the_command_lists_routes(capsys):
    assert main(["devices"]) == 0
    assert "works in torch's memory" in capsys.readouterr().out

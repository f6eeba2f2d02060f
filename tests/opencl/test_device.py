"""Choosing a device, and a directory of compiled kernels for each process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pyopencl
import pytest
import torch

from opencl import kernel_cache, pocl_processor
from opencl.__main__ import main
from opencl.backend import default_backend
from opencl.device import DEVICE_VARIABLE, choose_device, list_devices
from opencl.kernel_cache import reserve_kernel_cache
from opencl.pocl_processor import closest_known_processor, misnamed_processor
from tests.opencl.scenes import make_scene


def test_a_device_is_found_by_index_and_by_part_of_its_name(monkeypatch):
    device = list_devices()[0]
    assert choose_device(device.index) == device
    assert choose_device("portable computing").is_cpu
    monkeypatch.setenv(DEVICE_VARIABLE, device.index)
    assert choose_device() == device


@pytest.mark.parametrize("name", ["no such device", "99:0"])
def test_an_unknown_device_lists_what_exists(name, monkeypatch):
    with pytest.raises(ValueError, match="device: found") as caught:
        choose_device(name)
    assert list_devices()[0].name in str(caught.value)
    monkeypatch.setenv(DEVICE_VARIABLE, name)
    with pytest.raises(ValueError, match=f"{DEVICE_VARIABLE}: found '{name}'"):
        make_scene().draw()


def test_the_description_names_platform_and_device():
    device = choose_device()
    assert device.handle.name.strip() in device.describe()
    assert device.handle.platform.version.strip() in device.describe()


def test_the_description_does_not_change_with_free_memory():
    """Checkpoints contain it, and report if another device continues from them."""
    described = "from opencl.device import choose_device; print(choose_device().describe())"
    environment = os.environ | {"POCL_MEMORY_LIMIT": "1"}  # GiB
    elsewhere = subprocess.run(
        [sys.executable, "-c", described], env=environment, capture_output=True, text=True, check=True
    )
    assert elsewhere.stdout.strip() == choose_device().describe()


def test_commands(capsys, monkeypatch):
    monkeypatch.setenv(DEVICE_VARIABLE, "")
    assert main(["devices"]) == 0
    assert f"* {choose_device().index}" in capsys.readouterr().out
    assert main(["bench", "--device", "no such device"]) == 2
    assert "expected an index or part of a name" in capsys.readouterr().err


def test_processes_do_not_share_compiled_kernels(tmp_path):
    first, second = {"XDG_CACHE_HOME": str(tmp_path)}, {"XDG_CACHE_HOME": str(tmp_path)}
    lock = reserve_kernel_cache(first)
    other_lock = reserve_kernel_cache(second)
    assert first["POCL_CACHE_DIR"] != second["POCL_CACHE_DIR"]
    assert lock is not None
    assert other_lock is not None
    lock.release()
    third = {"XDG_CACHE_HOME": str(tmp_path)}
    assert reserve_kernel_cache(third) is not None
    assert third["POCL_CACHE_DIR"] == first["POCL_CACHE_DIR"]


def test_a_child_does_not_take_its_parent_s_directory_for_the_user_s(tmp_path):
    inherited = {"XDG_CACHE_HOME": str(tmp_path)}
    lock = reserve_kernel_cache(inherited)
    assert lock is not None
    parents = inherited["POCL_CACHE_DIR"]
    assert reserve_kernel_cache(inherited) is None, "the parent asks again"
    inherited["GS_HIDER_KERNELS_OF"] = f"{os.getpid() + 1}:{parents}"  # as a child process finds it
    assert reserve_kernel_cache(inherited) is not None
    assert inherited["POCL_CACHE_DIR"] != parents


def test_a_directory_of_the_user_s_is_respected():
    environment = {"POCL_CACHE_DIR": "/somewhere"}
    assert reserve_kernel_cache(environment) is None
    assert environment == {"POCL_CACHE_DIR": "/somewhere"}


def test_no_directory_is_left_where_none_is_needed(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(kernel_cache.tempfile, "mkdtemp", lambda prefix: made.append(prefix) or str(tmp_path / prefix))
    assert reserve_kernel_cache({"XDG_CACHE_HOME": str(tmp_path)}) is not None
    assert not made


DRAW = """
import pwd, sys
def nobody(number):
    raise KeyError(number)
if sys.argv[1] == "nobody":
    pwd.getpwuid = nobody
from tests.opencl.scenes import make_scene
print(float(make_scene(count=3).draw().alphas.max()) > 0)
"""


@pytest.mark.parametrize("home", ["/proc", "nobody"])
def test_where_no_home_can_be_written_all_is_drawn_nevertheless(tmp_path, home):
    """pyopencl also keeps generated code in the home directory; a user without an entry in `pwd` has none."""
    environment = {name: value for name, value in os.environ.items() if name in ("PATH", "PYTHONPATH")}
    environment |= {"TMPDIR": str(tmp_path)} | ({} if home == "nobody" else {"HOME": home})
    command = [sys.executable, "-c", DRAW, home]
    drawn = subprocess.run(command, cwd=Path(__file__).parents[2], env=environment, capture_output=True, text=True)
    assert drawn.stdout == "True\n", drawn.stderr
    assert not list(tmp_path.glob("gs-hider-kernels-*")), "nobody would find it again"


def test_an_unwritable_home_is_no_obstacle(tmp_path):
    obstacle = tmp_path / "file"
    obstacle.write_text("")
    environment = {"XDG_CACHE_HOME": str(obstacle)}
    assert reserve_kernel_cache(environment) is not None
    assert "gs-hider-kernels" in environment["POCL_CACHE_DIR"]


def test_the_closest_processor_has_only_instructions_that_exist():
    haswell = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm", "popcnt", "rdrand", "fsgsbase"}
    wide = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "adx", "aes", "clwb", "pclmulqdq"}
    assert closest_known_processor(set()) == "x86-64"
    assert closest_known_processor(haswell - {"fma"}) == "x86-64"
    assert closest_known_processor(haswell | {"avx512f"}) == "haswell"
    assert closest_known_processor(haswell | wide) == "skx"
    assert all(len(name) <= len("generic") for name in ("x86-64", "haswell", "skx"))


def test_a_processor_that_cannot_be_named_is_explained(monkeypatch):
    device = choose_device()
    monkeypatch.setattr("opencl.device.misnamed_processor", lambda handle: "generic")
    monkeypatch.setattr("opencl.device.name_processor", lambda handle, misnamed: None)
    with pytest.raises(ValueError, match="does not know the processor"):
        device.prepare()


def test_other_systems_memory_is_left_alone(monkeypatch):
    monkeypatch.setattr(pocl_processor.platform, "system", lambda: "Darwin")
    assert pocl_processor.name_processor.__wrapped__(choose_device().handle, "generic") is None


@pytest.mark.parametrize(
    ("says", "has_avx_512", "misnamed"),
    [
        ("generic", False, "generic"),
        ("generic", True, "generic"),
        ("znver3", True, "znver3"),
        ("znver3", False, None),
        ("skylake-avx512", True, None),
    ],
)
def test_a_processor_is_named_where_pocl_does_not_know_it_or_its_avx_512(monkeypatch, says, has_avx_512, misnamed):
    flags = pocl_processor._AVX_512 if has_avx_512 else set()
    monkeypatch.setattr(pocl_processor, "_processor_flags", lambda: flags)
    platform = SimpleNamespace(name="Portable Computing Language")
    version = f"OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-{says} "
    assert misnamed_processor(SimpleNamespace(platform=platform, version=version)) == misnamed


def test_built_in_functions_on_whole_registers_can_be_built():
    """PoCL 3.0 crashed on Zen 4 when it built the square root of a double8."""
    backend = default_backend()
    text = "kernel void root(global double8 *x) { x[0] = sqrt(x[0]); }"
    program = pyopencl.Program(backend.context, text).build(cache_dir=False)
    numbers = torch.arange(8.0, dtype=torch.float64)
    buffer = pyopencl.Buffer(
        backend.context,
        pyopencl.mem_flags.READ_WRITE | pyopencl.mem_flags.COPY_HOST_PTR,
        hostbuf=numbers.numpy(),
    )
    pyopencl.Kernel(program, "root")(backend.queue, (1,), None, buffer)
    found = torch.empty_like(numbers)
    pyopencl.enqueue_copy(backend.queue, found.numpy(), buffer)
    torch.testing.assert_close(found, numbers.sqrt())


def test_threads_take_turns():
    expected = make_scene(count=50, dtype=torch.float32).draw().features
    pictures = []

    def draw():
        pictures.extend(make_scene(count=50, dtype=torch.float32).draw().features for _ in range(5))

    threads = [threading.Thread(target=draw) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(pictures) == 20
    assert all(torch.equal(picture, expected) for picture in pictures)


def test_threads_that_come_first_at_the_same_time_share_one_backend():
    """In a process of its own: what is done once has been done in this one."""
    code = """
import threading
from opencl.backend import default_backend
meeting, found = threading.Barrier(4), []
def first():
    meeting.wait()
    found.append(default_backend())
threads = [threading.Thread(target=first) for _ in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(len(found), len(set(map(id, found))))
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert ran.stdout == "4 1\n", ran.stderr


def test_a_forked_process_is_told_so():
    code = """
import os
from tests.opencl.scenes import make_scene
scene = make_scene()  # before the fork: torch's own threads would hang the child, too
scene.draw()
if os.fork() == 0:
    try:
        scene.draw()
    except RuntimeError as error:
        os._exit(0 if "spawn" in str(error) else 1)
    os._exit(2)
assert os.waitstatus_to_exitcode(os.wait()[1]) == 0
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)

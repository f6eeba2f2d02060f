"""Wrong arguments, systematically: each gives an error that names it, or the right picture, and nothing else."""

from __future__ import annotations

from dataclasses import fields

import pyopencl
import pytest
import torch

from opencl.memory import TorchMemory
from opencl.rasterizer import rasterize
from tests.opencl.scenes import gradients, make_scene

COUNT, FEATURE_DIM = 5, 3
GAUSSIANS = ("means", "quats", "scales", "opacities", "features", "background")
TENSORS = (*GAUSSIANS, "world_to_camera", "intrinsics")
SHAPES = [(), (0,), (1,), (COUNT,), (4,), (COUNT, 1), (COUNT, 3), (COUNT, 4), (4, 3), (COUNT + 1, 3), (3, 3), (4, 4)]
SHAPES += [(3, COUNT), (4, COUNT), (1, COUNT, 3), (1, 4, 4), (1, 3, 3), (COUNT, 0), (3, 4), (0, 3)]


def arguments(**changes):
    scene = make_scene(COUNT, FEATURE_DIM, 20, 18, dtype=torch.float32, size=0.5)
    return {field.name: getattr(scene, field.name) for field in fields(scene)} | changes


def fits(name, shape):
    return shape == tuple(arguments()[name].shape)


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize("name", TENSORS)
def test_every_wrong_shape_is_named(name):
    for shape in SHAPES:
        if fits(name, shape):
            continue
        with pytest.raises(ValueError, match="found shape") as caught:
            rasterize(**arguments(**{name: torch.zeros(shape)}))
        assert "expected" in str(caught.value)


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize("name", TENSORS)
@pytest.mark.parametrize(
    "dtype", [torch.float64, torch.float16, torch.bfloat16, torch.int32, torch.int64, torch.bool, torch.complex64]
)
def test_every_wrong_type_is_named(name, dtype):
    changed = arguments()[name].to(dtype)
    with pytest.raises(ValueError, match=r"found torch\.\w+, expected torch\."):
        rasterize(**arguments(**{name: changed}))


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.int32])
def test_no_other_type_even_for_all(dtype):
    changed = {name: value.to(dtype) for name, value in arguments().items() if isinstance(value, torch.Tensor)}
    with pytest.raises(ValueError, match=f"means: found {dtype}, expected torch.float32 or torch.float64"):
        rasterize(**arguments(**changed))


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize("name", TENSORS)
@pytest.mark.parametrize("value", [None, 1.0, [1.0], "cpu"])
def test_every_argument_that_is_no_tensor_is_named(name, value):
    if name == "background" and value is None:
        return
    with pytest.raises(ValueError, match=rf"{name}: found \w+, expected a torch.Tensor"):
        rasterize(**arguments(**{name: value}))


@pytest.mark.parametrize("name", TENSORS)
def test_tensors_without_values_are_named(name):
    with pytest.raises(ValueError, match=r"found on (meta|cpu)"):
        rasterize(**arguments(**{name: arguments()[name].to("meta")}))


def test_tensors_without_values_are_named_even_if_all_are():
    changed = {name: value.to("meta") for name, value in arguments().items() if isinstance(value, torch.Tensor)}
    with pytest.raises(ValueError, match="means: found on meta"):
        rasterize(**arguments(**changed))


@pytest.mark.parametrize("name", TENSORS)
def test_sparse_tensors_are_named(name):
    with pytest.raises(ValueError, match=f"{name}: found torch.sparse_coo, expected a dense tensor"):
        rasterize(**arguments(**{name: arguments()[name].to_sparse()}))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["background", "world_to_camera", "intrinsics"])
def test_what_all_gaussians_share_must_be_finite(name, value):
    for place in range(arguments()[name].numel()):
        changed = arguments()[name].clone()
        changed.view(-1)[place] = value
        with pytest.raises(ValueError, match=f"{name}: found a value that is not finite"):
            rasterize(**arguments(**{name: changed}))


def test_a_long_background_s_error_is_short():
    scene = arguments(features=torch.zeros(COUNT, 1000), background=torch.full((1000,), torch.nan))
    with pytest.raises(ValueError, match="and 984 more") as caught:
        rasterize(**scene)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("name", ["world_to_camera", "intrinsics"])
def test_a_camera_has_no_gradient(name):
    with pytest.raises(ValueError, match=f"{name}: found requires_grad"):
        rasterize(**arguments(**{name: arguments()[name].clone().requires_grad_()}))


def test_a_transposed_camera_is_suspected():
    with pytest.raises(ValueError, match="is it transposed"):
        rasterize(**arguments(world_to_camera=arguments()["world_to_camera"].T))


def test_an_inverted_camera_is_none():
    world_to_camera = arguments()["world_to_camera"].double()
    inverted = torch.linalg.inv(torch.linalg.inv(world_to_camera)).float()
    assert rasterize(**arguments(world_to_camera=inverted)).alphas.max() > 0.1


@pytest.mark.parametrize("side", ["width", "height"])
@pytest.mark.parametrize("value", [0, -1, 2**20 + 1, 2**70, 16.0, True, None, "16", torch.tensor(16)])
def test_every_wrong_side_is_named(side, value):
    with pytest.raises(ValueError, match=f"{side}: found .*, expected an integer from 1 to 1048576"):
        rasterize(**arguments(**{side: value}))


def test_a_picture_of_too_many_pixels_is_named():
    with pytest.raises(ValueError, match="found 1048576 x 2048 pixels, expected at most 2147483647 in all"):
        rasterize(**arguments(width=2**20, height=2**11))


@pytest.mark.parametrize(("width", "height"), [(2**20, 1), (1, 2**20)])
def test_the_longest_side_is_drawn(width, height):
    gaussians = arguments(features=torch.ones(COUNT, 1), background=torch.zeros(1))
    output = rasterize(**(gaussians | {"width": width, "height": height}))
    assert output.features.shape == (height, width, 1)
    assert output.features.isfinite().all()


LAYOUTS = {
    "every other row": lambda tensor: tensor.repeat_interleave(2, dim=0)[::2],
    "transposed": lambda tensor: tensor.T.contiguous().T,
    "an offset": lambda tensor: torch.cat([tensor[:1], tensor])[1:],
    "a column of more": lambda tensor: torch.stack([tensor, tensor], dim=-1)[..., 1],
    "a parameter": lambda tensor: torch.nn.Parameter(tensor.clone(), requires_grad=False),
    "at an odd address": lambda tensor: torch.cat([tensor.new_zeros(1), tensor.flatten()])[1:].view(tensor.shape),
}


def drawn(changes):
    """Outputs and gradients, to be compared bit by bit."""
    given = arguments(**changes)
    leaves = {name: given[name].detach().requires_grad_() for name in GAUSSIANS}
    output = rasterize(**(given | leaves))
    return output.features, output.alphas, output.radii, *gradients(output, tuple(leaves.values()))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_layout_in_memory_does_not_matter(layout):
    changes = {name: LAYOUTS[layout](arguments()[name]) for name in TENSORS if arguments()[name].ndim > 1}
    for one, other in zip(drawn(changes), drawn({}), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("name", GAUSSIANS)
def test_expanded_tensors_are_as_good_as_copies(name):
    original = arguments()[name]
    expanded = original[:1].expand(original.shape)
    assert expanded.stride(0) == 0
    for one, other in zip(drawn({name: expanded}), drawn({name: expanded.contiguous()}), strict=True):
        assert torch.equal(one, other)


def test_inputs_are_not_written_to():
    given = arguments()
    before = {name: given[name].clone() for name in TENSORS}
    rasterize(**given)
    assert all(torch.equal(given[name], before[name]) for name in TENSORS)


def test_lazily_negated_tensors_are_drawn():
    means = arguments()["means"]
    assert torch.equal(drawn({"means": torch._neg_view(-means)})[0], drawn({})[0])


def test_inference_mode_draws_the_same():
    expected = rasterize(**arguments()).features
    with torch.inference_mode():
        assert torch.equal(rasterize(**arguments()).features, expected)


@pytest.mark.parametrize("make", ["empty", "zeros"])
def test_no_room_in_torch_s_memory_is_named(monkeypatch, make):
    def full(*_, **__):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 12.00 GiB.")

    monkeypatch.setattr(torch, "empty", full)
    memory = TorchMemory(torch.device("cuda", 1))
    with pytest.raises(RuntimeError, match=r"cuda:1: CUDA out of memory.* 12\.00 GiB\. Take a smaller picture"):
        getattr(memory, make)(3, dtype=torch.float32)


def test_no_room_on_the_device_is_named(monkeypatch):
    def full(*_, **__):
        raise pyopencl.MemoryError("clCreateBuffer", -4, "MEM_OBJECT_ALLOCATION_FAILURE")

    monkeypatch.setattr(pyopencl, "Buffer", full)
    with pytest.raises(RuntimeError, match=r"no room for 0\.00 GiB in one piece.*at most .*Take a smaller picture"):
        rasterize(**arguments())


@pytest.mark.parametrize("size", [(1, 1), (20, 18)])
def test_gradients_that_torch_negates_lazily(size):
    scene = make_scene(COUNT, 1, *size, dtype=torch.float32, size=0.5)
    leaves = [tensor.requires_grad_() for tensor in scene.gaussians]
    output = scene.draw()
    outputs = [output.features, output.alphas, output.means2d]
    upstream = [torch.rand_like(each) for each in outputs]
    lazily = [torch._neg_view(each) for each in upstream]
    found = torch.autograd.grad(outputs, leaves, lazily, retain_graph=True)
    for one, other in zip(found, torch.autograd.grad(outputs, leaves, [-each for each in upstream]), strict=True):
        assert torch.equal(one, other)


def test_tensors_of_the_cpu_are_drawn_whatever_device_new_ones_are_made_on():
    scene = make_scene(COUNT, FEATURE_DIM, 20, 18, dtype=torch.float32)
    leaves = [tensor.requires_grad_() for tensor in scene.gaussians]
    expected = gradients(scene.draw(), leaves)
    with torch.device("meta"):
        output = scene.draw()
    for one, other in zip(gradients(output, leaves), expected, strict=True):
        assert torch.equal(one, other)

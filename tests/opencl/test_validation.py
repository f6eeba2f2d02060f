"""Each misuse has one error that names the argument, what was found and what is expected."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from opencl.contract import RasterSettings
from opencl.program import ProgramKey
from opencl.rasterizer import rasterize
from opencl.routes import backend_for
from opencl.validation import check_arguments
from tests.opencl.scenes import make_scene


def _arguments(**changes):
    scene = make_scene(count=5, dtype=torch.float32)
    return {**vars(scene), **changes}


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"means": torch.zeros(5, 2)}, r"means: found shape \(5, 2\), expected \(5, 3\)"),
        ({"means": torch.tensor(1.0)}, r"found shape"),
        ({"quats": torch.zeros(4, 4)}, r"quats: found shape \(4, 4\), expected \(5, 4\)"),
        ({"scales": torch.zeros(5)}, r"scales: found shape \(5,\), expected \(5, 3\)"),
        ({"opacities": torch.zeros(5, 1)}, r"opacities: found shape \(5, 1\), expected \(5,\)"),
        ({"features": torch.zeros(5, 0)}, r"features: found shape \(5, 0\), expected \(5, M\)"),
        ({"features": torch.zeros(5)}, r"features: found shape \(5,\)"),
        ({"features": torch.zeros(6, 3)}, r"features: found shape \(6, 3\), expected \(5, 3\)"),
        ({"background": torch.zeros(4)}, r"background: found shape \(4,\), expected \(3,\)"),
        ({"world_to_camera": torch.eye(3)}, r"world_to_camera: found shape \(3, 3\), expected \(4, 4\)"),
        ({"intrinsics": torch.eye(4)}, r"intrinsics: found shape \(4, 4\), expected \(3, 3\)"),
        ({"means": torch.zeros(5, 3, dtype=torch.float16)}, r"means: found torch.float16, expected torch.float32"),
        ({"scales": torch.zeros(5, 3, dtype=torch.float64)}, r"scales: found torch.float64, expected torch.float32"),
        ({"intrinsics": torch.eye(3, dtype=torch.float64)}, r"intrinsics: found torch.float64"),
        ({"features": torch.zeros(5, 3, device="meta")}, r"features: found on meta, expected on cpu"),
        ({"quats": [[1, 0, 0, 0]]}, r"quats: found list, expected a torch.Tensor"),
        ({"world_to_camera": torch.full((4, 4), torch.nan)}, r"world_to_camera: found a value that is not finite"),
        ({"intrinsics": torch.full((3, 3), torch.inf)}, r"intrinsics: found a value that is not finite"),
        ({"intrinsics": torch.diag(torch.tensor([-1.0, 1, 1]))}, r"intrinsics: found focal lengths -1.0 and 1.0"),
        ({"intrinsics": torch.ones(3, 3)}, r"intrinsics: found .*, expected a pinhole"),
        ({"world_to_camera": torch.eye(4).requires_grad_()}, r"world_to_camera: found requires_grad"),
        ({"width": 0}, r"width: found 0, expected an integer from 1"),
        ({"height": -3}, r"height: found -3"),
        ({"width": 3.0}, r"width: found 3.0"),
        ({"height": True}, r"height: found True"),
        ({"settings": {}}, r"settings: found dict, expected RasterSettings"),
    ],
)
def test_misuse(changes, message):
    with pytest.raises(ValueError, match=message):
        rasterize(**_arguments(**changes))


class OnGpu(torch.Tensor):
    is_cpu = property(lambda self: False)


def test_a_background_is_looked_at_on_the_cpu_alone():
    background = torch.full((3,), torch.nan)
    with pytest.raises(ValueError, match="background: found a value that is not finite"):
        check_arguments(**_arguments(background=background))
    check_arguments(**_arguments(background=background.as_subclass(OnGpu)))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"near": 0.0}, "near: found 0.0, expected more than 0"),
        ({"near": np.float32("nan")}, "near: found .*nan.*, expected a finite number"),
        ({"near": "0.2"}, "near: found '0.2', expected a finite number"),
        ({"near": None}, "near: found None, expected a finite number"),
        ({"near": 10**400}, "near: found 1000.*, expected a finite number"),
        ({"alpha_minimum": 1e-46}, "alpha_minimum: found 1e-46, expected more than 0, from 1e-30 to 1e[+]30"),
        ({"radius_sigmas": 1e-50}, "radius_sigmas: found 1e-50"),
        ({"alpha_maximum": 1 - 1e-9}, "alpha_maximum: found 0.999999999, .* less than 1 by 1e-06"),
        ({"alpha_maximum": 0.99995}, "transmittance_minimum: found 0.0001, .* alpha_maximum lets through .5e-05."),
        ({"transmittance_minimum": 0.02}, "transmittance_minimum: found 0.02, .* end its pixel before it is drawn"),
        ({"low_pass": 1e-24}, "low_pass: found 1e-24, expected 1e-06 at least"),
        ({"low_pass": float("nan")}, "low_pass: found nan, expected a finite number"),
        ({"alpha_maximum": 1.0}, "alpha_maximum: found 1.0"),
        ({"alpha_maximum": 0.001}, "alpha_maximum: found 0.001, expected at least alpha_minimum"),
        ({"transmittance_minimum": -0.1}, "transmittance_minimum: found -0.1"),
        ({"clamp_about": "middle"}, "clamp_about: found 'middle'"),
    ],
)
def test_settings_out_of_range(values, message):
    with pytest.raises(ValueError, match=message):
        RasterSettings(**values)


@pytest.mark.parametrize(
    "settings", [{"alpha_maximum": 0.9999}, {"alpha_maximum": 1 - 1e-6, "transmittance_minimum": 0}]
)
def test_the_most_opaque_pixel_is_drawn(settings):
    """A single Gaussian at a pixel's centre."""
    camera = torch.eye(4), torch.tensor([[20.0, 0, 10.5], [0, 20.0, 9.5], [0, 0, 1]])
    gaussian = torch.tensor([[0.0, 0, 2]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.2), torch.ones(1)
    drawn = rasterize(*gaussian, torch.ones(1, 3), *camera, 20, 18, settings=RasterSettings(**settings))
    assert float(drawn.alphas[9, 10]) > 0.999


def test_without_gradients_a_camera_may_ask_for_one():
    pose = torch.eye(4).requires_grad_()
    with pytest.raises(ValueError, match="world_to_camera: found requires_grad"):
        check_arguments(**_arguments(world_to_camera=pose))
    with torch.no_grad():
        check_arguments(**_arguments(world_to_camera=pose))


def test_numbers_of_numpy_are_as_good_as_others():
    """np.float64 is a float to Python, but kernels could not be built with its text, np.float64(0.3)."""
    scene = make_scene(count=20, dtype=torch.float32)
    settings = RasterSettings(low_pass=np.float64(0.3), near=np.float64(0.2))
    assert torch.equal(replace(scene, settings=settings).draw().features, scene.draw().features)


def test_double_precision_is_refused_where_there_is_none(monkeypatch):
    backend = backend_for(torch.device("cpu"))
    monkeypatch.setattr(backend, "device", SimpleNamespace(handle=SimpleNamespace(double_fp_config=0), name="a phone"))
    program = ProgramKey("geometry", backend.schedule, torch.float64, RasterSettings())
    with pytest.raises(ValueError, match="found float64, expected float32: a phone has no double precision"):
        backend.build(program)
    backend.build(replace(program, dtype=torch.float32))


def test_tensors_need_not_be_contiguous():
    scene = make_scene(count=20, dtype=torch.float32)
    spread = {
        name: value.repeat_interleave(2, dim=0)[::2]
        for name, value in vars(scene).items()
        if name in ("means", "quats")
    }
    spread["features"] = scene.features.T.contiguous().T
    changed = {**vars(scene), **spread}
    assert torch.equal(rasterize(**changed).features, scene.draw().features)

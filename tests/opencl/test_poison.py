"""Any values, in any input, give an error or a finite picture in which the other Gaussians are unaffected.

A Gaussian that is not drawn must have no effect: the picture and the others' gradients are, to the last bit, those of
the scene without it. Blended values are at most 1e15 here: near the largest number, sums of features overflow, which
no rasterizer can prevent. Larger opacities have a test of their own.
"""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import fields, replace

import pytest
import torch
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from opencl.contract import RasterSettings
from opencl.rasterizer import rasterize
from tests.opencl.runtimes import ROOT, SCHEDULES, backend_of, bits, draw_with_gradients
from tests.opencl.scenes import DEFAULT, Scene, make_scene

COUNT = 12
SHAPED = ("means", "quats", "scales", "opacities")
BLENDED = ("features", "background")
CAMERA = ("world_to_camera", "intrinsics")
DTYPES = [torch.float32, torch.float64]


def _neighbours(value):
    """A number and the next float32 on both sides."""
    exact = torch.tensor(value, dtype=torch.float32)
    return [torch.nextafter(exact, torch.tensor(end)).item() for end in (-math.inf, math.inf)] + [exact.item()]


THRESHOLDS = [
    value
    for threshold in (0.2, 1 / 255, 0.99, 1e-4, 1.0, 0.3, 16.0, 0.5)
    for value in (*_neighbours(threshold), threshold)
]
NOT_FINITE = [math.nan, math.inf, -math.inf]
DENORMAL = [1e-45, -1e-45, 1e-40, 1.1754942e-38, 5e-324]
MODERATE = [0.0, -0.0, 1e-38, 1e-30, -1e-20, 1e-10, 1e4, -1e4, 1e8, 1e10, -1e10, 1e15, -1e15]
FURTHEST = 3.4028234e38
EXTREME = [1e19, -1e19, 1e25, 1e30, FURTHEST, -FURTHEST, 1.7e308]

ANY = st.sampled_from(THRESHOLDS + NOT_FINITE + DENORMAL + MODERATE + EXTREME) | st.floats(width=32)
BOUNDED = st.sampled_from(THRESHOLDS + NOT_FINITE + DENORMAL + MODERATE)


def changes_of(names, values):
    """One to six changes of single values: the tensor's name, the place (taken modulo its size), and the value."""
    return st.lists(st.tuples(st.sampled_from(names), st.integers(0, 10**6), values), min_size=1, max_size=6)


def poisoned(changes, dtype) -> Scene:
    scene = make_scene(COUNT, 3, 20, 18, size=0.4, dtype=dtype)
    tensors = {field.name: getattr(scene, field.name) for field in fields(scene)}
    for name, place, value in changes:
        flat = tensors[name].view(-1)
        flat[place % len(flat)] = torch.tensor(value, dtype=torch.float64)  # beyond float32's range: infinite
    return scene


def check(backend, scene):
    """Check the properties that the module's docstring states."""
    try:
        rasterize(*scene.gaussians, *scene.camera, scene.background, scene.settings)
    except ValueError:
        return
    output, found = draw_with_gradients(backend, scene)
    assert output.features.isfinite().all()
    assert ((output.alphas >= 0) & (output.alphas < 1)).all()
    assert output.means2d.isfinite().all()
    assert (output.radii >= 0).all()
    assert all(gradient.isfinite().all() for gradient in found)

    seen = output.radii > 0
    without, expected = draw_with_gradients(backend, scene.only(seen))
    assert bits(output.features) == bits(without.features)
    assert bits(output.alphas) == bits(without.alphas)
    assert bits(found[5]) == bits(expected[5])
    for one, other in zip((*found[:5], found[6]), (*expected[:5], expected[6]), strict=True):
        assert bits(one[seen]) == bits(other)
        assert (one[~seen] == 0).all()


@pytest.fixture(params=SCHEDULES)
def backend(request):
    return backend_of(request.param)


FUZZ = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("dtype", DTYPES)
@FUZZ
@given(changes=changes_of(SHAPED, ANY))
def test_where_and_how_gaussians_are(backend, dtype, changes):
    check(backend, poisoned(changes, dtype))


@pytest.mark.parametrize("dtype", DTYPES)
@FUZZ
@given(changes=changes_of(BLENDED, BOUNDED))
def test_what_is_blended(backend, dtype, changes):
    check(backend, poisoned(changes, dtype))


@pytest.mark.parametrize("dtype", DTYPES)
@FUZZ
@given(changes=changes_of(CAMERA, ANY))
def test_cameras(backend, dtype, changes):
    check(backend, poisoned(changes, dtype))


@pytest.mark.parametrize("dtype", DTYPES)
@FUZZ
@given(changes=changes_of((*SHAPED, *BLENDED, *CAMERA), BOUNDED))
def test_everything_at_once(backend, dtype, changes):
    check(backend, poisoned(changes, dtype))


@pytest.mark.parametrize(
    "raster_settings",
    [
        DEFAULT,
        RasterSettings(near=1e-6, low_pass=1e-6, alpha_minimum=1e-20, transmittance_minimum=0.0),
        RasterSettings(low_pass=1e10, alpha_minimum=0.99),
    ],
    ids=["default", "smallest", "largest"],
)
@FUZZ
@given(values=st.lists(ANY, min_size=10, max_size=10), opacity=BOUNDED)
@example(values=[0.2, 0.2, FURTHEST, *[0.2] * 6, FURTHEST], opacity=0.2)  # the chain rule may overflow
@example(values=[0.2, 0.2, 0.2, *[1e-45] * 4, 0.2, 0.2, 0.004], opacity=0.2)  # and so may the gradient itself
def test_one_gaussian_of_any_values(backend, raster_settings, values, opacity):
    scene = replace(make_scene(1, 1, 17, 9, dtype=torch.float32), settings=raster_settings)
    parts = (values[:3], values[3:7], values[7:10], [opacity])
    for tensor, part in zip(scene.gaussians[:4], parts, strict=True):
        tensor.copy_(torch.tensor(part, dtype=torch.float64).view_as(tensor))
    check(backend, scene)


@pytest.mark.parametrize("value", NOT_FINITE)
@pytest.mark.parametrize("name", [*SHAPED, "features"])
def test_half_of_the_gaussians_are_not_finite(backend, name, value):
    scene = make_scene(400, 17, 70, 40, size=0.2, dtype=torch.float32)
    getattr(scene, name)[::2] = value
    output, _ = draw_with_gradients(backend, scene)
    assert (output.radii[::2] == 0).all()
    assert (output.radii[1::2] > 0).any()
    check(backend, scene)


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize(("dtype", "opacity"), [("float32", "3e38"), ("float64", "1.7e308")])
def test_an_opacity_beyond_all_bounds_does_not_end_the_process(schedule, dtype, opacity):
    code = f"""
import torch
from tests.opencl.runtimes import backend_of, draw_with_gradients
from tests.opencl.scenes import one_gaussian
scene = one_gaussian(opacity={opacity}, dtype=torch.{dtype})
output, found = draw_with_gradients(backend_of({schedule!r}), scene)
assert output.features.isfinite().all()
assert all(gradient.isfinite().all() for gradient in found)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr

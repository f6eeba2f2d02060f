"""The lens of a resized picture shows every point where it was, scaled by the factor of each side."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from stages.scene.lens import LARGEST_SIDE, MODELS, TWO_FOCAL_LENGTHS, Lens

PROJECT = """
import json, sys
import numpy as np
import pycolmap

for line in sys.stdin:
    model, parameters, width, height = json.loads(line)
    camera = pycolmap.Camera(model=model, params=parameters, width=width, height=height, camera_id=1)
    rays = np.array([[x, y, 1.0] for x in (-0.6, -0.1, 0.5) for y in (-0.4, 0.0, 0.3)])
    print(json.dumps(np.array(camera.img_from_cam(rays)).tolist()))
"""


def projected(*lenses: Lens) -> list[np.ndarray]:
    """The pixels at which each lens shows a few rays. pycolmap is imported in a process of its own."""
    given = "".join(json.dumps([lens.model, lens.parameters, lens.width, lens.height]) + "\n" for lens in lenses)
    command = [sys.executable, "-c", PROJECT]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, input=given).stdout
    return [np.array(json.loads(line)) for line in printed.splitlines()]


def lens_of(model: str) -> Lens:
    focal_lengths, distortions = MODELS[model]
    distortion = [0.06, -0.03, 0.02, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0][:distortions]
    return Lens(model, (*[3000.0, 3010.0][:focal_lengths], 1990.0, 1500.0, *distortion), 4000, 2990)


@pytest.fixture(scope="module")
def known_here() -> list[str]:
    """The camera models that the installed pycolmap knows."""
    listed = "import pycolmap; print(' '.join(pycolmap.CameraModelId.__members__))"
    return subprocess.run([sys.executable, "-c", listed], check=True, capture_output=True, text=True).stdout.split()


def test_both_sides_have_a_factor_of_their_own(known_here: list[str]) -> None:
    """4000 x 2990 becomes 800 x 600: by 5 and by 4.983."""
    models = [model for model in MODELS if model in known_here]
    assert {"SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "OPENCV"} <= {*models}
    lenses = [lens_of(model) for model in models]
    before, after = projected(*lenses), projected(*(lens.resized(800, 600) for lens in lenses))
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(other, one * [800 / 4000, 600 / 2990], atol=1e-6)


def test_where_both_are_the_same_the_model_stays() -> None:
    for model in TWO_FOCAL_LENGTHS:
        assert lens_of(model).resized(2000, 1495).model == model


def test_sides_that_no_file_holds_are_refused() -> None:
    with pytest.raises(ValueError, match="a side of more than 1,000,000 pixels"):
        Lens("PINHOLE", (50.0, 50.0, 32.0, 24.0), 10**400, LARGEST_SIDE)

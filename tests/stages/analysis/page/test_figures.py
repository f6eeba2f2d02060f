from __future__ import annotations

import math

import pytest

from stages.analysis.page.figures import WORDING, label, write_figure, write_seconds
from stages.imaging.quantities import QUANTITIES


@pytest.mark.parametrize(
    ("quantity", "value", "written"),
    [
        ("psnr", 27.126, "27.13"),
        ("psnr", math.inf, "∞"),
        ("ssim", 0.91349, "0.913"),
        ("ssim", math.nan, "–"),
        ("container_bytes", 2_345_678, "2.35"),
        ("seconds_per_frame", 0.0412, "41.2"),
        ("gaussians", 21345.0, "21,345"),
    ],
)
def test_figures_have_the_digits_that_mean_something(quantity: str, value: float, written: str) -> None:
    assert write_figure(quantity, value) == written


def test_labels_name_the_unit_that_is_written() -> None:
    assert label("psnr") == "PSNR (dB)"
    assert label("container_bytes") == "Size (MB)"
    assert label("seconds_per_frame") == "Time per frame (ms)"
    assert label("ssim") == "SSIM"


@pytest.mark.parametrize(
    ("seconds", "written"),
    [
        (0.031, "0.03 s"),
        (12.34, "12.3 s"),
        (59.96, "1 min 0 s"),
        (60, "1 min 0 s"),
        (119.7, "2 min 0 s"),
        (3599.8, "1 h 0 min"),
        (3725, "1 h 2 min"),
    ],
)
def test_durations_as_people_say_them(seconds: float, written: str) -> None:
    assert write_seconds(seconds) == written


def test_every_quantity_has_a_name_of_its_own_and_a_definition() -> None:
    assert WORDING.keys() == QUANTITIES.keys()
    assert len({name for name, _ in WORDING.values()}) == len(WORDING)
    assert all(definition.endswith(".") for _, definition in WORDING.values())

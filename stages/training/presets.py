"""What a training takes where a workflow says nothing: what the paper, or our own method, was tuned with."""

from __future__ import annotations

from collections.abc import Mapping

Presets = Mapping[str, Mapping[str, float]]
"""By the method's name, values of parameters by theirs. A method that is not in it takes the parameters' defaults."""

HIDING: Presets = {
    "homogeneous": {
        "decoder_width": 32,
        "kernel_size": 1,
        "averaging": 0.995,
        "opacity_weight": 2.0,
        "scale_weight": 2.0,
    }
}
"""Of every hiding. How our values were found: workflows/figures/tried.md."""

HIDING_SCENES: Presets = {"homogeneous": {"lambda_message": 0.1, "message_points": 4000}}
"""Of hiding scenes, beside."""


def with_preset(stated: Mapping[str, object], presets: Presets, method: object) -> dict[str, object]:
    """`stated`, and the method's values of what it does not state; one that is null is not stated."""
    given = {name: value for name, value in stated.items() if value is not None}
    return {**presets.get(str(method), {}), **given}

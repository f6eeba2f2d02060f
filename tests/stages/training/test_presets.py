"""A method's presets apply to settings that are not stated, and only to those."""

from __future__ import annotations

import json

import pytest
from pydantic import ValidationError

from pipeline.code.declaration import validate
from stages.hide_image import HideImageParameters
from stages.hide_scenes import HideScenesParameters, hide_scenes


def test_the_paper_s_method_takes_the_paper_s_values() -> None:
    parameters = HideScenesParameters(method="gs_hider")
    assert (parameters.lambda_message, parameters.decoder_width, parameters.kernel_size) == (0.5, 64, 3)
    assert (parameters.message_points, parameters.averaging) == (0, 0.0)
    assert (parameters.opacity_weight, parameters.scale_weight) == (0.0, 0.0)


def test_our_method_brings_its_own() -> None:
    parameters = HideScenesParameters(method="homogeneous")
    assert (parameters.lambda_message, parameters.decoder_width, parameters.kernel_size) == (0.1, 32, 1)
    assert (parameters.message_points, parameters.averaging) == (4000, 0.995)
    assert (parameters.opacity_weight, parameters.scale_weight) == (2.0, 2.0)
    assert HideImageParameters(method="homogeneous").lambda_message == HideImageParameters().lambda_message == 0.1


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
def test_what_is_stated_holds(method: str) -> None:
    stated = {"method": method, "lambda_message": 0.75, "message_points": 7, "decoder_width": None}
    parameters = HideScenesParameters.model_validate_json(json.dumps(stated))
    assert (parameters.lambda_message, parameters.message_points) == (0.75, 7)
    assert parameters.decoder_width == HideScenesParameters.model_validate({"method": method}).decoder_width


def test_the_key_is_made_of_the_values_and_not_of_their_absence() -> None:
    left_out, stated = ({"method": "homogeneous"}, {"method": "homogeneous", "averaging": 0.995, "kernel_size": 1})
    assert validate(hide_scenes, left_out).model_dump() == validate(hide_scenes, stated).model_dump()


@pytest.mark.parametrize("wrong", [{"method": "magic"}, {"method": 3}, {"kernelsize": 1}, {"decoder_width": "wide"}])
def test_what_is_wrong_is_refused_by_its_name(wrong: dict[str, str | int]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        validate(hide_scenes, wrong)

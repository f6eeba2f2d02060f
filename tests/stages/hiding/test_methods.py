"""The shapes that methods declare are those of their attributes, and only what could be imported may be trained."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from stages.hiding.method import LARGEST_SETTING, build_method, settings_of
from stages.hiding.rendering import COVER
from stages.training.hiding import HidingParameters

COUPLED = {"feature_dim": 5, "layers": 2, "decoder_width": 6, "kernel_size": 1, "precision": "float32"}
SETTINGS = {
    "gs_hider": COUPLED,
    "homogeneous": COUPLED,
    "plain": {"sh_degree": 3},
    "sh": {"sh_degree": 2},
    "decoder": {"sh_degree": 1, "layers": 2, "decoder_width": 6, "precision": "float32"},
}


@pytest.mark.parametrize(
    ("name", "messages"),
    [(name, messages) for name in SETTINGS for messages in ([], ["one", "two"]) if name != "plain" or not messages],
)
def test_stated_shapes_are_those_of_the_attributes(name: str, messages: list[str]) -> None:
    """Plain 3DGS hides nothing."""
    method = build_method(name, SETTINGS[name] | ({"messages": messages} if messages else {}))
    colors = {picture: np.full((4, 3), 0.5) for picture in (COVER, *messages)}
    attributes = method.initial_attributes(colors, np.random.default_rng(0))
    assert method.attribute_shapes() == {name: tuple(values.shape[1:]) for name, values in attributes.items()}
    assert method.attribute_shapes().keys() == method.learning_rates.keys()


@pytest.mark.parametrize("name", ["gs_hider", "homogeneous", "decoder"])
@pytest.mark.parametrize("precision", ["nn", "float64", "", 3])
def test_whatever_else_torch_has_is_no_precision(name: str, precision: object) -> None:
    with pytest.raises(KeyError):
        build_method(name, SETTINGS[name] | {"precision": precision})


@pytest.mark.parametrize("setting", ["feature_dim", "layers", "decoder_width"])
def test_what_could_not_be_imported_is_not_trained(setting: str) -> None:
    assert getattr(HidingParameters.model_validate({setting: LARGEST_SETTING}), setting) == LARGEST_SETTING
    with pytest.raises(ValidationError, match=setting):
        HidingParameters.model_validate({setting: LARGEST_SETTING + 1})


@pytest.mark.parametrize("name", ["gs_hider", "homogeneous", "decoder"])
def test_decoders_have_the_kernel_size_that_was_asked_for(name: str) -> None:
    parameters = HidingParameters.model_validate({"method": name, "kernel_size": 1})
    settings = parameters.model_dump(include=set(settings_of(name)))
    method = build_method(name, settings | {"messages": ["message"]})
    kernels = [weight for weight in method.networks["message_decoder"].parameters() if weight.ndim == 4]
    assert {tuple(weight.shape[2:]) for weight in kernels} == {(1, 1)}

"""What hiding scenes and hiding an image have in common: their parameters, and the training that they define."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field, ValidationInfo, field_validator, model_validator
from torch import Tensor

from opencl.routes import working_device
from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.hiding.coupled import FEATURES
from stages.hiding.decoders import Precision
from stages.hiding.key import generator_apart, key_generator
from stages.hiding.method import (
    LARGEST_SETTING,
    DrawsDirections,
    Method,
    build_to_train,
    is_setting,
    move_networks,
    presets_of,
    settings_of,
)
from stages.hiding.method_names import PLAIN, MethodName, module_of
from stages.hiding.rendering import COVER
from stages.scene.cameras import rig_extent
from stages.scene.gaussians import gaussians_at
from stages.scene.message_views import MessagePictures
from stages.scene.scene import Scene
from stages.training.loop import Training, TrainingSettings, TrainingViews
from stages.training.objectives import FixedView, PictureTerm
from stages.training.parameters import TrainingParameters
from stages.training.starting_points import GREY, Points, starting_points


class HidingParameters(TrainingParameters):
    """The paper's symbols: M is `feature_dim`, λ is `lambda_message`, γ and β are the two SSIM weights.

    A parameter that is null or left out takes the method's `PRESETS`, or else the default. Defaults of λ, M, layers, γ
    and β are the paper's. Those of learning rates and initial features are ours;
    `workflows/profiles/released_code.yaml` has the released code's.
    """

    hides_scenes: ClassVar[bool] = False

    method: MethodName = Field(
        "gs_hider",
        description="How Gaussians become pictures: as in the paper (gs_hider); with features divided by shares "
        "(homogeneous); one of the paper's baselines, 3DGS+SH (sh) or 3DGS+Decoder (decoder); or a method of your "
        "own, by the name of its file in stages/hiding/methods.",
    )
    own_settings: dict[str, Any] = Field(
        {},
        description="For a method of your own: values of those of its SETTINGS that are not parameters here, such as "
        "{hash_levels: 4}.",
    )
    feature_dim: int = Field(
        16,
        ge=1,
        le=LARGEST_SETTING,
        description="M: channels of each Gaussian's coupled feature. homogeneous with several messages: better 8 for "
        "each picture, the cover included.",
    )
    layers: int = Field(5, ge=2, le=LARGEST_SETTING, description="Convolutions in each decoder.")
    decoder_width: int = Field(
        64,
        ge=1,
        le=LARGEST_SETTING,
        description="Channels between the decoders' convolutions. homogeneous: 32.",
    )
    kernel_size: Literal[1, 3, 5] = Field(
        3,
        description="Kernel size of the decoders' convolutions, in pixels. Released code: 3. With 1, as in "
        "homogeneous, each pixel is decoded independently.",
    )
    sh_degree: int = Field(
        3, ge=0, le=3, description="Highest degree of spherical harmonics, in methods that use them."
    )
    lambda_message: float = Field(
        0.5,
        ge=0,
        description="λ: each message's weight in the total loss (the paper does not say whether several share it). "
        "homogeneous: 0.1.",
    )
    ssim_weight_cover: float = Field(0.2, ge=0, le=1, description="γ: SSIM's share of the cover's loss.")
    ssim_weight_message: float = Field(0.2, ge=0, le=1, description="β: SSIM's share of a message's loss.")
    initial_features: Literal["colors", "zeros"] = Field(
        "colors",
        description="colors: features and decoders start by showing the points' colours. zeros: features start at zero "
        "and decoders at random, as in the released code.",
    )
    feature_rate: float = Field(
        5e-2, gt=0, description="Learning rate of features. Released code: 2.5e-3, with 50,000 iterations."
    )
    network_rate: float = Field(TrainingSettings.network_rate, gt=0, description="Learning rate of the decoders.")
    final_rate_share: float = Field(
        0.1, gt=0, le=1, description="Final value of both rates as a share of the initial one. Released code: 1."
    )
    precision: Precision = Field(
        "float32",
        description="Precision of the decoders. tf32: on NVIDIA GPUs, all convolutions multiply with 10-bit "
        "mantissas, as is torch's default there; elsewhere float32. bfloat16: all but the first and last convolution, "
        "for GPUs, and for decoders of 3 x 3 pixels on CPUs with AMX; slower for others there, and on other CPUs. It "
        "costs messages about 0.1 dB. Each is bit-reproducible for a fixed number of threads.",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, stated: Any) -> Any:
        if not isinstance(stated, dict):
            return stated  # for the validator to refuse
        given = {name: value for name, value in stated.items() if value is not None}
        method = str(given.get("method", cls.model_fields["method"].default))
        presets = presets_of(method, cls.hides_scenes)
        if unknown := sorted(presets.keys() - cls.model_fields.keys()):
            raise UserError(
                "the method presets unknown parameters",
                where=module_of(method),
                found=str(unknown),
                expected="parameters of the stage; settings of its own have no presets",
            )
        return presets | given

    @field_validator("method")
    @classmethod
    def _hides(cls, method: str) -> str:
        if method == PLAIN:
            raise ValueError("should be one that hides: this is 3DGS itself, which the stage train_scene trains")
        return method

    @field_validator("own_settings")
    @classmethod
    def _own(cls, stated: dict[str, Any], given: ValidationInfo) -> dict[str, Any]:
        if "method" not in given.data:
            return stated  # the method was refused
        wanted = {name for name in settings_of(given.data["method"]) if name not in cls.model_fields}
        if wanted != stated.keys():
            listed = ", ".join(sorted(wanted)) or "none"
            raise ValueError(f"should have exactly these keys for the method {given.data['method']}: {listed}")
        if refused := [name for name, value in stated.items() if not is_setting(value)]:
            raise ValueError(f"should be numbers up to {LARGEST_SETTING} and short words; {refused[0]} is neither")
        return stated

    def build_method(self, messages: Sequence[str], key: Artifact | None) -> Method:
        """Build the method for these messages; its initial weights follow from the key, or else from `seed`."""
        settings = self.model_dump(include=set(settings_of(self.method))) | self.own_settings
        if refused := [name for name, value in settings.items() if not is_setting(value)]:
            raise UserError(
                "this cannot be a method's setting",
                where=module_of(self.method),
                found=f"{refused[0]} = {settings[refused[0]]!r}",
                expected=f"numbers up to {LARGEST_SETTING} and short words: others are refused when it is imported",
            )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed if key is None else int(generator_apart(key, "building").integers(2**32)))
            method = build_to_train(self.method, settings | {"messages": list(messages)})
            if key is not None:
                _draw_weights(method, key)
        return method


def hiding_training(
    parameters: HidingParameters,
    cover: Scene,
    messages: Sequence[str],
    views: TrainingViews,
    terms: Sequence[PictureTerm],
    key: Artifact | None,
    placed: Mapping[str, MessagePictures] | None = None,
    message_points: int = 0,
    fixed: Sequence[FixedView] = (),
) -> Training:
    """A new training, which starts from the cover's sparse points and the messages' points.

    Each message that is `placed` in the cover's world contributes up to `message_points` Gaussians; other messages
    start grey everywhere. Everything is created on the CPU, so that a seed has the same effect everywhere, and then
    moved to the working device.

    Raises `UserError` if `initial_features` is zeros and the method has attributes other than features, and if decoders
    that start by showing colours are too narrow for all messages.
    """
    method = parameters.build_method(messages, key)
    points, colors = starting_points(cover, placed or {}, parameters.start(message_points))
    attributes = _initial_attributes(
        parameters, method, points, {name: colors.get(name) for name in (COVER, *messages)}, key
    )
    settings = replace(
        parameters.settings(rig_extent(cover.cameras)),
        attribute_rates={FEATURES: parameters.feature_rate} if FEATURES in attributes else {},
        network_rate=parameters.network_rate,
        final_rate_share=parameters.final_rate_share,
    )
    device = working_device()
    move_networks(method, device)
    return Training(gaussians_at(points, attributes).to(device), method, views, terms, settings, fixed)


def _draw_weights(method: Method, key: Artifact) -> None:
    """Draw the initial weights of every layer that has `reset_parameters` from the key, each from a seed of its own.

    torch only uses 32 bits of a seed, which could be found from the public scene decoder by brute force; with separate
    seeds, this reveals nothing about the message decoder's weights. What else a method draws while it is built depends
    on a single such seed from the key.
    """
    generator = generator_apart(key, "weights")
    for network in method.networks.values():
        for layer in network.modules():
            if callable(reset := getattr(layer, "reset_parameters", None)):
                torch.manual_seed(int(generator.integers(2**32)))
                reset()


def _initial_attributes(
    parameters: HidingParameters,
    method: Method,
    points: Points,
    colors: Mapping[str, Points | None],
    key: Artifact | None,
) -> dict[str, Tensor]:
    if parameters.initial_features == "colors":
        known = {name: np.full_like(points, GREY) if shown is None else shown for name, shown in colors.items()}
        return method.initial_attributes(known, key_generator(key, parameters.seed))
    shapes = method.attribute_shapes()
    if shapes.keys() != {FEATURES}:
        raise UserError(
            "this method has no features that could start from zeros",
            found=f"method: {method.name}, initial_features: zeros",
            remedy="leave initial_features out, or choose gs_hider",
        )
    if isinstance(method, DrawsDirections):
        method.draw_directions(key_generator(key, parameters.seed))
    return {FEATURES: torch.zeros(len(points), *shapes[FEATURES])}

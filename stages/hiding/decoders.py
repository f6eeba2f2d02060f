"""The scene decoder D_s and the message decoder D_m, with five convolutions each by default (Eq. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, get_args

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from opencl.pixel_decoder import decode_pixels
from opencl.routes import works_in_place
from pipeline.errors import UserError
from stages.hiding.convolution import Convolution

Precision = Literal["float32", "tf32", "bfloat16"]
"""The arithmetic of `decode`, chosen by the setting `precision`."""
PRECISIONS: dict[str, Precision] = {name: name for name in get_args(Precision)}
"""Precisions by their names in settings."""


class Decoder(torch.nn.Sequential):
    """Convolutions from `feature_dim` through `width` to `channels` channels, zero padding, ReLU between.

    The paper does not state `kernel_size` and `width`; its released code has 3 and 64. With a kernel size of 1, every
    pixel is decoded by itself.

    The paper says "five stacked layers of convolution followed by ReLU". As in its released code, the last layer is
    linear here: a ReLU there has no gradient wherever the picture starts out black. Initial weights are drawn from
    torch's generator. Raises `ValueError` for fewer than two layers, and for an even kernel size, which would shrink
    pictures.
    """

    reads_centred = False
    """Whether the decoder centres blended features by subtracting half the blended opacity. This one reads them as they
    are."""

    def __init__(self, feature_dim: int, channels: int, layers: int = 5, width: int = 64, kernel_size: int = 3):
        if layers < 2:
            raise ValueError(f"a decoder has at least two layers, not {layers}")
        if kernel_size < 1 or kernel_size % 2 == 0:
            raise ValueError(f"a decoder's kernel has an odd side, not {kernel_size}")
        sizes = [feature_dim, *[width] * (layers - 1), channels]
        modules: list[torch.nn.Module] = []
        for inputs, outputs in pairwise(sizes):
            modules += [Convolution(inputs, outputs, kernel_size), torch.nn.ReLU()]
        super().__init__(*modules[:-1])

    @property
    def convolutions(self) -> list[Convolution]:
        """The convolutions of all layers; a ReLU follows each but the last."""
        return [module for module in self if isinstance(module, Convolution)]

    @property
    def is_of_single_pixels(self) -> bool:
        """Whether every pixel is decoded by itself."""
        return all(convolution.kernel_size == (1, 1) for convolution in self.convolutions)

    def pass_through(self, rows: Float[Tensor, "C M"], neutral: float = 0.5) -> None:
        """Initialise as a linear map: output channel k is rows[k]·(f - neutral) + 0.5.

        Not in the paper. From the usual random weights, five layers must first learn to carry a picture at all. With
        this initialisation they carry one from the start, and the contribution of all other channels to it starts at
        zero. Raises `UserError` if the decoder is narrower than its output.
        """
        convolutions, channels = self.convolutions, len(rows)
        centre = convolutions[0].kernel_size[0] // 2
        narrowest = min(convolution.out_channels for convolution in convolutions)
        if narrowest < channels:
            raise UserError(
                "a decoder is too narrow for the pictures that it is to show",
                found=f"decoder_width: {narrowest}, {channels // 3} pictures",
                expected=f"a decoder_width of at least {channels}, 3 for each picture",
            )
        with torch.no_grad():
            for position, convolution in enumerate(convolutions):
                convolution.weight[:channels] = 0
                convolution.bias[:channels] = 0
                taps = rows if position == 0 else torch.eye(channels, convolution.in_channels)
                convolution.weight[:channels, :, centre, centre] = taps
            convolutions[0].bias[:channels] = 0.5 - neutral * rows.sum(dim=1)

    @torch.no_grad()
    def read_along(self, back: Float64[Tensor, "M M"]) -> None:
        """Replace every row r that reads centred features by r B, B = `back`: transformed features look as before.

        Features are centred at 0.5. Exact where the opacity is 1, except next to the picture's border with its zero
        padding. The features are the first M inputs; inputs after them are read as before. Raises `UserError` for fewer
        than M inputs.
        """
        first = self.convolutions[0]
        if first.in_channels < len(back):
            raise UserError(
                "a decoder reads fewer inputs than there are features",
                found=f"{first.in_channels} inputs",
                expected=f"at least {len(back)}, the features first",
                remedy="Give the scene decoder a read_along of its own.",
            )
        rows = first.weight[:, : len(back)]
        before = rows.double().sum(dim=(2, 3))
        rows.copy_(rows_along(rows.permute(0, 2, 3, 1), back).permute(0, 3, 1, 2))
        after = rows.double().sum(dim=(2, 3))
        first.bias.add_((0.5 * (before - after).sum(dim=1)).float())


def rows_along(rows: Float[Tensor, "... M"], back: Float64[Tensor, "M M"]) -> Float[Tensor, "... M"]:
    """r B for every row r, computed in float64."""
    return (rows.double() @ back).float()


def decode(
    decoder: Decoder, feature_map: Float[Tensor, "H W M"], precision: Precision = "float32"
) -> Float[Tensor, "H W C"]:
    """D(F_coup) of Eq. 5: unclamped float32, channels last.

    `tf32` is for NVIDIA GPUs, where it is torch's default for convolutions and so probably what the released code
    trains with: all convolutions multiply numbers with a 10-bit mantissa, forward and backward, and sum in float32. On
    other devices it equals float32. Both decoders of an iteration, forward and backward, at 1600 x 1060 pixels on an
    H100: 326 ms in float32, 148 in bfloat16, 93 in TF32 (M = 16; with M = 32: 260, 98 and 55;
    `tests/benchmarks/nvidia.py`). Emulated on the CPU (`tests/benchmarks/decoder_precision.py`), fox hiding kitchen,
    600 iterations of GS-Hider, two seeds, TF32 changes the cover by -0.04 ± 0.12 and the message by +0.02 ± 0.07 dB on
    training views, and by +0.05 ± 0.16 and -0.10 ± 0.13 dB on test views.

    `bfloat16` runs all convolutions but the first and the last in bfloat16, forward and backward, with float32 sums and
    weights that are optimised in float32. It is for GPUs, and for CPUs that multiply matrices of bfloat16 (AMX): on one
    such Xeon, an iteration of GS-Hider takes 119 ms instead of 182, and one of ours, whose convolutions of single
    pixels have kernels of their own in float32, 74 instead of 64 (`tests/benchmarks/training_iteration.py`). (Earlier,
    on Emerald Rapids, it took more than twice as long in bfloat16; why is not known. Zen 4 and 5 were not measured
    since.) CPUs without instructions for it are slower: they round in float32 (`_through_rounded`).
    The last convolution stays in float32, since pictures rounded to eight bits of mantissa get the sign of small
    residuals wrong: on a trained container, that biased the weights' gradients by up to 30 %. The first stays in
    float32, too, as it would read rounded features. The remaining cost, for fox hiding kitchen, 600 iterations: the
    message loses 0.15 (homogeneous) and 0.08 dB (gs_hider) on training views.

    All precisions are deterministic on one machine with one number of threads. Pictures do not depend on that number,
    and neither do gradients computed by our own kernels. Gradients of weights that torch convolves with (on the CPU in
    bfloat16, and in float32 if either channel count is not a multiple of 16) may: they are sums over pixels, and each
    of torch's threads first sums its own share.
    """
    by_pixels = decoder.is_of_single_pixels and precision != "bfloat16" and feature_map.dtype == torch.float32
    if by_pixels and works_in_place(feature_map.device):
        weights = [convolution.weight.flatten(1) for convolution in decoder.convolutions]
        return decode_pixels(feature_map, weights, [convolution.bias for convolution in decoder.convolutions])
    first, *between, last = decoder.convolutions
    rounded = precision == "tf32"
    values = first(feature_map.permute(2, 0, 1).unsqueeze(0), rectified=True, rounded=rounded)
    if precision == "bfloat16" and values.device.type == "cpu" and not has_bfloat16_convolutions():
        values = _through_rounded(between, values)
    else:
        with torch.autocast(values.device.type, dtype=torch.bfloat16, enabled=precision == "bfloat16"):
            for convolution in between:
                values = convolution(values, rectified=True, rounded=rounded)
    decoded: Tensor = last(values.float(), rounded=rounded)
    return decoded.squeeze(0).permute(1, 2, 0)


def has_bfloat16_convolutions() -> bool:
    """Whether torch convolves bfloat16 with dedicated instructions on this CPU (x86: AVX-512), not number by number."""
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def _through_rounded(convolutions: Sequence[Convolution], values: Tensor) -> Tensor:
    """Emulate bfloat16 convolutions and their ReLU by float32 ones of values and weights rounded to bfloat16.

    Products of bfloat16 numbers are exact in float32, but our convolutions multiply sums of several values. For 64
    channels, their error is 1e-6 to 2e-6 of the output's root mean square; with torch's float32 convolutions it is
    0.1e-6. Rounding the output to bfloat16 adds a thousand times as much to either. A decoder's step takes some 50
    times as long with torch's own bfloat16 as in float32, 3.6 times with torch's float32 convolutions, and 1.2 to 1.5
    times this way (Emerald Rapids, torch alone restricted to AVX2, 112 x 200 pixels).
    """
    values = _rounded(values)
    for convolution in convolutions:
        weights = {name: _rounded(weight) for name, weight in convolution.named_parameters()}
        values = _rounded(torch.func.functional_call(convolution, weights, (values,), {"rectified": True}))
    return values


def _rounded(values: Tensor) -> Tensor:
    """Round to bfloat16 and back; the gradient is rounded likewise."""
    return values.bfloat16().float()

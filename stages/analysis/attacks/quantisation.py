"""Fewer bits a value."""

from __future__ import annotations

from torch import Tensor

from stages.analysis.attacks.target import Target

HALF = 16
"""Bits from which on values are floats of half precision; below, steps of equal size."""

SEVERITIES = (16.0, 8.0, 6.0, 5.0, 4.0)


def quantisation(target: Target, bits: float) -> Target:
    """Store every value with so many bits: 16 are half-precision floats, fewer are equal steps from the least to the
    greatest value of each column, such as a channel of the features.

    The attacker, or whoever compresses files, knows the container alone. Positions keep 16 bits a coordinate, as equal
    steps, since with 8 there is no scene left. No Gaussians stay none.
    """
    return target.with_parameters(
        {name: _quantised(values, bits, name == "means") for name, values in target.gaussians.parameters.items()}
    )


def _quantised(values: Tensor, bits: float, is_position: bool) -> Tensor:
    if bits >= HALF and not is_position:
        return values.half().float()
    if not len(values):
        return values
    least, greatest = values.amin(dim=0, keepdim=True), values.amax(dim=0, keepdim=True)
    steps = 2 ** (HALF if is_position else int(bits)) - 1
    size = (greatest - least).clamp_min(1e-12) / steps
    return least + ((values - least) / size).round() * size

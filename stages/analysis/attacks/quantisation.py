"""Quantisation: fewer bits for each stored value."""

from __future__ import annotations

from torch import Tensor

from stages.analysis.attacks.target import Target

HALF = 16
"""With this many bits or more, values become half-precision floats; with fewer, multiples of a constant step."""

SEVERITIES = (16.0, 8.0, 6.0, 5.0, 4.0)


def quantisation(target: Target, bits: float) -> Target:
    """Round every stored value to this many bits.

    With 16 bits, values are half-precision floats. With fewer, they take equal steps from the least to the greatest
    value of each column, such as a feature channel. Positions always have 16 bits per coordinate, in equal steps: 8
    would leave nothing of the scene. The attacker, or anyone who compresses files, knows only the container, which may
    have no Gaussians.
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

"""LPIPS, the learned perceptual distance of Zhang et al. (CVPR 2018), version 0.1, on VGG16 or AlexNet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.errors import UserError
from stages.imaging.lpips_weights import HOW_TO_INSTALL, Network, Weights, read_weights

# ImageNet's mean and standard deviation for colours scaled to [-1, 1], as LPIPS defines them.
MEAN = (-0.030, -0.088, -0.188)
DEVIATION = (0.458, 0.448, 0.450)
SMALLEST_SIDE = {"vgg": 16, "alex": 31}  # below it, the output of a pooling layer would be empty


class Lpips:
    """The LPIPS metric between two pictures; see ``load_lpips``.

    Both networks reduce resolution 16-fold, so that for pictures below 64 pixels a side the deepest features have at
    most 3 x 3 positions: compare such values only with those of pictures of the same size.
    """

    def __init__(self, network: Network, weights: Weights, device: torch.device | str = "cpu") -> None:
        tensors = {name: torch.from_numpy(array).to(device) for name, array in weights.items()}
        self.network = network
        self._kernels = [tensors[f"{layer}/kernel"].permute(3, 2, 0, 1).contiguous() for layer in _layers(weights)]
        self._biases = [tensors[f"{layer}/bias"] for layer in _layers(weights)]
        self._heads = [tensors[f"head {number}"] for number in range(5)]

    @torch.no_grad()
    def __call__(self, picture: Float[Tensor, "height width 3"], truth: Float[Tensor, "height width 3"]) -> float:
        """The distance, 0 for equal pictures. Colours are in [0, 1] and are scaled to [-1, 1] first.

        (The evaluation script of 3DGS omits that scaling, so its values differ.) The pictures may be on another device
        than the weights. Raises ``ValueError`` if the sizes differ, or a side is below 16 (VGG16) or 31 (AlexNet)
        pixels.
        """
        if picture.shape != truth.shape or min(picture.shape[:2]) < SMALLEST_SIDE[self.network]:
            raise ValueError(
                f"LPIPS ({self.network}) compares two pictures of one size, at least {SMALLEST_SIDE[self.network]} "
                f"pixels a side, not {tuple(picture.shape)} and {tuple(truth.shape)}"
            )
        both = torch.stack((picture, truth)).to(self._kernels[0].device).permute(0, 3, 1, 2).float() * 2 - 1
        both = (both - both.new_tensor(MEAN).view(3, 1, 1)) / both.new_tensor(DEVIATION).view(3, 1, 1)
        features = self._vgg(both) if self.network == "vgg" else self._alex(both)
        return sum(_distance(each, head) for each, head in zip(features, self._heads, strict=True))

    def _vgg(self, values: Tensor) -> Iterator[Tensor]:
        """Each block's features, which need not stay: those of the first alone are 512 bytes a pixel."""
        layer = 0
        for block, depth in enumerate((2, 2, 3, 3, 3)):
            values = functional.max_pool2d(values, 2) if block else values
            for _ in range(depth):
                values = self._convolve(layer, values, padding=1)
                layer += 1
            yield values

    def _alex(self, values: Tensor) -> Iterator[Tensor]:
        values = self._convolve(0, values, stride=4, padding=2)
        yield values
        values = self._convolve(1, functional.max_pool2d(values, 3, 2), padding=2)
        yield values
        values = functional.max_pool2d(values, 3, 2)
        for layer in (2, 3, 4):
            values = self._convolve(layer, values, padding=1)
            yield values

    def _convolve(self, layer: int, values: Tensor, padding: int, stride: int = 1) -> Tensor:
        return functional.conv2d(values, self._kernels[layer], self._biases[layer], stride, padding).relu_()


def networks_for(wanted: Sequence[Network], width: int, height: int, log: Callable[[str], None]) -> tuple[Network, ...]:
    """The networks in `wanted` that can measure pictures of this size; the others are reported to `log`."""
    side = min(width, height)
    for network in wanted:
        if side < SMALLEST_SIDE[network]:
            log(
                f"LPIPS ({network}) is not measured: pictures of {width} x {height} pixels have less than the "
                f"{SMALLEST_SIDE[network]} a side that it needs"
            )
    return tuple(network for network in wanted if side >= SMALLEST_SIDE[network])


def lpips_metrics(
    wanted: Sequence[Network], width: int, height: int, device: torch.device | str, log: Callable[[str], None]
) -> dict[str, Lpips]:
    """The metrics of `networks_for`, by the name of their quantity, such as `lpips_vgg`, computed on `device`.

    Raises `UserError` if weights are not installed: whoever wants them has asked before (`weights_installed`).
    """
    return {f"lpips_{network}": _metric(network, device) for network in networks_for(wanted, width, height, log)}


def _metric(network: Network, device: torch.device | str) -> Lpips:
    metric = load_lpips(network, device)
    if metric is None:
        raise UserError(f"the LPIPS weights ({network}) were removed during the run", remedy=HOW_TO_INSTALL)
    return metric


def load_lpips(network: Network, device: torch.device | str = "cpu") -> Lpips | None:
    """The metric, or None if its weights are not installed (see ``lpips_weights.HOW_TO_INSTALL``)."""
    weights = read_weights(network)
    return None if weights is None else Lpips(network, weights, device)


def _layers(weights: Weights) -> range:
    return range(sum(name.endswith("/kernel") for name in weights))


def _distance(features: Float[Tensor, "2 channels height width"], head: Float[Tensor, " channels"]) -> float:
    """The weighted squared difference of unit-normalised features, averaged over all positions."""
    picture, truth = features
    lengths = torch.linalg.vector_norm(features, dim=1) + 1e-10
    difference = (picture / lengths[0]).addcdiv_(truth, lengths[1], value=-1)  # all that is held beside the features
    return float(torch.einsum("chw,c->hw", difference.square_(), head).mean())

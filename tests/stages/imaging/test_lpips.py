"""LPIPS: its published values where the weights are installed, its structure with random weights everywhere."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view

from stages.imaging.lpips import Lpips, load_lpips
from stages.imaging.lpips_weights import HOW_TO_INSTALL, Network, Weights
from stages.imaging.pictures import picture_to_tensor, read_picture

REFERENCE_PICTURES = Path(__file__).parents[4] / "shared" / "data" / "lpips"

VGG_CHANNELS = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]
ALEX_LAYERS = [(11, 3, 64), (5, 64, 192), (3, 192, 384), (3, 384, 256), (3, 256, 256)]


@pytest.mark.parametrize(
    ("network", "picture", "truth", "published"),
    [
        ("vgg", "apple", "pear", 0.65710),
        ("alex", "ex_ref", "ex_p0", 0.7219),
        ("alex", "ex_ref", "ex_p1", 0.1376),
    ],
)
def test_published_distances(network: Network, picture: str, truth: str, published: float) -> None:
    metric = load_lpips(network)
    if metric is None:
        pytest.skip(f"the LPIPS weights are not installed. {HOW_TO_INSTALL}")
    if not REFERENCE_PICTURES.is_dir():
        pytest.skip(f"the reference pictures are not in {REFERENCE_PICTURES}")
    pair = [picture_to_tensor(read_picture(REFERENCE_PICTURES / f"{name}.png")) for name in (picture, truth)]
    assert metric(*pair) == pytest.approx(published, abs=1e-4)
    assert metric(*reversed(pair)) == pytest.approx(published, abs=1e-4)


def random_weights(network: Network) -> Weights:
    random = np.random.default_rng(0)
    vgg = [(3, one, other) for one, other in itertools.pairwise(VGG_CHANNELS)]
    layers = vgg if network == "vgg" else ALEX_LAYERS
    tapped = (1, 3, 6, 9, 12) if network == "vgg" else range(5)
    weights = {}
    for number, (side, channels_in, channels_out) in enumerate(layers):
        spread = (side * side * channels_in) ** -0.5
        weights[f"{number}/kernel"] = random.normal(0, spread, (side, side, channels_in, channels_out))
        weights[f"{number}/bias"] = random.normal(0, 0.1, channels_out)
    for number, layer in enumerate(tapped):
        weights[f"head {number}"] = random.uniform(0, 1, layers[layer][2])
    return {name: array.astype(np.float32) for name, array in weights.items()}


class Textbook:
    """LPIPS by Zhang et al. (2018) of one pair, with convolutions written out, in float64."""

    def __init__(self, weights: Weights):
        self.weights = {name: array.astype(np.float64) for name, array in weights.items()}

    def convolved(self, layer: int, values: np.ndarray, stride: int, padding: int) -> np.ndarray:
        """After one layer with its ReLU; values are height x width x channels."""
        kernel = self.weights[f"{layer}/kernel"]
        padded = np.pad(values, ((padding, padding), (padding, padding), (0, 0)))
        windows = sliding_window_view(padded, kernel.shape[:2], axis=(0, 1))[::stride, ::stride]
        found = np.tensordot(windows, kernel, ([3, 4, 2], [0, 1, 2])) + self.weights[f"{layer}/bias"]
        return np.maximum(found, 0)

    @staticmethod
    def pooled(values: np.ndarray, side: int) -> np.ndarray:
        return sliding_window_view(values, (side, side), axis=(0, 1))[::2, ::2].max(axis=(3, 4))

    def features(self, network: Network, picture: np.ndarray) -> list[np.ndarray]:
        """The features after the five layers that are compared."""
        values = (2 * picture - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
        found = []
        for layer in range(13 if network == "vgg" else 5):
            if layer in ((2, 4, 7, 10) if network == "vgg" else (1, 2)):
                values = self.pooled(values, 2 if network == "vgg" else 3)
            stride, padding = (1, 1) if network == "vgg" else {0: (4, 2), 1: (1, 2)}.get(layer, (1, 1))
            values = self.convolved(layer, values, stride, padding)
            if network == "alex" or layer in (1, 3, 6, 9, 12):
                found.append(values / np.linalg.norm(values, axis=2, keepdims=True))
        return found

    def __call__(self, network: Network, picture: np.ndarray, truth: np.ndarray) -> float:
        pairs = zip(self.features(network, picture), self.features(network, truth), strict=True)
        return sum(
            ((one - other) ** 2 @ self.weights[f"head {number}"]).mean() for number, (one, other) in enumerate(pairs)
        )


@pytest.mark.parametrize("network", ["vgg", "alex"])
def test_agrees_with_the_definition(network: Network) -> None:
    weights = random_weights(network)
    picture, truth = np.random.default_rng(2).uniform(0, 1, (2, 37, 46, 3))
    found = Lpips(network, weights)(torch.from_numpy(picture), torch.from_numpy(truth))
    assert found == pytest.approx(Textbook(weights)(network, picture, truth), rel=1e-4)


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(("network", "smallest"), [("vgg", 16), ("alex", 31)])
def test_grows_with_the_difference_and_needs_a_smallest_size(network: Network, smallest: int) -> None:
    metric = Lpips(network, random_weights(network))
    generator = torch.Generator().manual_seed(1)
    picture, noise = torch.rand(2, smallest, 40, 3, generator=generator)
    assert metric(picture, picture) == 0
    slight, strong = (metric(picture, picture.lerp(noise, weight)) for weight in (0.1, 0.7))
    assert 0 < slight < strong
    with pytest.raises(ValueError, match=f"at least {smallest}"):
        metric(picture[1:], picture[1:])
    with pytest.raises(ValueError, match="one size"):
        metric(picture, picture[:, 1:])

"""Keys: every byte counts, and a container starts from its own key."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.key import KEY_BYTES, Use, generator_apart, key_apart, key_generator, write_key
from stages.hiding.watermark.coins import thrown
from tests.running import run_stage
from tests.stages.small import message_views, scene


def key_of(folder: Path, key: bytes) -> Artifact:
    with create(folder / key.hex()[:120], "key", private=True) as writer:
        write_key(writer, key)
    return load(folder / key.hex()[:120])


def test_every_byte_counts(tmp_path: Path) -> None:
    keys = [bytes(KEY_BYTES)]
    keys += [bytes(place) + b"\x01" + bytes(KEY_BYTES - 1 - place) for place in range(KEY_BYTES)]
    artifacts = [key_of(tmp_path, key) for key in keys]
    drawn = [int(key_generator(artifact, 0).integers(2**62)) for artifact in artifacts]
    assert len(set(drawn)) == KEY_BYTES + 1
    of_seals = {key_apart(artifact, "seal") for artifact in artifacts}
    assert len(of_seals) == KEY_BYTES + 1
    assert of_seals.isdisjoint(keys), "who has a seal's key does not have the whole key"
    assert drawn[0] == int(key_generator(key_of(tmp_path / "again", keys[0]), 7).integers(2**62)), "whatever the seed"


def test_what_a_key_drew_earlier_it_draws_again(tmp_path: Path) -> None:
    """A published grain is found by the coins of its key, whichever version added it."""
    coins = thrown(16, key_generator(key_of(tmp_path, bytes(range(KEY_BYTES))), 0))
    assert "".join("+" if coin > 0 else "-" for coin in coins) == "-++++-------++-+"


def test_a_key_of_another_length_is_refused(tmp_path: Path) -> None:
    for length in (KEY_BYTES - 1, KEY_BYTES + 1):
        artifact = key_of(tmp_path, bytes(length))
        for drawn_from in (lambda key: key_generator(key, 0), lambda key: key_apart(key, "seal")):
            with pytest.raises(UserError, match=f"{length} bytes"):
                drawn_from(artifact)


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
def test_a_container_starts_from_its_key(tmp_path: Path, method: str) -> None:
    """The seed is the same: those who know only the seed know nothing that the key drew."""
    settings = {"method": method, "iterations": 1, "feature_dim": 8, "decoder_width": 8, "densify_gradient": 1e9}
    inputs = {"cover": scene(tmp_path / "cover"), "messages": (message_views(tmp_path / "views"),)}

    def features(name: str, **key: Artifact) -> np.ndarray:
        made = run_stage(hide_scenes, HideScenesParameters.model_validate(settings), {**inputs, **key}, tmp_path / name)
        return made["container"].read("raw_features")

    first, again, other = (
        features(name, key=key_of(tmp_path, bytes([byte]) * KEY_BYTES)) for name, byte in (("a", 1), ("b", 1), ("c", 2))
    )
    np.testing.assert_array_equal(first, again)
    others = (other, features("d"))  # without a key, drawn from the seed
    assert all(abs(np.corrcoef(first.ravel(), each.ravel())[0, 1]) < 0.5 for each in others)


@pytest.mark.parametrize(
    "settings", [{"method": "decoder"}, {"method": "gs_hider", "initial_features": "zeros"}, {"method": "homogeneous"}]
)
def test_networks_start_from_the_key_too(tmp_path: Path, settings: dict[str, str]) -> None:
    """If Gaussians take nothing from the key (`decoder`, features that start at zero), it draws these weights alone."""
    parameters = HideScenesParameters.model_validate({"layers": 2, "feature_dim": 8, **settings})

    def weights(key: Artifact | None) -> np.ndarray:
        network = parameters.build_method(["statue"], key).networks["message_decoder"]
        return np.concatenate([tensor.numpy().ravel() for tensor in network.state_dict().values()])

    first, again, other = (
        weights(key_of(tmp_path / name, bytes([byte]) * KEY_BYTES)) for name, byte in (("a", 1), ("b", 1), ("c", 2))
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, weights(None))


def test_without_a_key_networks_start_from_the_seed_alone() -> None:
    def weights(seed: int) -> np.ndarray:
        parameters = HideScenesParameters.model_validate({"method": "decoder", "layers": 2, "seed": seed})
        network = parameters.build_method(["statue"], None).networks["message_decoder"]
        return np.concatenate([tensor.numpy().ravel() for tensor in network.state_dict().values()])

    first = weights(1)
    torch.rand(1)  # what was drawn before makes no difference
    before = torch.get_rng_state()
    np.testing.assert_array_equal(weights(1), first)
    assert not np.array_equal(weights(2), first)
    assert torch.equal(torch.get_rng_state(), before)


def test_no_layer_tells_of_another(tmp_path: Path) -> None:
    """torch uses only 32 bits of a seed, so the seed of the public decoder could be found by trial."""
    parameters = HideScenesParameters.model_validate({"feature_dim": 16, "decoder_width": 16})
    key = key_of(tmp_path, bytes(range(KEY_BYTES)))
    layers = [
        layer.weight.detach().numpy().ravel()
        for network in parameters.build_method(["statue"], key).networks.values()
        for layer in network.modules()
        if isinstance(layer, torch.nn.Conv2d)
    ]
    square = [weights for weights in layers if weights.size == 16 * 16 * 9]
    assert len(square) == 8
    assert len({weights.tobytes() for weights in square}) == 8


def test_each_use_of_a_key_or_a_seed_draws_other_numbers(tmp_path: Path) -> None:
    sources = ((key_of(tmp_path, bytes(range(KEY_BYTES))), 0), (None, 0), (None, 1))
    generators = [key_generator(*source) for source in sources]
    generators += [generator_apart(key, use, seed) for key, seed in sources for use in get_args(Use)]
    assert len({int(generator.integers(2**62)) for generator in generators}) == len(sources) * (1 + len(get_args(Use)))

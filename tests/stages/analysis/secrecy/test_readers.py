"""Wrong decoders follow from seeds alone, start as the method does, and read squares as they read whole views."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from stages.analysis.secrecy.conditions import OTHER_START, OWN_START, RANDOM
from stages.analysis.secrecy.readers import (
    MESSAGE_DECODER,
    WRONG_SEEDS,
    attackers_reader,
    pixels_beyond,
    read,
    refuse_unreadable,
    seeded_reader,
    started_reader,
)
from stages.analysis.secrecy.wrong_decoder import wrong_readings
from stages.hiding.method import Method, build_method
from stages.hiding.mixture import orthonormal_rows
from stages.hiding.rendering import COVER
from tests.stages.analysis.secrecy.observations import HEIGHT, WIDTH, views

COUPLED = {"feature_dim": 16, "layers": 3, "decoder_width": 8, "precision": "bfloat16"}
SETTINGS = {
    "gs_hider": {**COUPLED, "kernel_size": 3},
    "homogeneous": {**COUPLED, "kernel_size": 1},
    "decoder": {"sh_degree": 0, "layers": 3, "decoder_width": 8, "precision": "float32"},
}
OBSERVED = views(orthonormal_rows(6, 16, np.random.default_rng(0)))


def public(method: str) -> Method:
    return build_method(method, SETTINGS[method])


def weights(method: Method) -> torch.Tensor:
    return torch.cat([each.flatten() for each in method.networks[MESSAGE_DECODER].parameters()])


@pytest.mark.parametrize("method", SETTINGS)
def test_a_seed_gives_one_decoder_and_leaves_torch_alone(method: str) -> None:
    before = torch.get_rng_state()
    first, again, other = (weights(seeded_reader(public(method), 1, seed)) for seed in (7, 7, 8))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    public(method)
    torch.set_rng_state(before)
    seeded_reader(public(method), 1, 7)
    state = torch.get_rng_state()
    torch.set_rng_state(before)
    public(method)
    assert torch.equal(state, torch.get_rng_state())


@pytest.mark.parametrize("method", SETTINGS)
def test_a_random_decoder_reads_something(method: str) -> None:
    """One that reads nothing would be no test; our method's directions are zeros until its start.

    Both views are from one camera, so only what they show can tell them apart.
    """
    shown, other = (read(seeded_reader(public(method), 1, 3), each).detach() for each in OBSERVED[:2])
    assert shown.shape == (1, HEIGHT, WIDTH, 3)
    inside = shown[:, 4:-4, 4:-4]
    assert float(inside.std(dim=(1, 2)).min()) > 1e-4
    assert float((inside - other[:, 4:-4, 4:-4]).abs().max()) > 1e-3


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
def test_the_start_from_a_trainings_seed_is_the_trainings(method: str) -> None:
    training = build_method(method, {**SETTINGS[method], "messages": ["statue"]})
    grey = {name: np.full((5, 3), 0.5) for name in (COVER, "statue")}
    training.initial_attributes(grey, np.random.default_rng(4))
    started = started_reader(public(method), 1, 4)
    name = "directions" if method == "homogeneous" else "0.weight"
    own, found = (each.networks[MESSAGE_DECODER].state_dict()[name] for each in (training, started))
    assert torch.equal(own[:3], found[:3])
    other = started_reader(public(method), 1, 5).networks[MESSAGE_DECODER].state_dict()[name]
    assert not torch.allclose(own[:3], other[:3], atol=1e-2)


@pytest.mark.parametrize("method", SETTINGS)
def test_an_attacker_has_another_key_than_a_training_of_the_same_seed(method: str) -> None:
    attackers, other = (weights(attackers_reader(public(method), 1, seed)) for seed in (0, 1))
    assert not torch.allclose(attackers, other)
    if method != "decoder":
        assert not torch.allclose(attackers, weights(started_reader(public(method), 1, 0)))


def test_a_method_that_starts_at_random_has_no_start() -> None:
    with pytest.raises(ValueError, match="random weights"):
        started_reader(public("decoder"), 1, 0)


def test_wrong_decoders_have_no_seed_of_a_training_but_the_one_that_is_asked_for() -> None:
    found = wrong_readings(public("gs_hider"), OBSERVED[:1], 2, 4, lambda: None)
    assert [(wrong.condition, wrong.seed) for wrong in found] == [
        (RANDOM, WRONG_SEEDS),
        (RANDOM, WRONG_SEEDS + 1),
        (OTHER_START, WRONG_SEEDS),
        (OTHER_START, WRONG_SEEDS + 1),
        (OWN_START, 4),
    ]


@pytest.mark.parametrize("method", SETTINGS)
def test_a_square_is_read_as_a_part_of_its_view(method: str) -> None:
    """View directions included; only near the square's border do convolutions see zeros instead."""
    reader = seeded_reader(public(method), 1, 1)
    row, column, side = 5, 3, 12
    margin = pixels_beyond(reader)
    inside = slice(margin, side - margin)
    whole = read(reader, OBSERVED[1])[:, row : row + side, column : column + side]
    square = read(reader, OBSERVED[1].crop(row, column, side, side))
    assert torch.allclose(whole[:, inside, inside], square[:, inside, inside], atol=1e-5)


@pytest.mark.parametrize(("method", "radius"), [("gs_hider", 3), ("homogeneous", 0), ("decoder", 3)])
def test_a_decoder_of_three_layers_sees_three_pixels_around(method: str, radius: int) -> None:
    assert pixels_beyond(seeded_reader(public(method), 1, 1)) == radius


def test_several_messages_are_told_apart() -> None:
    shown = read(seeded_reader(public("gs_hider"), 3, 0), OBSERVED[0])
    assert shown.shape == (3, HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("name", SETTINGS)
def test_methods_whose_decoders_can_read_are_not_refused(name: str) -> None:
    refuse_unreadable(build_method(name, {**SETTINGS[name], "messages": ["reef"]}))
    refuse_unreadable(public(name))


def test_a_method_whose_decoder_reads_something_else_is_refused_with_what_it_lacks() -> None:
    own = cast(Method, SimpleNamespace(name="mine", networks={MESSAGE_DECODER: torch.nn.Identity()}))
    with pytest.raises(UserError, match=r"cannot be probed.*CoupledFeatures, or read_off\(picture\)"):
        refuse_unreadable(own)
    own.networks = {}
    refuse_unreadable(own)  # 3DGS+SH has no message decoder

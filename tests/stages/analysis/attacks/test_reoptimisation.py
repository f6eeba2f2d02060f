"""The cover is trained further without the secret; the original and a frozen scene decoder stay unchanged."""

from __future__ import annotations

import pytest
import torch

from stages.analysis.attacks.reoptimisation import NETWORK_RATE, reoptimisation
from stages.analysis.attacks.target import Target
from stages.hiding.rendering import COVER
from stages.imaging.psnr import psnr
from tests.stages.analysis.attacks.containers import METHODS, knowledge, shown, target_and_owner


def decoder_of(target: Target) -> dict[str, torch.Tensor]:
    networks = target.method.networks
    return {name: values.clone() for name, values in networks["scene_decoder"].state_dict().items()} if networks else {}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("frozen", [False, True])
def test_the_cover_is_learnt_and_the_original_left_alone(method: str, frozen: bool) -> None:
    target, _ = target_and_owner(method)
    before = {name: values.clone() for name, values in target.gaussians.parameters.items()}
    decoder = decoder_of(target)
    known = knowledge()
    truth = known.views.truths(0)[COVER]
    attack = reoptimisation(8, frozen)(target, 0, known)
    early, late = attack(2), attack(8)
    quality = [psnr(shown(each, each.method)[COVER].detach(), truth) for each in (target, early, late)]
    assert quality[0] < quality[2]
    assert not torch.equal(early.gaussians.means, late.gaussians.means)
    assert all(torch.equal(values, target.gaussians[name]) for name, values in before.items())
    assert all(torch.equal(values, decoder_of(target)[name]) for name, values in decoder.items())
    changed = any(not torch.equal(values, decoder_of(late)[name]) for name, values in decoder.items())
    assert changed == (bool(decoder) and not frozen)
    assert not any(values.requires_grad for values in late.gaussians.parameters.values())
    if method == "sh":
        assert torch.equal(late.gaussians["message_sh_base"], target.gaussians["message_sh_base"])


def test_the_scene_decoder_learns_as_slowly_as_at_the_end_of_a_training() -> None:
    """Adam's first step is as long as its rate."""
    target, _ = target_and_owner("gs_hider")
    after = decoder_of(reoptimisation(2, frozen=False)(target, 0, knowledge())(1))
    step = max(float((after[name] - values).abs().max()) for name, values in decoder_of(target).items())
    assert step == pytest.approx(NETWORK_RATE, rel=1e-2)


def test_snapshots_are_those_of_one_run() -> None:
    target, _ = target_and_owner("gs_hider")
    once, again = (reoptimisation(6, frozen=True)(target, 3, knowledge()) for _ in range(2))
    once(3)
    features = once(6).gaussians["raw_features"]
    assert torch.equal(features, again(6).gaussians["raw_features"])
    assert torch.equal(features, once(6).gaussians["raw_features"])
    other = reoptimisation(6, frozen=True)(target, 4, knowledge())
    assert not torch.equal(features, other(6).gaussians["raw_features"])
    with pytest.raises(ValueError, match="no way back"):
        once(3)

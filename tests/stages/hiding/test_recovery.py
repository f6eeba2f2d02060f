"""What was done to a container as a whole is undone, all at once; what was left alone stays bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.hiding.coupled import FEATURES
from stages.hiding.recovery import Recovery, TooFewPairs, is_motion, recovered, unlike
from stages.hiding.stored_features import stored
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import mirrored, moved
from tests.stages.scene.test_registration import COUNT, motion, pruned, scene

CHANNELS = 6
SAME = 2e-4
"""Of activated features: `FARTHEST` cuts off as much."""


def container(seed: int = 0, count: int = COUNT) -> Gaussians:
    """Coupled features with a mean other than 0.5, as trained ones have, and harmonics of cover and messages."""
    generator = torch.Generator().manual_seed(seed + 100)
    attributes = {
        FEATURES: 0.8 * torch.randn(count, CHANNELS, generator=generator) + torch.linspace(-1, 1, CHANNELS),
        "sh_rest": torch.randn(count, 8, 3, generator=generator),
        "message_sh_rest": torch.randn(count, 2, 8, 3, generator=generator),
    }
    return scene(seed, count).with_parameters(attributes)


def mixed(gaussians: Gaussians, seed: int) -> Gaussians:
    """Features rotated about 0.5 and drawn halfway to it, their channels then permuted, as an attacker may do."""
    generator = torch.Generator().manual_seed(seed)
    turn = torch.linalg.qr(torch.randn(CHANNELS, CHANNELS, generator=generator, dtype=torch.float64)).Q
    centred = 0.5 * (gaussians[FEATURES].double().sigmoid() - 0.5) @ turn
    order = torch.randperm(CHANNELS, generator=generator)
    return gaussians.with_parameters({FEATURES: stored(0.5 + centred)[:, order]})


def check(recovery: Recovery | None, expected: Gaussians) -> Recovery:
    """Check that the same Gaussians came back, in their order."""
    assert recovery is not None
    back = recovery.gaussians
    assert set(back.parameters) == set(expected.parameters)
    assert torch.allclose(back.means, expected.means, atol=1e-4)
    assert torch.allclose(back[FEATURES].sigmoid(), expected[FEATURES].sigmoid(), atol=SAME)
    quats = [torch.nn.functional.normalize(each.quats, dim=-1) for each in (back, expected)]
    assert torch.allclose((quats[0] * quats[1]).sum(dim=-1).abs(), torch.ones(len(expected)), atol=1e-5)
    for name in ("log_scales", "sh_rest", "message_sh_rest", "logit_opacities"):
        assert torch.allclose(back[name], expected[name], atol=1e-3), name
    return recovery


@pytest.mark.parametrize("scale", [1.0, 3.0])
@pytest.mark.parametrize("share", [0.05, 0.25])
def test_all_at_once(share: float, scale: float) -> None:
    published, way = container(), motion(1, scale)
    left = pruned(published, share)
    recovery = check(recovered(moved(mixed(left, 2), way), published, 0), left)
    assert recovery.changed
    assert recovery.matched == 1
    assert recovery.motion.scale == pytest.approx(scale)
    assert recovery.degrees == pytest.approx(np.rad2deg(Rotation.from_matrix(way.rotation).magnitude()), abs=1e-3)
    middle = np.median(published.means.double().numpy(), axis=0)
    assert recovery.shift == pytest.approx(np.linalg.norm(way.points(middle[None]) - middle) / scale, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_turn_of_features_and_world(seed: int) -> None:
    published = container(0, 500)
    left = pruned(published, 0.25, seed)
    check(recovered(moved(mixed(left, seed), motion(seed)), published, seed), left)


def test_what_was_not_touched_stays_bit_for_bit() -> None:
    published = container()
    for found in (published, pruned(published, 0.6)):
        recovery = recovered(found, published, 0)
        assert recovery is not None
        assert not recovery.changed
        assert (recovery.degrees, recovery.shift, recovery.feature_change) == (0, 0, 0)
        assert all(torch.equal(recovery.gaussians[name], values) for name, values in found.parameters.items())


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_a_mirror_image_is_turned_round(share: float) -> None:
    published, way = container(), motion(11, 2.0)
    left = pruned(published, share)
    recovery = check(recovered(mirrored(moved(mixed(left, 11), way)), published, 0), left)
    assert recovery.mirrored
    assert recovery.matched == 1
    alone = recovered(mirrored(published), published, 0)
    assert alone is not None
    assert alone.changed
    assert not is_motion(alone.motion)
    assert torch.equal(alone.gaussians.means, published.means)
    assert torch.equal(alone.gaussians.quats, published.quats)


def test_a_mirror_image_of_which_each_was_shifted_is_known_by_shapes() -> None:
    published = container()
    image = mirrored(published)
    noise = 0.015 * torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0))
    recovery = recovered(image.with_parameters({"means": image.means + noise}), published, 0)
    assert recovery is not None
    assert recovery.mirrored
    assert recovery.is_certain


@pytest.mark.parametrize("shift", [1.0, 30.0])
def test_what_was_shifted_too_far_for_any_motion_is_known_by_shapes_for_certain(shift: float) -> None:
    published = container()
    found = mixed(published, 6)
    noise = shift * torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0))
    found = found.with_parameters({"means": found.means + noise})
    recovery = recovered(found, published, 0)
    assert recovery is not None
    assert recovery.is_certain
    assert recovery.found_again > 0.99
    assert not recovery.mirrored
    assert not is_motion(recovery.motion)
    assert torch.equal(recovery.gaussians.means, found.means)
    assert torch.allclose(recovery.gaussians[FEATURES].sigmoid(), published[FEATURES].sigmoid(), atol=SAME)


@pytest.mark.parametrize("as_it_was", [0.3, 0.7])
def test_of_both_the_mirror_image_and_what_is_not_the_larger_part_counts(as_it_was: float) -> None:
    published = container()
    image, count = mirrored(published), round(as_it_was * COUNT)
    parts = {name: torch.cat([values[:count], image[name][count:]]) for name, values in published.parameters.items()}
    noise = 0.015 * torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0))
    recovery = recovered(Gaussians(parts | {"means": parts["means"] + noise}), published, 0)
    assert recovery is not None
    assert recovery.mirrored == (as_it_was < 0.5)


def test_only_what_was_changed_is_changed_back() -> None:
    published = container()
    turned = recovered(moved(published, motion(3)), published, 0)
    assert turned is not None
    assert torch.equal(turned.gaussians[FEATURES], published[FEATURES])
    assert turned.feature_change == 0
    remixed = recovered(mixed(published, 3), published, 0)
    assert remixed is not None
    assert torch.equal(remixed.gaussians.means, published.means)
    assert torch.equal(remixed.gaussians["sh_rest"], published["sh_rest"])
    difference = mixed(published, 3)[FEATURES].sigmoid() - published[FEATURES].sigmoid()
    assert remixed.feature_change == pytest.approx(float(difference.square().mean().sqrt()), rel=1e-3)


def test_features_of_a_few_do_not_mislead() -> None:
    """A third of the Gaussians lose their features after all were mixed; the others come back."""
    published = container()
    found = mixed(published, 4)
    features = found[FEATURES].clone()
    features[: COUNT // 3] = 3.0
    recovery = recovered(found.with_parameters({FEATURES: features}), published, 0)
    assert recovery is not None
    back, expected = (each[FEATURES][COUNT // 3 :].sigmoid() for each in (recovery.gaussians, published))
    assert torch.allclose(back, expected, atol=5e-3)


def test_clones_and_foreign_gaussians_are_carried_along() -> None:
    published, foreign = container(), container(9, 400)
    clones = published.select(torch.arange(300))
    together = Gaussians(
        {name: torch.cat([published[name], clones[name], foreign[name]]) for name in foreign.parameters}
    )
    recovery = check(recovered(moved(mixed(together, 5), motion(5)), published, 0), together)
    assert recovery.matched == pytest.approx((COUNT + 300) / (COUNT + 700), abs=0.01)


def test_noise_on_features_is_no_map() -> None:
    published = container()
    noise = 0.1 * torch.randn(COUNT, CHANNELS, generator=torch.Generator().manual_seed(0))
    found = published.with_parameters({FEATURES: published[FEATURES] + noise})
    recovery = recovered(found, published, 0)
    assert recovery is not None
    assert not recovery.changed


@pytest.mark.parametrize("pairs", range(2 * (CHANNELS + 1), 4 * CHANNELS, 3))
def test_noise_on_features_of_a_few_is_no_map(pairs: int) -> None:
    """A map fitted to so few pairs would follow their noise and be far off for all others."""
    few = container().select(torch.arange(pairs))
    noise = 0.1 * torch.randn(pairs, CHANNELS, generator=torch.Generator().manual_seed(0))
    recovery = recovered(few.with_parameters({FEATURES: few[FEATURES] + noise}), container(), 0)
    assert recovery is not None
    assert recovery.feature_change < 0.03, "no more than the noise, a fortieth of an activated feature"


def test_noise_on_places_leaves_features_to_shapes() -> None:
    published = container()
    found = moved(mixed(published, 6), motion(6))
    noise = 0.015 * torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0))
    recovery = recovered(found.with_parameters({"means": found.means + noise}), published, 0)
    assert recovery is not None
    assert recovery.is_certain
    assert torch.allclose(recovery.gaussians[FEATURES].sigmoid(), published[FEATURES].sigmoid(), atol=SAME)


def test_channels_that_were_left_out_are_told_by_the_others() -> None:
    published = container()
    features = published[FEATURES].double().sigmoid()
    features[:, -1] = 0.2 + 0.3 * features[:, 0] + 0.2 * features[:, 1]
    published = published.with_parameters({FEATURES: stored(features)})
    found = published.with_parameters({FEATURES: published[FEATURES][:, :-1]})
    recovery = check(recovered(found, published, 0), published)
    assert recovery.gaussians[FEATURES].shape == published[FEATURES].shape
    assert unlike(found.parameters, published.parameters) == ()
    few = torch.arange(3 * CHANNELS - 1)
    with pytest.raises(TooFewPairs) as told:
        recovered(found.select(few), published.select(few), 0)
    assert told.value.is_certain
    assert told.value.pairs == told.value.needed - 1


def test_splats_without_features() -> None:
    published = Gaussians({name: values for name, values in container().parameters.items() if name != FEATURES})
    recovery = recovered(moved(published, motion(7)), published, 0)
    assert recovery is not None
    assert torch.allclose(recovery.gaussians["message_sh_rest"], published["message_sh_rest"], atol=1e-3)
    assert recovery.feature_change == 0


def test_nothing_is_recovered_of_what_does_not_match() -> None:
    published = container()
    assert recovered(container(1), published, 0) is None
    assert recovered(published.select(torch.arange(0)), published, 0) is None


def test_seeds_repeat() -> None:
    published = container()
    found = moved(mixed(pruned(published, 0.2), 8), motion(8))
    once, again = (recovered(found, published, 1) for _ in range(2))
    assert once is not None
    assert again is not None
    assert all(torch.equal(values, again.gaussians[name]) for name, values in once.gaussians.parameters.items())


def test_attributes_that_differ_are_named() -> None:
    published = container().parameters
    without = {name: values for name, values in published.items() if name != "quats"}
    assert unlike(without | {"sh_rest": published["sh_rest"][:, :3]}, published) == ("quats", "sh_rest")
    assert unlike(published, published) == ()

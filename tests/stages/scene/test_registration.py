"""Gaussians that were moved as a whole are recognised, whatever else was done to them; others are not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import moved
from stages.scene.registration import Registration, register, register_scattered
from stages.scene.similarity import Similarity

COUNT = 1500


def scene(seed: int, count: int = COUNT) -> Gaussians:
    """A few clusters in wide surroundings, with sizes and opacities as varied as trained ones."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(8, 3, generator=generator)
    means = centres[torch.randint(8, (count,), generator=generator)] + 0.3 * torch.randn(count, 3, generator=generator)
    means[: count // 5] *= 4
    return Gaussians(
        {
            "means": means,
            "quats": torch.randn(count, 4, generator=generator),
            "log_scales": torch.randn(count, 3, generator=generator) - 4,
            "logit_opacities": 2 * torch.randn(count, generator=generator),
        }
    )


def motion(seed: int, scale: float = 1.0) -> Similarity:
    generator = np.random.default_rng(seed)
    return Similarity(scale, Rotation.random(rng=generator).as_matrix(), generator.normal(scale=3, size=3))


def pruned(gaussians: Gaussians, share: float, seed: int = 0) -> Gaussians:
    order = torch.randperm(len(gaussians), generator=torch.Generator().manual_seed(seed))
    return gaussians.select(order[round(share * len(gaussians)) :])


def shaken(gaussians: Gaussians, name: str, sigma: float) -> Gaussians:
    noise = torch.randn(gaussians[name].shape, generator=torch.Generator().manual_seed(7))
    return gaussians.with_parameters({name: gaussians[name] + sigma * noise})


def is_identity(found: Similarity) -> bool:
    return found.scale == 1 and np.array_equal(found.rotation, np.eye(3)) and not found.translation.any()


def check(found: Registration | None, expected: Similarity, tolerance: float = 1e-5) -> Registration:
    assert found is not None
    np.testing.assert_allclose(found.motion.rotation, expected.rotation, atol=tolerance)
    np.testing.assert_allclose(found.motion.translation, expected.translation, atol=10 * tolerance)
    assert found.motion.scale == pytest.approx(expected.scale, abs=tolerance)
    return found


@pytest.mark.parametrize("scale", [1.0, 0.2, 5.0])
@pytest.mark.parametrize("share", [0.05, 0.25, 0.8])
def test_a_moved_and_pruned_scene_is_registered_and_every_pair_is_right(share: float, scale: float) -> None:
    published, expected = scene(0), motion(1, scale)
    left = pruned(published, share)
    found = check(register(moved(left, expected), published, 0), expected)
    assert found.matched == 1
    assert len(found.found) == len(left)
    assert torch.equal(left.means[found.found], published.means[found.published])
    if scale == 1:
        assert found.motion.scale == 1, "a scale is told only where there is one"


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), degrees=st.floats(0, 180), shift=st.floats(0, 100))
def test_any_rigid_motion_is_found(seed: int, degrees: float, shift: float) -> None:
    generator = np.random.default_rng(seed)
    axis, way = (values / np.linalg.norm(values) for values in generator.normal(size=(2, 3)))
    expected = Similarity(1.0, Rotation.from_rotvec(np.deg2rad(degrees) * axis).as_matrix(), shift * way)
    check(register(moved(scene(seed % 5, 400), expected), scene(seed % 5, 400), 0), expected, 1e-4)


def test_what_was_not_moved_has_exactly_the_identity() -> None:
    published = scene(0)
    for found in (published, pruned(published, 0.9), shaken(published, "means", 1e-4)):
        registration = register(found, published, 0)
        assert registration is not None
        assert is_identity(registration.motion)
        assert registration.matched == 1


def test_a_turn_too_small_for_places_to_tell_is_found_all_the_same() -> None:
    published = scene(0)
    expected = Similarity(1.0, Rotation.from_rotvec([0, 1e-4, 0]).as_matrix(), np.zeros(3))
    check(register(moved(published, expected), published, 0), expected, 1e-7)


@pytest.mark.parametrize("expected", [Similarity.identity(), motion(3)])
def test_single_places_may_be_noisy(expected: Similarity) -> None:
    """Shapes decide then; pairs are right, and the motion is as exact as the noise allows."""
    published = scene(0)
    sigma = 0.015
    found = shaken(moved(published, expected), "means", sigma)
    registration = check(register(found, published, 0), expected, 3 * sigma / np.sqrt(COUNT))
    assert registration.is_certain
    assert registration.matched > 0.8
    assert len(registration.found) > 0.8 * COUNT
    assert np.mean(registration.found == registration.published) > 0.99
    assert is_identity(registration.motion) == is_identity(expected)


def test_where_places_and_shapes_are_noisy_it_is_known_but_not_for_certain() -> None:
    """It could be another training from the same photos, which would have other shapes."""
    published = scene(0)
    found = shaken(shaken(published, "means", 0.015), "log_scales", 0.2)
    registration = check(register(found, published, 0), Similarity.identity(), 0.01)
    assert not registration.is_certain
    assert registration.matched < 0.25


def test_shapes_are_certain_where_hardly_any_agree_on_a_motion() -> None:
    """Each was shifted by itself, so far that less than a quarter lie within reach of the motion that they agree on."""
    published = scene(0)
    registration = register(shaken(published, "means", 0.06), published, 0)
    assert registration is not None
    assert registration.is_certain
    assert registration.matched < 0.25


@pytest.mark.parametrize(("share", "is_known"), [(0.2, False), (0.3, True)])
def test_what_was_scattered_is_known_if_a_quarter_kept_their_shapes(share: float, is_known: bool) -> None:
    published = scene(0)
    scattered = shaken(published, "means", 30.0)
    other = shaken(scattered, "log_scales", 1.0)
    kept = torch.arange(COUNT) < share * COUNT
    sizes = torch.where(kept[:, None], scattered["log_scales"], other["log_scales"])
    found = scattered.with_parameters({"log_scales": sizes})
    assert register(found, published, 0) is None
    registration = register_scattered(found, published, 0)
    assert (registration is not None) == is_known
    assert register_scattered(scene(5), published, 0) is None
    assert register_scattered(pruned(published, 1.0), published, 0) is None
    if registration is not None:
        assert registration.is_certain
        assert is_identity(registration.motion)
        assert np.mean(registration.found == registration.published) > 0.99


@pytest.mark.parametrize("kinds", [1, 3])
def test_points_of_a_few_usual_sizes_are_not_known_by_these(kinds: int) -> None:
    """As converters make them of any point cloud."""
    usual = {
        "log_scales": torch.arange(kinds).repeat(COUNT // kinds)[:, None].expand(-1, 3) * 0.5 - 4.0,
        "logit_opacities": torch.full((COUNT,), 2.0),
    }
    published, stranger = (scene(seed).with_parameters(usual) for seed in (0, 5))
    assert register(stranger, published, 0) is None
    assert register_scattered(stranger, published, 0) is None


def test_a_scattered_scene_may_be_moved_too() -> None:
    published, expected = scene(0), motion(6)
    found = shaken(moved(published, expected), "means", 1.0)
    registration = register_scattered(found, published, 0)
    check(registration, expected, 4 / np.sqrt(COUNT))


def test_sizes_may_be_noisy_and_axes_change_places() -> None:
    published, expected = scene(0), motion(4)
    found = shaken(moved(published, expected), "log_scales", 0.03)
    check(register(found, published, 0), expected)
    turned = found.with_parameters({"log_scales": found["log_scales"][:, [2, 0, 1]]})
    check(register(turned, published, 0), expected)


def test_doubled_and_foreign_gaussians_do_not_disturb() -> None:
    published, expected = scene(0), motion(5)
    clones, foreign = published.select(torch.arange(500)), scene(9, COUNT)
    together = Gaussians(
        {name: torch.cat([published[name], clones[name], foreign[name]]) for name in foreign.parameters}
    )
    registration = check(register(moved(together, expected), published, 0), expected)
    assert registration.matched == pytest.approx((COUNT + 500) / (2 * COUNT + 500), abs=0.01)
    ours = registration.found < COUNT
    np.testing.assert_array_equal(registration.found[ours], registration.published[ours])


def flooded(gaussians: Gaussians, times: int) -> Gaussians:
    """The Gaussians among `times` as many foreign ones around the same places."""
    foreign = scene(9, times * len(gaussians))
    return Gaussians({name: torch.cat([gaussians[name], foreign[name]]) for name in foreign.parameters})


@pytest.mark.parametrize("times", [4, 40])
@pytest.mark.parametrize("expected", [Similarity.identity(), motion(5)])
def test_foreign_gaussians_may_be_the_majority(expected: Similarity, times: int) -> None:
    """Every published Gaussian is there, so places decide."""
    published = scene(0, 500)
    registration = check(register(moved(flooded(published, times), expected), published, 0), expected)
    assert registration.matched == pytest.approx(1 / (1 + times), abs=0.01)
    assert registration.found_again == 1
    assert registration.is_certain
    assert is_identity(registration.motion) == is_identity(expected)


def test_a_fragment_among_foreign_gaussians_is_known_but_not_for_certain() -> None:
    """Few of the found Gaussians are published ones, and few of the published ones are found."""
    published, expected = scene(0), motion(6)
    few = flooded(pruned(published, 0.8), 9)
    registration = check(register(moved(few, expected), published, 0), expected)
    assert registration.found_again == pytest.approx(0.2, abs=0.01)
    assert registration.matched == pytest.approx(0.1, abs=0.01)
    assert not registration.is_certain
    left = register(moved(pruned(published, 0.8), expected), published, 0)
    assert left is not None
    assert left.is_certain


@pytest.mark.parametrize(("share", "is_certain"), [(0.23, False), (0.27, True)])
@pytest.mark.parametrize("expected", [Similarity.identity(), motion(6)])
def test_it_takes_a_quarter_among_foreign_gaussians_to_be_certain(
    expected: Similarity, share: float, is_certain: bool
) -> None:
    """To avoid it, a thief would have to leave out three quarters of what was stolen."""
    published = scene(0)
    found = flooded(pruned(published, 1 - share), 9)
    registration = check(register(moved(found, expected), published, 0), expected)
    assert registration.found_again == pytest.approx(share, abs=0.01)
    assert registration.is_certain == is_certain


def test_a_moved_scene_may_have_been_made_more_transparent() -> None:
    """As an editor's slider does; among so many shapes, those of other opacities are nearer than one's own."""
    published, expected = scene(0, 30_000), motion(1)
    opacities = torch.logit(0.5 * torch.sigmoid(published["logit_opacities"].double())).float()
    faded = published.with_parameters({"logit_opacities": opacities})
    assert check(register(moved(faded, expected), published, 0), expected, 1e-4).is_certain
    assert register(moved(faded, expected), scene(5, 30_000), 0) is None


def test_few_gaussians_in_a_crowd_are_known_and_not_taken_for_others() -> None:
    published, crowd = scene(0, 300), scene(1, 200_000)
    for seed in range(3):
        for registered in (register, register_scattered):
            assert registered(crowd, published, seed) is None, "any shape of a few is near one of so many"
    own = moved(published, motion(2))
    among = Gaussians({name: torch.cat([own[name], crowd[name]]) for name in own.parameters})
    assert check(register(among, published, 0), motion(2), 1e-4).is_certain


def test_many_foreign_gaussians_do_not_lie_where_published_ones_do_by_chance() -> None:
    """Of a thousand times as many foreign Gaussians, one or another lies nearly everywhere."""
    published = scene(0, 100)
    assert register(scene(0, 100_000), published, 0) is None, "about the same places"


def test_it_takes_ten_gaussians() -> None:
    published = scene(0)
    for count in (1, 3, 9):
        assert register(published.select(torch.arange(count)), published, 0) is None
    registration = register(published.select(torch.arange(10)), published, 0)
    assert registration is not None
    assert registration.is_certain


def test_what_has_nothing_to_do_with_it_is_not_recognised() -> None:
    published = scene(0)
    for other in (scene(1), scene(1, 40), moved(scene(2), motion(1, 3.0)), pruned(published, 0.997)):
        assert register(moved(other, motion(6)), published, 0) is None
    assert register(published.select(torch.arange(0)), published, 0) is None
    assert register(published, published.select(torch.arange(0)), 0) is None


def test_gaussians_all_at_one_place_are_no_scene() -> None:
    published = scene(0)
    heap = published.with_parameters({"means": torch.ones(COUNT, 3)})
    assert register(heap, published, 0) is None
    assert register(published, heap, 0) is None
    tiny = moved(scene(1), Similarity(1e-9, np.eye(3), published.means[0].double().numpy()))
    assert register(tiny, published, 0) is None, "all lie where one published Gaussian does"


def test_seeds_repeat() -> None:
    published, found = scene(0), shaken(moved(scene(0), motion(2)), "means", 0.02)
    once, again = (register(found, published, 3) for _ in range(2))
    assert once is not None
    assert again is not None
    assert np.array_equal(once.motion.rotation, again.motion.rotation)
    assert np.array_equal(once.motion.translation, again.motion.translation)
    assert np.array_equal(once.found, again.found)


@pytest.mark.parametrize("share", [0.5, 0.7])
@pytest.mark.parametrize("expected", [Similarity.identity(), motion(6), motion(6, 3.0)])
def test_places_shared_with_another_training_do_not_make_it_yours(expected: Similarity, share: float) -> None:
    """Trainings from the same photos start from the same points; what a copy has beside them is its shapes."""
    published = scene(0)
    shared = torch.arange(COUNT) < share * COUNT
    means = torch.where(shared[:, None], published.means, scene(3).means)
    trained = scene(3).with_parameters({"means": means})
    registration = register(trained, published, 0)
    assert registration is not None
    assert registration.matched == pytest.approx(share, abs=0.01)
    assert not registration.is_certain
    copied = published.with_parameters({"means": means})
    assert check(register(moved(copied, expected), published, 0), expected).is_certain
    reshaped = scene(3).with_parameters({"means": published.means})
    assert check(register(reshaped, published, 0), Similarity.identity()).is_certain, "all of its places are"


@pytest.mark.parametrize(("share", "is_certain"), [(0.05, False), (0.15, True)])
def test_a_tenth_of_shapes_beside_shared_places_makes_it_yours(share: float, is_certain: bool) -> None:
    """A few shapes may be alike by chance, or because neither training has changed them."""
    published, trained = scene(0), scene(3)
    rows = torch.arange(COUNT)
    shared, copied = rows < 0.5 * COUNT, rows < 0.5 * share * COUNT
    places = {"means": torch.where(shared[:, None], published.means, trained.means)}
    sizes = {"log_scales": torch.where(copied[:, None], published["log_scales"], trained["log_scales"])}
    opacities = {"logit_opacities": torch.where(copied, published["logit_opacities"], trained["logit_opacities"])}
    registration = register(trained.with_parameters(places | sizes | opacities), published, 0)
    assert registration is not None
    assert registration.is_certain == is_certain

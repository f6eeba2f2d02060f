"""Covers are decoded with the attacker's scene decoder, messages with the secret; renders may be attacked too."""

from __future__ import annotations

import copy
import weakref
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from stages.analysis.attacks.calibration import TOLERANCE
from stages.analysis.attacks.catalogue import ATTACKS, ONE_COLOUR, UNATTACKED, AttackName, restored
from stages.analysis.attacks.curves import Assay
from stages.analysis.attacks.registry import attacks
from stages.analysis.attacks.renders import jpeg, resizing
from stages.analysis.attacks.scoring import Scorer
from stages.analysis.attacks.target import Attack, Attacker, Knowledge, Target
from stages.hiding.method import build_method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.imaging.pictures import picture_to_tensor, tensor_to_picture
from stages.scene.message_views import MessageViews
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, cameras, knowledge, scene, target_and_owner
from tests.stages.small import HEIGHT, NAMES, VIEWS, WIDTH, pictures


def views() -> dict[str, MessageViews]:
    coverage = np.ones((VIEWS, HEIGHT, WIDTH), np.float32)
    nothing = np.zeros((0, 3), np.float32)
    return {MESSAGE: MessageViews(MESSAGE, NAMES, pictures(1), nothing, nothing.astype(np.uint8), coverage)}


def assay(method: str, **changes: object) -> Assay:
    target, owner = target_and_owner(method)
    seen = photographs(target.gaussians, target.method, cameras())
    true = replace(scene(), pictures=np.stack([tensor_to_picture(each.pictures[COVER]) for each in seen]))
    scorer = Scorer(owner, true, views(), NAMES[:2])
    usual = Assay(target, scorer, knowledge(), method, (0.5, 2.0), (0, 1), {}, lambda: None)
    return replace(usual, **changes)  # type: ignore[arg-type]


def test_every_attack_is_described() -> None:
    assert list(attacks((1,))) != []
    assert set(attacks((1,))) == set(ATTACKS) == set(AttackName.__args__)


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("noise_positions", "means"),
        ("noise_rotations", "quats"),
        ("noise_scales", "log_scales"),
        ("noise_opacities", "logit_opacities"),
        ("noise_colours", "raw_features"),
    ],
)
def test_noise_is_on_what_its_name_says(name: AttackName, changed: str) -> None:
    target, _ = target_and_owner("gs_hider")
    target = target.with_parameters({"quats": torch.randn(200, 4, generator=torch.Generator().manual_seed(0))})
    attacked = attacks((1,))[name].prepare(target, 0, knowledge())(0.1).gaussians
    parameters = target.gaussians.parameters
    assert {each for each, values in parameters.items() if not torch.equal(attacked[each], values)} == {changed}


@pytest.mark.parametrize(("name", "is_frozen"), [("reoptimisation", False), ("reoptimisation_frozen", True)])
def test_reoptimisation_is_measured_on_its_way_with_the_scene_decoder_as_its_name_says(
    name: AttackName, is_frozen: bool
) -> None:
    target, _ = target_and_owner("gs_hider")
    attack = attacks((3, 1))[name]
    assert attack.severities is not None
    assert attack.severities(target) == (1, 3)
    attacked = attack.prepare(target, 0, knowledge())(1)
    before, after = (each.method.networks["scene_decoder"].state_dict() for each in (target, attacked))
    assert all(torch.equal(values, after[each]) for each, values in before.items()) == is_frozen


def test_the_cover_is_the_attackers_and_the_message_the_owners() -> None:
    each = assay("gs_hider")
    broken = copy.deepcopy(each.target.method)
    for weight in broken.networks["scene_decoder"].parameters():
        weight.zero_()
    before = each.scorer.figures(each.target)
    after = each.scorer.figures(replace(each.target, method=broken))
    assert after[None, "psnr"] != before[None, "psnr"]
    assert after[MESSAGE, "psnr"] == before[MESSAGE, "psnr"]
    assert each.scorer.figures(each.target) == before
    assert each.scorer.cover_psnr(each.target) == before[None, "psnr"]


def test_messages_are_read_after_opening_and_the_cover_as_it_is_published() -> None:
    each = assay("gs_hider")
    half = each.target.keeping(torch.arange(100))
    owner = Scorer(each.scorer.owner, each.scorer.scene, views(), NAMES[:2], opened=lambda gaussians: half.gaussians)
    found, sealed, opened = owner.figures(each.target), each.scorer.figures(each.target), each.scorer.figures(half)
    assert found[None, "psnr"] == sealed[None, "psnr"] != opened[None, "psnr"]
    assert found[MESSAGE, "psnr"] == opened[MESSAGE, "psnr"] != sealed[MESSAGE, "psnr"]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("hurt", ["jpeg", "resizing"])
def test_only_a_message_that_is_read_off_renders_is_hurt_with_them(method: str, hurt: str) -> None:
    each = assay(method)
    attacked = jpeg(each.target, 20) if hurt == "jpeg" else resizing(each.target, 3)
    before, after = each.scorer.figures(each.target), each.scorer.figures(attacked)
    assert after[None, "psnr"] != before[None, "psnr"]
    assert (after[MESSAGE, "psnr"] != before[MESSAGE, "psnr"]) == (method == "decoder")
    assert attacks((1,))["jpeg"].applies(each.target) == (method == "decoder")


@pytest.mark.parametrize(("hurt", "weak", "strong"), [(jpeg, 95, 10), (resizing, 1.25, 4)])
def test_stronger_distortions_of_renders_cost_the_cover_more(
    hurt: Callable[[Target, float], Target], weak: float, strong: float
) -> None:
    each = assay("sh")
    assert each.scorer.cover_psnr(hurt(each.target, weak)) > each.scorer.cover_psnr(hurt(each.target, strong)) + 1


def test_a_curve_has_its_damage_and_its_seeds() -> None:
    each = assay("homogeneous")
    unharmed = each.scorer.cover_psnr(each.target)
    rows = [row for row in each.curve("noise_colours", attacks((1,))["noise_colours"]) if row.quantity == "psnr"]
    covers = {(row.severity, row.seed): row.value for row in rows if row.message is None}
    assert len(covers) == 4
    assert {seed for _, seed in covers} == {0, 1}
    losses = sorted(unharmed - value for (_, seed), value in covers.items() if seed == 0)
    assert losses == pytest.approx(list(each.cover_losses), rel=TOLERANCE)
    assert all(covers[severity, 0] != covers[severity, 1] for severity, _ in covers), "each seed has its own noise"
    assert {row.message for row in rows} == {None, MESSAGE}


@pytest.mark.parametrize(("name", "method"), [("rigid_motion", "homogeneous"), ("channel_permutation", "gs_hider")])
def test_the_owner_restores_what_the_attacker_moved(name: AttackName, method: str) -> None:
    each = assay(method)
    before = each.scorer.figures(each.target)
    rows = list(each.curve(name, attacks((1,))[name]))
    assert {row.condition for row in rows} == {name, restored(name)}
    messages = [row for row in rows if row.message == MESSAGE and row.quantity == "psnr"]
    unharmed = before[MESSAGE, "psnr"]
    assert max(abs(row.value - unharmed) for row in messages if row.condition == name) > 0.1
    back = [row.value for row in messages if row.condition == restored(name)]
    assert back == pytest.approx([unharmed] * len(back), abs=0.02)
    assert len(back) == len(messages) / 2


def test_where_there_is_nothing_to_restore_the_figures_are_those_as_found(monkeypatch: pytest.MonkeyPatch) -> None:
    each = assay("homogeneous", perceptual={"lpips_vgg": lambda picture, truth: 0.5})
    rendered: list[object] = []
    figures = Scorer.figures

    def counted(*given: object) -> object:
        rendered.append(given)
        return figures(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(Scorer, "figures", counted)
    rows = list(each.curve("sequential_pruning", attacks((1,))["sequential_pruning"]))
    found = {(row.severity, row.message, row.quantity): row.value for row in rows if row.condition == rows[0].condition}
    back = {(row.severity, row.message, row.quantity): row.value for row in rows if row.condition != rows[0].condition}
    assert rows[0].condition == "sequential_pruning"
    assert len(rendered) == len({row.severity for row in rows})
    assert back == {key: value for key, value in found.items() if key[2] != "lpips_vgg"}
    assert any(quantity == "lpips_vgg" for _, _, quantity in found)


def test_perceptual_figures_are_those_before_attacks_and_at_fixed_severities_with_the_first_seed() -> None:
    each = assay("sh", perceptual={"lpips_vgg": lambda picture, truth: 0.5}, cover_losses=(0.5,))
    pruning = attacks((1,))["random_pruning"]
    rows = list(each.curve("random_pruning", pruning))
    found = {(row.severity, row.seed) for row in rows if row.quantity == "lpips_vgg"}
    assert found == {(share, 0) for share in pruning.fixed}
    assert {row.severity for row in rows} > set(pruning.fixed)
    assert [row.value for row in each.unattacked() if row.quantity == "lpips_vgg"] == [0.5]


def test_of_renders_nothing_is_restored() -> None:
    rows = assay("decoder").curve("jpeg", attacks((1,))["jpeg"])
    assert {row.condition for row in rows} == {"jpeg"}


def test_what_has_no_features_is_not_attacked_there() -> None:
    assert list(assay("sh").curve("channel_dropping", attacks((1,))["channel_dropping"])) == []
    assert {row.condition for row in assay("sh").unattacked()} == {UNATTACKED}


def test_one_colour_is_the_best_one() -> None:
    each = assay("gs_hider")
    [(key, value)] = each.scorer.one_colour().items()
    assert key == (MESSAGE, ONE_COLOUR)
    truths = [picture_to_tensor(pictures(1)[row]) for row in range(2)]
    best = [-10 * np.log10(float(truth.double().var(dim=(0, 1), correction=0).mean())) for truth in truths]
    assert value == pytest.approx(np.mean(best), abs=1e-4)
    assert [row.value for row in each.unattacked() if row.quantity == ONE_COLOUR] == [value]


def test_a_view_that_shows_nothing_of_the_message_does_not_count_for_it() -> None:
    each = assay("gs_hider")
    blank, coverage = pictures(1).copy(), np.ones((VIEWS, HEIGHT, WIDTH), np.float32)
    blank[1], coverage[1] = 0, 0
    message = replace(views()[MESSAGE], pictures=blank, coverage=coverage)
    both = Scorer(each.scorer.owner, each.scorer.scene, {MESSAGE: message}, NAMES[:2])
    first = Scorer(each.scorer.owner, each.scorer.scene, {MESSAGE: message}, NAMES[:1])
    assert both.one_colour() == first.one_colour()
    assert both.figures(each.target)[MESSAGE, "psnr"] == first.figures(each.target)[MESSAGE, "psnr"]


def test_a_view_of_the_cover_that_cannot_be_rendered_is_no_view_that_is_spared() -> None:
    each, seen = assay("gs_hider"), iter(range(10))

    def broken_second(picture: torch.Tensor) -> torch.Tensor:
        return picture if next(seen) % 2 == 0 else picture / 0 * 0

    attacked = replace(each.target, on_pictures=broken_second)
    assert np.isnan(each.scorer.cover_psnr(attacked))
    assert np.isnan(each.scorer.figures(attacked)[None, "psnr"])


def test_messages_are_read_off_renders_in_the_order_of_the_secret() -> None:
    """Regardless of the order in which they are given, and of how many are."""
    target, _ = target_and_owner("decoder")
    torch.manual_seed(0)
    owner = build_method("decoder", {**target.method.settings, "messages": ("b", "a")})
    hurt = jpeg(target, 95)
    both = {name: replace(views()[MESSAGE], name=name, pictures=pictures(seed)) for name, seed in (("a", 1), ("b", 2))}
    found = [
        Scorer(owner, scene(), {name: both[name] for name in names}, NAMES[:2]).figures(hurt)
        for names in (("a", "b"), ("b", "a"), ("a",))
    ]
    assert found[0] == found[1]
    assert found[0]["a", "psnr"] == found[2]["a", "psnr"]


def test_what_has_no_chance_is_measured_once() -> None:
    rows = list(assay("gs_hider").curve("quantisation", attacks((1,))["quantisation"]))
    assert {row.seed for row in rows} == {0}
    assert torch.tensor([row.value for row in rows]).isfinite().all()


def test_the_training_of_one_seed_is_gone_before_that_of_the_next_begins() -> None:
    """With millions of Gaussians a GPU holds no three at once."""
    alive: weakref.WeakSet[Running] = weakref.WeakSet()
    most = 0

    class Running:
        def __init__(self, target: Target):
            self.target = target

        def __call__(self, severity: float) -> Target:
            return self.target

    def prepare(target: Target, seed: int, known: Knowledge) -> Attacker:
        nonlocal most
        running = Running(target)
        alive.add(running)
        most = max(most, len(alive))
        return running

    measured = assay("sh", seeds=(0, 1, 2))
    for attack in (Attack(prepare, lambda target: (1.0, 2.0)), Attack(prepare)):
        assert {row.seed for row in measured.curve("reoptimisation", attack)} == {0, 1, 2}
    assert most == 1
    assert not alive

"""Covers are decoded by what the attacker left of the scene decoder, messages by the secret; renders may be hurt."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from stages.analysis.attacks.catalogue import ATTACKS, UNATTACKED, AttackName, restored
from stages.analysis.attacks.curves import Assay
from stages.analysis.attacks.registry import attacks
from stages.analysis.attacks.renders import jpeg, resizing
from stages.analysis.attacks.scoring import Scorer
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.imaging.pictures import tensor_to_picture
from stages.scene.message_views import MessageViews
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, cameras, knowledge, scene, target_and_owner
from tests.stages.small import HEIGHT, NAMES, VIEWS, WIDTH, pictures


def views() -> dict[str, MessageViews]:
    coverage = np.ones((VIEWS, HEIGHT, WIDTH), np.float32)
    nothing = np.zeros((0, 3), np.float32)
    return {MESSAGE: MessageViews(MESSAGE, NAMES, pictures(1), coverage, nothing, nothing.astype(np.uint8))}


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


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("hurt", ["jpeg", "resizing"])
def test_only_a_message_that_is_read_off_renders_is_hurt_with_them(method: str, hurt: str) -> None:
    each = assay(method)
    attacked = jpeg(each.target, 20) if hurt == "jpeg" else resizing(each.target, 3)
    before, after = each.scorer.figures(each.target), each.scorer.figures(attacked)
    assert after[None, "psnr"] != before[None, "psnr"]
    assert (after[MESSAGE, "psnr"] != before[MESSAGE, "psnr"]) == (method == "decoder")
    assert attacks((1,))["jpeg"].applies(each.target) == (method == "decoder")


def test_a_curve_has_its_damage_and_its_seeds() -> None:
    each = assay("homogeneous")
    unharmed = each.scorer.cover_psnr(each.target)
    rows = [row for row in each.curve("noise_colours", attacks((1,))["noise_colours"]) if row.quantity == "psnr"]
    covers = {(row.severity, row.seed): row.value for row in rows if row.message is None}
    assert len(covers) == 4
    assert {seed for _, seed in covers} == {0, 1}
    losses = sorted(unharmed - value for (_, seed), value in covers.items() if seed == 0)
    assert losses == sorted(losses)
    assert {row.message for row in rows} == {None, MESSAGE}


def test_remedies_have_rows_of_their_own_and_what_has_no_features_has_none() -> None:
    every = attacks((1,))
    rows = list(assay("homogeneous").curve("rigid_motion", every["rigid_motion"]))
    assert {row.condition for row in rows} == {"rigid_motion", restored("rigid_motion")}
    assert list(assay("sh").curve("channel_dropping", every["channel_dropping"])) == []
    assert {row.condition for row in assay("sh").unattacked()} == {UNATTACKED}


def test_what_has_no_chance_is_measured_once() -> None:
    rows = list(assay("gs_hider").curve("quantisation", attacks((1,))["quantisation"]))
    assert {row.seed for row in rows} == {0}
    assert torch.tensor([row.value for row in rows]).isfinite().all()

"""Each published Gaussian is found, even if all were shifted, moved, pruned or doubled, or decoys were added."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from stages.scene import identification
from stages.scene.gaussians import Gaussians
from stages.scene.identification import MISSING, PAIRED, identified
from stages.scene.moved_splats import moved
from stages.scene.registration import register
from tests.stages.scene.test_registration import motion, scene, shaken

COUNT = 1500
SHIFTED = 0.015
"""Several times as far as one may be from a place to be taken for who was there."""


def joined(*parts: Gaussians) -> Gaussians:
    return Gaussians({name: torch.cat([part[name] for part in parts]) for name in parts[0].parameters})


def right(rows: np.ndarray, expected: np.ndarray) -> float:
    return float(np.mean(rows == expected))


@pytest.mark.parametrize("shift", [0.0, 1e-3, SHIFTED])
@pytest.mark.parametrize("scale", [None, 1.0, 1.7])
def test_shifted_and_moved_gaussians_are_told_by_their_shapes(shift: float, scale: float | None) -> None:
    published = scene(0)
    kept = torch.randperm(COUNT, generator=torch.Generator().manual_seed(3))[: COUNT // 2]
    found = shaken(published, "means", shift).select(kept)
    found = found if scale is None else moved(found, motion(1, scale))
    expected = np.full(COUNT, MISSING)
    expected[kept.numpy()] = np.arange(len(kept))
    assert right(identified(found, published, 0), expected) > 0.99


@pytest.mark.parametrize("shift", [1.0, 30.0])
def test_gaussians_shifted_too_far_for_any_motion_are_told_by_all_else(shift: float) -> None:
    published, strangers = scene(0), scene(5)
    colours, others = np.random.default_rng(4).random((2, COUNT, 3))
    found = shaken(published, "means", shift)
    assert register(joined(strangers, found), published, 0) is None
    rows = identified(joined(strangers, found), published, 0, [(np.concatenate([others, colours]), colours)])
    assert right(rows, COUNT + np.arange(COUNT)) > 0.99
    assert (identified(strangers, published, 0, [(others, colours)]) == MISSING).all()


def test_what_was_done_to_everything_a_little_is_forgiven() -> None:
    published = scene(0)
    found = shaken(shaken(shaken(published, "means", SHIFTED), "log_scales", 0.02), "logit_opacities", 0.02)
    assert right(identified(found, published, 0), np.arange(COUNT)) > 0.95


@pytest.mark.parametrize("shift", [0.0, SHIFTED])
def test_strangers_are_none_of_them(shift: float) -> None:
    published, strangers = scene(0), scene(5)
    rows = identified(joined(strangers, shaken(published, "means", shift)), published, 0)
    assert right(rows, COUNT + np.arange(COUNT)) > 0.99
    assert (identified(joined(strangers, published.select(torch.arange(900))), published, 0)[900:] == MISSING).all()


@pytest.mark.parametrize("changed", [{"logit_opacities": -9.0}, {"log_scales": -12.0}, {"means": 50.0}])
@pytest.mark.parametrize("copies", [1, 5])
@pytest.mark.parametrize("shift", [0.0, SHIFTED])
def test_decoys_are_not_taken_for_what_they_stand_beside(changed: dict[str, float], copies: int, shift: float) -> None:
    """Decoys, one or five per original and listed before it, differ from it in one value; closer ones would be visible.

    With a shift, only the decoys are at the original places.
    """
    published = scene(0)
    colours = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(4)).numpy()
    decoy = published.with_parameters(
        {name: torch.full_like(published[name], value) for name, value in changed.items()}
    )
    found = joined(*[decoy] * copies, shaken(published, "means", shift))
    rows = identified(found, published, 0, [(np.tile(colours, (copies + 1, 1)), colours)])
    assert right(rows, copies * COUNT + np.arange(COUNT)) > 0.99


def test_a_part_that_was_shifted_is_told_where_the_rest_stands_at_its_places() -> None:
    published = scene(0)
    part = torch.arange(COUNT) < COUNT // 4
    means = torch.where(part[:, None], shaken(published, "means", SHIFTED).means, published.means)
    found = published.with_parameters({"means": means})
    assert right(identified(found, published, 0), np.arange(COUNT)) > 0.99


def test_of_several_with_one_shape_it_is_the_nearest() -> None:
    published = scene(0)
    twins = joined(published, published.select(torch.arange(200)))
    means = torch.cat([published.means, published.means[:200] + 3.0])
    twins = twins.with_parameters({"means": means})
    rows = identified(shaken(twins, "means", SHIFTED), twins, 0)
    assert right(rows, np.arange(COUNT + 200)) > 0.99


def test_what_else_is_told_tells_twins_apart() -> None:
    published = scene(0)
    twins = joined(published, published.select(torch.arange(200)))
    colours = np.arange(len(twins), dtype=float)[:, None]
    order = np.random.default_rng(0).permutation(len(twins))
    found = twins.select(torch.from_numpy(order))
    rows = identified(found, twins, 0, [(colours[order], colours)])
    assert right(order[rows], np.arange(len(twins))) > 0.99


def test_of_clones_one_is_taken() -> None:
    published = scene(0)
    rows = identified(joined(published, published), published, 0)
    assert np.array_equal(rows % COUNT, np.arange(COUNT))


def test_no_found_one_is_two() -> None:
    published = scene(0)
    rows = identified(shaken(published, "means", SHIFTED).select(torch.arange(700)), published, 0)
    known = rows[rows != MISSING]
    assert len(known) == len(np.unique(known))


@pytest.mark.parametrize("share", [1.0, 0.9])
def test_of_values_that_many_share_few_are_looked_at_and_the_others_tell(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tree cannot part equal values: to look at all of them for each published Gaussian takes the square of both."""
    published = scene(0)
    alike = torch.arange(COUNT) < share * COUNT
    found = Gaussians(
        published.parameters
        | {"log_scales": torch.where(alike[:, None], -4.0, published["log_scales"])}
        | {"logit_opacities": torch.where(alike, 0.0, published["logit_opacities"])}
    )
    copies = []

    def tree(values: np.ndarray) -> cKDTree:
        copies.append(np.unique(values, axis=0, return_counts=True)[1].max())
        return cKDTree(values)

    monkeypatch.setattr(identification, "cKDTree", tree)
    colours, normals = np.random.default_rng(4).random((2, COUNT, 3))
    rows = identified(found, published, 0, [(colours, colours), (normals, normals)])
    assert right(rows, np.arange(COUNT)) > 0.99
    assert max(copies) == PAIRED


def test_a_found_one_that_two_resemble_is_the_one_it_resembles_most() -> None:
    published = scene(0)
    alike = shaken(shaken(published.select(torch.arange(300)), "means", 1e-4), "log_scales", 1e-3)
    rows = identified(published, joined(alike, published), 0)
    assert right(rows, np.concatenate([np.full(300, MISSING), np.arange(COUNT)])) > 0.99


@pytest.mark.parametrize(("found", "published"), [(0, 5), (5, 0), (0, 0), (1, 1), (3, 1500), (1500, 3), (12, 12)])
def test_few_or_none_are_no_fault(found: int, published: int) -> None:
    rows = identified(scene(1, found), scene(0, published), 0)
    assert rows.shape == (published,)
    assert (rows == MISSING).all()
    few = scene(1, 12)
    assert right(identified(few, few, 0), np.arange(12)) == 1

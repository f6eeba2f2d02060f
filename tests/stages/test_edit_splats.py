"""Edits change what is inside a region and leave the rest as it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.edit_splats import EditSplatsParameters, edit_splats
from stages.hiding.method import build_method
from stages.hiding.storage import read_gaussians, read_method, write_container
from stages.render_views import RenderViewsParameters, render_views
from stages.scene.alignment import rig_of
from stages.scene.drawn_depths import enlarged_scene
from stages.scene.frames import rig_frame
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.scene import read_scene, write_scene
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC
from stages.scene.world_scale import refuse_other_world, scaled, stated
from tests.running import run_stage
from tests.stages import small

HALF = {"shape": "box", "centre": [0.5, 0, 0], "size": [1, 9, 9], "coordinates": "world"}
"""What has x from 0 to 1."""


def splats(folder: Path, degree: int = 1) -> Artifact:
    points = small.points()
    count = {0: 0, 1: 3, 2: 8}[degree]
    generator = torch.Generator().manual_seed(degree)
    attributes = {
        "sh_base": torch.rand(60, 3, generator=generator),
        "sh_rest": torch.rand(60, count, 3, generator=generator) - 0.5,
    }
    with create(folder, "splats") as writer:
        write_container(writer, gaussians_at(points, attributes), build_method("plain", {"sh_degree": degree}))
    return load(folder)


def edited(folder: Path, edits: list[dict], **more: Artifact) -> tuple[Gaussians, Gaussians, Artifact]:
    """The Gaussians before and after, sorted by position, and the edited splats."""
    given = splats(folder / "given")
    parameters = EditSplatsParameters.model_validate_json(json.dumps({"edits": edits}))
    made = run_stage(edit_splats, parameters, {"splats": given, **more}, folder / "out")["splats"]
    return read_gaussians(given), read_gaussians(made), made


def test_removing_leaves_the_rest_as_it_is(tmp_path: Path) -> None:
    before, after, made = edited(tmp_path, [{"edit": "remove", "region": HALF}])
    kept = before.means[:, 0] < 0
    assert 0 < int(kept.sum()) < 60
    for name, tensor in after.parameters.items():
        assert torch.equal(tensor, before[name][kept])
    assert read_method(made).settings == {"sh_degree": 1}


def test_recolouring_changes_colours_inside_only(tmp_path: Path) -> None:
    tint = {"edit": "recolour", "tint": [1, 0, 0], "strength": 1, "region": HALF}
    before, after, _ = edited(tmp_path, [tint])
    inside = before.means[:, 0] >= 0
    colours = 0.5 + CONSTANT_HARMONIC * after["sh_base"]
    np.testing.assert_allclose(colours[inside][:, 1:], 0, atol=1e-6)
    assert (colours[inside][:, 0] > 0).all()
    np.testing.assert_allclose(after["sh_rest"][inside][..., 1:], 0, atol=1e-6)
    assert torch.equal(after["sh_base"][~inside], before["sh_base"][~inside])
    assert torch.equal(after["sh_rest"][~inside], before["sh_rest"][~inside])
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        assert torch.equal(after[name], before[name])


def test_edits_are_made_one_after_the_other(tmp_path: Path) -> None:
    """Hues are turned, then everything is made grey, then half of it is removed."""
    edits = [{"edit": "recolour", "hue": 90}, {"edit": "recolour", "saturation": 0}, {"edit": "remove", "region": HALF}]
    before, after, _ = edited(tmp_path, edits)
    assert len(after) == int((before.means[:, 0] < 0).sum())
    assert (after["sh_base"] - after["sh_base"].mean(dim=1, keepdim=True)).abs().max() < 1e-5


def test_coordinates_of_the_rig(tmp_path: Path) -> None:
    """The same region, given in world coordinates and as shares of the cameras' distance."""
    scene = small.scene(tmp_path / "scene")
    read = read_scene(scene)
    frame = rig_frame(rig_of(read.cameras, read.points))
    diameter = 1.5 * frame.scale
    ball = {"shape": "ellipsoid", "centre": frame.translation.tolist(), "size": [diameter] * 3, "coordinates": "world"}
    by_rig = {"shape": "ellipsoid", "size": [1.5, 1.5, 1.5]}
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    _, one, _ = edited(tmp_path / "a", [{"edit": "remove", "region": {**ball, "size": [0.3 * diameter] * 3}}])
    _, two, _ = edited(tmp_path / "b", [{"edit": "remove", "region": {**by_rig, "size": [0.45] * 3}}], scene=scene)
    assert 0 < len(one) < 60
    assert torch.equal(one.means, two.means)


def test_adding_places_a_part_of_other_splats(tmp_path: Path) -> None:
    """In the world: scaled, turned about x, then about z, then moved; the higher degree of harmonics is kept."""
    added = splats(tmp_path / "added", degree=2)
    add = {"edit": "add", "only": HALF, "scale": 2, "turn": [90, 0, 90], "place": [0, 0, 10], "coordinates": "world"}
    before, after, made = edited(tmp_path, [add], added=added)
    source = read_gaussians(added)
    taken = source.means[source.means[:, 0] >= 0]
    expected = torch.stack([2 * taken[:, 2], 2 * taken[:, 0], 2 * taken[:, 1] + 10], dim=1)
    new = after.means[after.means[:, 2] > 5]
    assert len(new) == len(expected) == len(after) - 60
    order, wanted = (np.lexsort(each.numpy().round(4).T) for each in (new, expected))
    np.testing.assert_allclose(new[order], expected[wanted], atol=1e-5)
    assert read_method(made).settings == {"sh_degree": 2}
    assert torch.equal(after["sh_base"][after.means[:, 2] < 5], before["sh_base"])


def test_adding_by_both_rigs_brings_a_scene_onto_itself(tmp_path: Path) -> None:
    scene = small.scene(tmp_path / "scene")
    before, after, _ = edited(
        tmp_path, [{"edit": "add"}], scene=scene, added=splats(tmp_path / "added"), added_scene=scene
    )
    doubled = torch.cat([before.means, before.means])
    order, wanted = (np.lexsort(each.numpy().round(3).T) for each in (after.means, doubled))
    np.testing.assert_allclose(after.means[order], doubled[wanted], atol=1e-5)


def test_splats_without_a_scene_are_added_by_their_own_extent(tmp_path: Path) -> None:
    scene = small.scene(tmp_path / "scene")
    added = splats(tmp_path / "added")
    _, after, _ = edited(tmp_path, [{"edit": "add", "scale": 0.1, "place": [3, 0, 0]}], scene=scene, added=added)
    read = read_scene(scene)
    frame = rig_frame(rig_of(read.cameras, read.points))
    local = frame.inverse().points(after.means.numpy().astype(np.float64))
    new = local[local[:, 0] > 2]
    assert len(new) == 60
    np.testing.assert_allclose(np.median(new, axis=0), [3, 0, 0], atol=0.03)
    assert (np.linalg.norm(new - [3, 0, 0], axis=1) < 0.1 + 1e-4).mean() == pytest.approx(0.9, abs=0.03)


def test_a_part_of_splats_without_a_scene_is_given_by_their_own_extent(tmp_path: Path) -> None:
    """Nine tenths of them are in the ball about their middle, wherever the rig of the other splats looks."""
    scene, added = small.scene(tmp_path / "scene"), splats(tmp_path / "added")
    ball = {"shape": "ellipsoid", "size": [2, 2, 2]}
    before, after, _ = edited(tmp_path, [{"edit": "add", "only": ball}], scene=scene, added=added)
    assert len(after) - len(before) == pytest.approx(0.9 * 60, abs=2)


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ([{"edit": "remove", "region": {**HALF, "centre": [50, 0, 0]}}], "no Gaussian lies"),
        ([{"edit": "remove", "region": {**HALF, "size": [99, 99, 99]}}], "leave no Gaussian"),
        ([{"edit": "remove", "region": {**HALF, "coordinates": "rig"}}], "input scene"),
        ([{"edit": "add"}], "nothing to add"),
    ],
)
def test_edits_that_cannot_be_made_say_why(tmp_path: Path, edits: list[dict], message: str) -> None:
    with pytest.raises(UserError, match=message):
        edited(tmp_path, edits)


@pytest.mark.parametrize(
    "edit",
    [
        {"edit": "repaint"},
        {"edit": "remove"},
        {"edit": "recolour", "colour": 3},
        {"edit": "remove", "region": {"shape": "box", "size": [1, 1]}},
        {"edit": "remove", "region": {"shape": "box", "size": [1, 1, 0]}},
        {"edit": "add", "scale": -1},
    ],
)
def test_edits_that_are_no_edits_are_refused(tmp_path: Path, edit: dict) -> None:
    with pytest.raises(ValidationError):
        edited(tmp_path, [edit])


@pytest.mark.parametrize(
    ("recolour", "message"),
    [
        ({"tint": [1, 0, 0]}, "has a tint of strength 0, which changes nothing; give a strength"),
        ({"tint": [1, 0, 0], "hue": 90}, "has a tint of strength 0, which changes nothing; give a strength"),
        ({}, "changes nothing; give a hue"),
        ({"hue": -360, "saturation": 1, "region": HALF}, "changes nothing; give a hue"),
    ],
)
def test_a_recolour_that_changes_nothing_is_refused(tmp_path: Path, recolour: dict, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        edited(tmp_path, [{"edit": "recolour", **recolour}])


def test_splats_of_other_methods_are_refused(tmp_path: Path) -> None:
    method = build_method("gs_hider", {"feature_dim": 4, "layers": 2, "decoder_width": 4, "precision": "float32"})
    with create(tmp_path / "other", "splats") as writer:
        write_container(writer, gaussians_at(small.points(), {"raw_features": torch.zeros(60, 4)}), method)
    parameters = EditSplatsParameters.model_validate_json('{"edits": [{"edit": "recolour", "hue": 3}]}')
    with pytest.raises(UserError, match="another method"):
        run_stage(edit_splats, parameters, {"splats": load(tmp_path / "other")}, tmp_path / "out")


def test_what_comes_from_something_private_is_private(tmp_path: Path) -> None:
    with create(tmp_path / "secret", "splats", private=True) as writer:
        attributes = {"sh_base": torch.zeros(60, 3), "sh_rest": torch.zeros(60, 0, 3)}
        write_container(writer, gaussians_at(small.points(), attributes), build_method("plain", {"sh_degree": 0}))
    _, _, made = edited(tmp_path, [{"edit": "add", "coordinates": "world"}], added=load(tmp_path / "secret"))
    assert made.private


ENLARGED = 10.0


def enlarged(folder: Path) -> tuple[Artifact, Artifact]:
    """The scene, whose poses were in small units, and the splats that were trained in its world."""
    folder.mkdir()
    scene, given = read_scene(small.scene(folder / "small")), splats(folder / "given")
    with create(folder / "scene", "scene") as writer:
        write_scene(writer, enlarged_scene(scene, ENLARGED), **stated(ENLARGED))
    with create(folder / "splats", "splats") as writer:
        write_container(writer, scaled(read_gaussians(given), ENLARGED), read_method(given))
        writer.attributes.update(stated(ENLARGED))
    return load(folder / "scene"), load(folder / "splats")


@pytest.mark.parametrize("coordinates", ["rig", "world"])
@pytest.mark.parametrize("edit", ["remove", "add"])
def test_coordinates_are_those_of_the_poses_however_small_their_units(
    tmp_path: Path, edit: str, coordinates: str
) -> None:
    """Splats of other programs are in the poses' world, and splats trained here in one that may be enlarged."""
    scene, trained = enlarged(tmp_path / "enlarged")
    region = {"shape": "ellipsoid", "size": [0.45] * 3, "coordinates": "rig"} if coordinates == "rig" else HALF
    chosen = {"edit": "remove", "region": region} if edit == "remove" else {"edit": "add", "coordinates": coordinates}
    parameters = EditSplatsParameters.model_validate_json(json.dumps({"edits": [chosen]}))
    given = splats(tmp_path / "of another program")
    more = {"added": given} if edit == "add" else {}
    if edit == "add" and coordinates == "rig":
        more["added_scene"] = scene
    here, there = (
        read_gaussians(
            run_stage(edit_splats, parameters, {"splats": own, "scene": scene, **more}, tmp_path / name)["splats"]
        )
        for own, name in ((given, "here"), (trained, "there"))
    )
    assert 0 < len(here) == len(there) != 60
    torch.testing.assert_close(here.means * ENLARGED, there.means, rtol=1e-4, atol=1e-4)


def test_splats_in_another_world_than_the_cameras_are_refused(tmp_path: Path) -> None:
    scene, trained = enlarged(tmp_path / "enlarged")
    refuse_other_world(trained, scene)
    with pytest.raises(UserError, match="not in the world of the cameras; found a world 1 times as large"):
        refuse_other_world(splats(tmp_path / "of another program"), scene)
    inputs = {"container": splats(tmp_path / "again"), "cover": scene}
    with pytest.raises(UserError, match="not in the world of the cameras"):
        run_stage(render_views, RenderViewsParameters(method="plain", views=2), inputs, tmp_path / "out")

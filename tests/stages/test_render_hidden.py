"""A message is rendered from the cover's cameras, under their names, and placed where it fills the picture."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.errors import UserError
from stages.export_splats import SPLATS_FILE, ExportSplatsParameters, export_splats
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method, write_container
from stages.render_hidden import RenderHiddenParameters, photograph_message, render_hidden, visible_points
from stages.scene.alignment import project
from stages.scene.cameras import Cameras
from stages.scene.gaussians import gaussians_at
from stages.scene.message_views import MessageViews, read_messages
from stages.scene.scene import Scene, write_scene
from stages.scene.splat_files.reading import read_splats
from stages.scene.world_scale import world_scale_of
from stages.tracing.rig import orbit
from tests.running import run_stage

SIZE = (32, 24)


def ring(views: int, scale: float, prefix: str) -> Cameras:
    poses, intrinsics = orbit(views, *SIZE, seed=1)
    poses[:, :3, 3] *= scale
    return Cameras(tuple(f"{prefix}{view}.png" for view in range(views)), poses, intrinsics, *SIZE)


def scene_artifact(folder: Path, cameras: Cameras, points: np.ndarray) -> Artifact:
    pictures = np.zeros((len(cameras), cameras.height, cameras.width, 3), np.uint8)
    colors = np.full((len(points), 3), 128, np.uint8)
    with create(folder, "scene") as writer:
        write_scene(writer, Scene(cameras, pictures, points.astype(np.float32), colors, cameras.names[:1]))
    return load(folder)


def wall_of_splats(folder: Path, points: np.ndarray, scale: float = 1.0) -> Artifact:
    """A Gaussian at every point, in a world scaled by `scale`."""
    torch.manual_seed(0)
    method = build_method("plain", {"sh_degree": 0})
    gaussians = gaussians_at(
        points, method.initial_attributes({COVER: np.full((len(points), 3), 0.7)}, np.random.default_rng(0))
    )
    gaussians.parameters["logit_opacities"] = torch.full((len(points),), 4.0)
    gaussians.parameters["means"] *= scale
    gaussians.parameters["log_scales"] += np.log(scale)
    with create(folder, "splats") as writer:
        write_container(writer, gaussians, method)
    return load(folder)


def with_attributes(folder: Path, made: Artifact, **attributes: Json) -> Artifact:
    """The same artifact with more attributes."""
    with create(folder, made.kind) as writer:
        for name in made.names:
            writer.write(name, made.read(name))
        writer.attributes.update({**made.attributes, **attributes})
    return load(folder)


def test_views_have_the_covers_names_and_fill_the_picture(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    directions = generator.standard_normal((4000, 3))
    shell = 5 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.concatenate([shell, generator.uniform(-1, 1, (400, 3))])
    cover = ring(6, scale=3.0, prefix="cover")
    inputs = {
        "splats": wall_of_splats(tmp_path / "splats", points),
        "message": scene_artifact(tmp_path / "message", ring(8, scale=1.0, prefix="message"), points),
        "cover": scene_artifact(tmp_path / "cover", cover, 3 * points),
    }
    made = run_stage(render_hidden, RenderHiddenParameters(name="shell"), inputs, tmp_path / "out")["views"]
    views = read_messages([made], cover.names)["shell"]
    assert views.view_names == cover.names
    assert views.legal.all()
    assert views.pictures.mean() > 100
    with pytest.raises(UserError, match="not rendered for all"):
        read_messages([made], [*cover.names, "another.png"])
    with pytest.raises(UserError, match="same name"):
        read_messages([made, made], cover.names)
    reversed_names = tuple(reversed(cover.names))
    np.testing.assert_array_equal(read_messages([made], reversed_names)["shell"].pictures, views.pictures[::-1])


def test_splats_without_the_messages_scene(tmp_path: Path) -> None:
    """The cover's cameras look at the centre of the splats; the points are where the pictures show them."""
    generator = np.random.default_rng(0)
    points = generator.uniform(-1, 1, (1000, 3)) * [2, 0.5, 2] + [70.0, -30.0, 10.0]
    cover = ring(3, scale=3.0, prefix="cover")
    inputs = {
        "splats": wall_of_splats(tmp_path / "splats", points),
        "cover": scene_artifact(tmp_path / "cover", cover, generator.uniform(-3, 3, (50, 3))),
    }
    parameters = RenderHiddenParameters(name="box", search_width=16)
    made = run_stage(render_hidden, parameters, inputs, tmp_path / "out")["views"]
    views = read_messages([made], cover.names)["box"]
    assert views.mean_coverage.min() > 0.3
    pixels, depth = project(cover, views.points.astype(np.float64))
    assert (depth > 0).all()
    np.testing.assert_allclose(np.median(pixels, axis=1), np.tile([16, 12], (3, 1)), atol=6)


@pytest.mark.parametrize("with_scene", [False, True])
def test_pictures_do_not_depend_on_the_units_of_the_message(tmp_path: Path, with_scene: bool) -> None:
    """With metres as units, a thing of centimetres would lie before the near plane of the cover's cameras."""
    directions = np.random.default_rng(0).standard_normal((1500, 3))
    shell = 2 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.5, 0.0, 0.2]
    cover = scene_artifact(tmp_path / "cover", ring(3, scale=3.0, prefix="cover"), 3 * shell)

    def views_of(scale: float) -> MessageViews:
        folder = tmp_path / str(scale)
        inputs = {"splats": wall_of_splats(folder / "splats", shell, scale), "cover": cover}
        if with_scene:
            cameras = ring(4, scale=scale, prefix="message")
            inputs["message"] = scene_artifact(folder / "message", cameras, scale * shell)
        parameters = RenderHiddenParameters(name="shell", search_width=16)
        made = run_stage(render_hidden, parameters, inputs, folder / "out")["views"]
        return read_messages([made], ["cover0.png", "cover1.png", "cover2.png"])["shell"]

    usual, tiny = views_of(1.0), views_of(0.003)
    assert usual.mean_coverage.min() > 0.3
    np.testing.assert_allclose(tiny.coverage, usual.coverage, atol=0.02)
    assert np.abs(tiny.pictures.astype(int) - usual.pictures).max() <= 3
    np.testing.assert_allclose(tiny.points, usual.points, atol=1e-3)


def test_in_the_same_world_nothing_is_moved(tmp_path: Path) -> None:
    """The pictures are renders of the splats from the cover's cameras; the message's scene is not needed."""
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    cover = ring(4, scale=1.0, prefix="cover")
    splats = wall_of_splats(tmp_path / "splats", points)
    inputs = {"splats": splats, "cover": scene_artifact(tmp_path / "cover", cover, points)}
    parameters = RenderHiddenParameters(name="itself", placement="same_world")
    made = run_stage(render_hidden, parameters, inputs, tmp_path / "out")["views"]
    views = read_messages([made], cover.names)["itself"]
    pictures, coverage = photograph_message(read_gaussians(splats), read_method(splats), cover)
    np.testing.assert_array_equal(views.pictures, pictures)
    np.testing.assert_array_equal(views.coverage, coverage)
    assert views.pictures.any()
    np.testing.assert_array_equal(np.sort(views.points, axis=0), np.sort(points.astype(np.float32), axis=0))


def test_photographing_holds_hardly_more_than_the_pictures(tmp_path: Path) -> None:
    """The pictures and the coverage of hundreds of large views are gigabytes; a second copy may not fit."""
    splats = wall_of_splats(tmp_path / "splats", np.random.default_rng(0).uniform(-1, 1, (50, 3)))
    gaussians, method = read_gaussians(splats), read_method(splats)
    cameras = replace(ring(20, scale=1.0, prefix="cover"), width=192, height=144)
    photograph_message(gaussians, method, cameras)  # what the first rendering loads is not counted
    tracemalloc.start()
    try:
        pictures, coverage = photograph_message(gaussians, method, cameras)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1.3 * (pictures.nbytes + coverage.nbytes)


def test_in_an_enlarged_world_splats_from_elsewhere_are_enlarged_with_it(tmp_path: Path) -> None:
    """They end up where splats trained in the enlarged world are; these are exported at the original scale."""
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    cover = scene_artifact(tmp_path / "cover", ring(4, scale=1.0, prefix="cover"), points)
    large = with_attributes(tmp_path / "large", cover, world_scale=8.0)
    own = with_attributes(tmp_path / "own", wall_of_splats(tmp_path / "splats", points), world_scale=8.0)
    other = wall_of_splats(tmp_path / "small", points, 1 / 8)
    parameters = RenderHiddenParameters(name="itself", placement="same_world")

    def views_of(splats: Artifact) -> MessageViews:
        given = {"splats": splats, "cover": large}
        made = run_stage(render_hidden, parameters, given, tmp_path / f"views {splats.path.name}")["views"]
        return read_messages([made], [f"cover{view}.png" for view in range(4)])["itself"]

    assert views_of(own).pictures.any()
    assert np.abs(views_of(other).pictures.astype(int) - views_of(own).pictures).max() <= 1
    np.testing.assert_allclose(views_of(other).points, views_of(own).points, atol=1e-5)
    exported = run_stage(export_splats, ExportSplatsParameters(), {"splats": own}, tmp_path / "exported")["bundle"]
    gaussians, _ = read_splats(exported.path / SPLATS_FILE)
    expected = read_gaussians(other)
    for name in ("means", "log_scales"):
        torch.testing.assert_close(gaussians[name], expected[name], rtol=1e-5, atol=1e-5)


def test_splats_from_elsewhere_are_enlarged_with_the_messages_scene(tmp_path: Path, recorded: dict[str, Json]) -> None:
    """Whether they were trained on the enlarged scene or imported in its poses' own units, the pictures are the same.

    The factor that is recorded leads from the splats' own world to the cover's.
    """
    directions = np.random.default_rng(0).standard_normal((1500, 3))
    shell = 2 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    cover = scene_artifact(tmp_path / "cover", ring(3, scale=3.0, prefix="cover"), 3 * shell)
    message = scene_artifact(tmp_path / "scene", ring(4, scale=1.0, prefix="message"), shell)
    large = with_attributes(tmp_path / "message", message, world_scale=40.0)
    own = with_attributes(tmp_path / "own", wall_of_splats(tmp_path / "splats", shell), world_scale=40.0)
    other = wall_of_splats(tmp_path / "other", shell, 1 / 40)

    def views_and_scale(splats: Artifact) -> tuple[MessageViews, Json]:
        given = {"splats": splats, "message": large, "cover": cover}
        parameters = RenderHiddenParameters(name="shell", search_width=16)
        made = run_stage(render_hidden, parameters, given, tmp_path / f"views {splats.path.name}")["views"]
        return read_messages([made], [f"cover{view}.png" for view in range(3)])["shell"], recorded["scale"]

    (trained, scale), (imported, scale_of_imported) = views_and_scale(own), views_and_scale(other)
    assert trained.mean_coverage.min() > 0.3
    np.testing.assert_allclose(imported.coverage, trained.coverage, atol=0.02)
    assert np.abs(imported.pictures.astype(int) - trained.pictures).max() <= 1
    np.testing.assert_allclose(imported.points, trained.points, atol=1e-5)
    assert isinstance(scale, float)
    assert scale_of_imported == pytest.approx(40 * scale, rel=1e-3)


@pytest.mark.parametrize("scale", [0, -1, True, "2"])
def test_a_world_of_no_size_is_refused(tmp_path: Path, scale: Json) -> None:
    made = with_attributes(tmp_path / "made", wall_of_splats(tmp_path / "splats", np.zeros((3, 3))), world_scale=scale)
    with pytest.raises(UserError, match="the world_scale of a splats is not what it should be"):
        world_scale_of(made)


def test_any_first_few_points_are_a_fair_sample_of_what_is_seen(tmp_path: Path) -> None:
    """Half of the Gaussians are a hundred times fainter, and hardly any of them is in the first quarter."""
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    method = build_method("plain", {"sh_degree": 0})
    colors = np.repeat([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], 200, axis=0)
    gaussians = gaussians_at(points, method.initial_attributes({COVER: colors}, np.random.default_rng(0)))
    gaussians.parameters["logit_opacities"] = torch.logit(torch.tensor([0.9] * 200 + [0.009] * 200))
    chosen, shown = visible_points(gaussians, seed=3)
    assert len(chosen) == len(shown) == 400
    assert (shown[:100] == [255, 0, 0]).all(axis=1).mean() > 0.9
    np.testing.assert_array_equal(visible_points(gaussians, seed=3)[0], chosen)
    assert not np.array_equal(visible_points(gaussians, seed=4)[0], chosen)
    np.testing.assert_array_equal(np.sort(chosen, axis=0), np.sort(points.astype(np.float32), axis=0))

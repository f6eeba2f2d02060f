"""A container gets a grain before it is sealed, or none, and then it stays exactly the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.add_grain import AddGrainParameters, add_grain
from stages.draw_key import DrawKeyParameters, draw_key
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.key import generator_apart, key_generator
from stages.hiding.opening import read_container
from stages.hiding.rendering import COVER
from stages.hiding.sealing import SEAL
from stages.hiding.storage import read_gaussians
from stages.hiding.watermark.coins import thrown
from stages.hiding.watermark.grain import follows
from stages.scene.cameras import single_cameras
from stages.scene.scene import read_scene
from stages.seal import SealParameters, seal
from tests.running import run_stage
from tests.stages import small
from tests.stages.small import message_views, scene

Made = dict[str, Artifact]


def drawn(folder: Path, seed: int) -> Artifact:
    return run_stage(draw_key, DrawKeyParameters(seed=seed), {}, folder)["key"]


def hidden(folder: Path, method: str) -> Made:
    """A container and its secret, as `add_grain` takes them, with a key for the grain."""
    cover, views = scene(folder / "cover"), message_views(folder / "views")
    chosen = HideScenesParameters.model_validate({"method": method, "iterations": 3, "decoder_width": 12})
    made = run_stage(hide_scenes, chosen, {"cover": cover, "messages": (views,)}, folder / "made", private=True)
    return {**{name: made[name] for name in ("container", "secret")}, "cover": cover, "key": drawn(folder / "key", 1)}


@pytest.mark.parametrize("method", ["homogeneous", "gs_hider", "sh", "decoder"])
def test_without_a_grain_it_is_the_very_same_container(tmp_path: Path, method: str) -> None:
    """So that nothing made from it has to be made again."""
    given = hidden(tmp_path, method)
    parameters = AddGrainParameters(method=method, level=0)
    left = run_stage(add_grain, parameters, given, tmp_path / "left", private=True)["container"]
    assert left.digest == given["container"].digest


def test_cover_and_message_of_a_container_with_a_grain_are_read_once_it_is_sealed(tmp_path: Path) -> None:
    given = hidden(tmp_path, "homogeneous")
    parameters = AddGrainParameters(method="homogeneous")
    container = run_stage(add_grain, parameters, given, tmp_path / "grain", private=True)["container"]
    before, after = read_gaussians(given["container"]), read_gaussians(container)
    coins = thrown(len(before), key_generator(given["key"], 0))
    assert follows(before, after, coins)
    assert not follows(before, before, coins)
    assert not follows(before, after, thrown(len(before), key_generator(drawn(tmp_path / "other", 2), 0)))

    pair = {"container": container, "secret": given["secret"], "key": drawn(tmp_path / "seal", 3)}
    sealed = run_stage(seal, SealParameters(method="homogeneous"), pair, tmp_path / "sealed")
    assert SEAL in sealed["secret"].attributes
    camera = single_cameras(read_scene(given["cover"]).cameras)[2]
    shown = []
    for made in (given, sealed):
        read = read_container(made["container"], made["secret"])
        shown.append(read.method.render(read.gaussians, camera).pictures)
    changes = {name: float((shown[1][name] - shown[0][name]).square().mean().sqrt()) for name in shown[0]}
    assert len(changes) == 2
    assert 255 * changes[COVER] == pytest.approx(parameters.level, rel=0.5)
    assert max(value for name, value in changes.items() if name != COVER) < 0.1 * changes[COVER]
    assert np.isfinite(list(changes.values())).all()


@pytest.mark.parametrize(("knows_the_secret", "changed"), [(True, False), (False, True)])
def test_the_secret_spares_the_message(tmp_path: Path, knows_the_secret: bool, changed: bool) -> None:
    """Without it, the grain changes the message of GS-Hider as much as its cover."""
    given = hidden(tmp_path, "gs_hider")
    inputs = given if knows_the_secret else {name: made for name, made in given.items() if name != "secret"}
    parameters = AddGrainParameters(method="gs_hider")
    container = run_stage(add_grain, parameters, inputs, tmp_path / "grain", private=True)["container"]
    camera = single_cameras(read_scene(given["cover"]).cameras)[2]
    read = [read_container(made, given["secret"]) for made in (given["container"], container)]
    before, after = (one.method.render(one.gaussians, camera).pictures for one in read)
    cover, message = (float((after[name] - before[name]).square().mean().sqrt()) for name in (COVER, "statue"))
    assert (message > 0.1 * cover) == changed


def test_without_a_grain_its_key_is_unread(tmp_path: Path) -> None:
    """The stage declares so, and at level 0 the choice of the key changes nothing."""
    assert add_grain.unread == {"key": {"level": 0}}
    given = hidden(tmp_path, "homogeneous")
    digests = {
        run_stage(
            add_grain,
            AddGrainParameters(method="homogeneous", level=0),
            {**given, "key": drawn(tmp_path / f"key {seed}", seed)},
            tmp_path / f"left {seed}",
        )["container"].digest
        for seed in (1, 2)
    }
    assert len(digests) == 1


def test_coins_follow_from_the_seed_where_there_is_no_key_and_noise_from_the_key_where_there_is_one(
    tmp_path: Path,
) -> None:
    given = {"container": small.splats(tmp_path / "splats"), "cover": scene(tmp_path / "cover")}
    before, key = read_gaussians(given["container"]), drawn(tmp_path / "key", 1)
    for name, seed, inputs in (("first", 0, {}), ("second", 1, {}), ("of a key", 0, {"key": key})):
        parameters = AddGrainParameters(method="plain", seed=seed)
        after = read_gaussians(run_stage(add_grain, parameters, given | inputs, tmp_path / name)["container"])
        own, others = ((inputs.get("key"), seed), (None, 2))
        coins = thrown(len(before), key_generator(*own))
        assert follows(before, after, coins)
        assert not follows(before, after, thrown(len(before), key_generator(*others)))
        change = coins[:, None] * (after["sh_base"].double() - before["sh_base"].double()).numpy()
        noise = coins[:, None] * (change - change.mean(axis=0))
        for source, is_own in ((own, True), (others, False), ((None, 0), name == "first")):
            expected = generator_apart(source[0], "dither", source[1]).uniform(size=noise.shape)
            assert (abs(np.corrcoef(noise.ravel(), expected.ravel())[0, 1]) > 0.9) == is_own


def test_what_is_sealed_or_of_another_method_gets_no_grain(tmp_path: Path) -> None:
    given = hidden(tmp_path, "homogeneous")
    pair = {name: given[name] for name in ("container", "secret", "key")}
    sealed = run_stage(seal, SealParameters(method="homogeneous"), pair, tmp_path / "sealed")
    with pytest.raises(UserError, match="add_grain was given a sealed container"):
        run_stage(add_grain, AddGrainParameters(method="homogeneous"), given | sealed, tmp_path / "grain")
    with pytest.raises(UserError, match="by another method"):
        run_stage(add_grain, AddGrainParameters(method="gs_hider"), given, tmp_path / "other")

"""Grain has the strength asked for and its own colour, and leaves the message and the geometry unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from stages.hiding.method import build_method
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.coins import Coins, thrown
from stages.hiding.watermark.colors import ACROSS, COLORS, GRAIN, LUMINANCE
from stages.hiding.watermark.grain import follows, grained, level_shown
from stages.scene.gaussians import GEOMETRY, Gaussians
from stages.scene.scene import read_scene
from tests.stages import small

LEVEL = 2.0
SETTINGS = {"feature_dim": 8, "layers": 2, "decoder_width": 8, "kernel_size": 3, "precision": "float32"}


def differences(before: Gaussians, after: Gaussians, folder: Path, method: object, name: str) -> torch.Tensor:
    """How the pictures of all cameras differ, in levels of 255."""
    cameras = read_scene(small.scene(folder / f"scene {name} {len(list(folder.iterdir()))}")).cameras
    shown = [
        torch.stack([each.pictures[name] for each in photographs(gaussians, method, cameras)])  # type: ignore[arg-type]
        for gaussians in (before, after)
    ]
    return 255 * (shown[1] - shown[0])


def coins(gaussians: Gaussians, seed: int = 0) -> Coins:
    return thrown(len(gaussians), np.random.default_rng(seed))


def dither() -> np.random.Generator:
    return np.random.default_rng(5)


def rms(values: torch.Tensor) -> float:
    return float(values.square().mean().sqrt())


def test_splats_get_a_grain_of_one_colour(tmp_path: Path) -> None:
    artifact = small.splats(tmp_path / "splats")
    before, method = read_gaussians(artifact), read_method(artifact)
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    after = grained(before, method, cameras, LEVEL, coins(before), dither())
    for name in GEOMETRY:
        assert torch.equal(after[name], before[name])
    assert follows(before, after, coins(before))
    assert not follows(before, after.with_parameters({"means": after.means + 1}), coins(before))
    seen = differences(before, after, tmp_path, method, COVER) @ COLORS.T
    assert rms(seen[..., GRAIN]) == pytest.approx(LEVEL * 3**0.5, rel=0.05)
    assert max(rms(seen[..., LUMINANCE]), rms(seen[..., ACROSS])) < 0.05 * rms(seen[..., GRAIN])
    assert torch.equal(grained(before, method, cameras, LEVEL, coins(before), dither())["sh_base"], after["sh_base"])
    assert not torch.equal(
        grained(before, method, cameras, LEVEL, coins(before, seed=1), dither())["sh_base"], after["sh_base"]
    )


def test_coupled_features_keep_the_message(tmp_path: Path) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        method = build_method("gs_hider", SETTINGS | {"messages": ["message"]})
    plain = read_gaussians(small.splats(tmp_path / "splats"))
    generator = np.random.default_rng(0)
    colors = {name: generator.uniform(0.3, 0.7, (len(plain), 3)) for name in (COVER, "message")}
    geometry = {name: plain[name] for name in GEOMETRY}
    before = Gaussians(geometry | method.initial_attributes(colors, generator))
    before.parameters["raw_features"][:2] = torch.tensor([[40.0], [-200.0]])  # activated: 1 and 0
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    after = grained(before, method, cameras, LEVEL, coins(before), dither())
    cover, message = (differences(before, after, tmp_path, method, name) for name in (COVER, "message"))
    assert rms(cover) == pytest.approx(LEVEL, rel=1e-4)
    assert rms(message) < 0.1 * rms(cover)
    assert after["raw_features"].isfinite().all()
    assert torch.equal(after["raw_features"][:2], before["raw_features"][:2]), "where there is no room nothing changes"
    half = len(before) // 2
    before.parameters["raw_features"][:half, 0] = torch.linspace(-20, 20, half)
    after = grained(before, method, cameras, LEVEL, coins(before), dither())
    assert follows(before, after, coins(before))
    assert not follows(before, after, coins(before, seed=1))
    clamped = after.with_parameters({"raw_features": after["raw_features"].clamp(-9.21, 9.21)})
    assert follows(before, clamped, coins(before)), "as grains of earlier versions are"


def test_a_grain_that_features_have_no_room_for_is_reported(tmp_path: Path) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        method = build_method("gs_hider", SETTINGS | {"messages": []})
    plain = read_gaussians(small.splats(tmp_path / "splats"))
    grey = {COVER: np.full((len(plain), 3), 0.5)}
    attributes = method.initial_attributes(grey, np.random.default_rng(0))
    before = Gaussians({name: plain[name] for name in GEOMETRY} | attributes)
    full = before.with_parameters({"raw_features": torch.full_like(before["raw_features"], 5.0)})
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    for gaussians, reached in ((before, True), (full, False)):
        log: list[str] = []
        after = grained(gaussians, method, cameras, LEVEL, coins(gaussians), dither())
        shown = level_shown(gaussians, after, method, cameras, LEVEL, log.append)
        differing = differences(gaussians, after, tmp_path, method, COVER)
        assert shown == pytest.approx(rms(differing), rel=1e-4)
        assert (shown > 0.95 * LEVEL) == reached == (not log)
    assert log == [f"the grain shows {shown:.2f} of 255 levels, not 2: features near 0 or 1 have no room for more"]


def test_a_feature_near_its_end_changes_as_much_for_either_coin(tmp_path: Path) -> None:
    """Clamped at a bound, it would lie on it exactly, and tell its coin."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        method = build_method("gs_hider", SETTINGS | {"messages": []})
    plain = read_gaussians(small.splats(tmp_path / "splats"))
    generator = np.random.default_rng(0)
    colors = {COVER: generator.uniform(0.3, 0.7, (len(plain), 3))}
    before = Gaussians({name: plain[name] for name in GEOMETRY} | method.initial_attributes(colors, generator))
    raw = before.parameters["raw_features"]
    raw[: len(raw) // 4] = torch.from_numpy(generator.uniform(2.5, 9.0, raw[: len(raw) // 4].shape)).to(raw)
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    tossed = coins(before)
    after = [grained(before, method, cameras, LEVEL, each, dither())["raw_features"] for each in (tossed, -tossed)]
    up, down = (each.double().sigmoid() - raw.double().sigmoid() for each in after)
    assert (up.abs() > 0).double().mean() > 0.9
    torch.testing.assert_close(up, -down, rtol=0.1, atol=2e-5)


def test_decoders_that_read_alike_keep_other_colours_and_the_message(tmp_path: Path) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        method = build_method("gs_hider", SETTINGS | {"messages": ["message"]})
    plain = read_gaussians(small.splats(tmp_path / "splats"))
    generator = np.random.default_rng(0)
    colors = {name: generator.uniform(0.3, 0.7, (len(plain), 3)) for name in (COVER, "message")}
    before = Gaussians({name: plain[name] for name in GEOMETRY} | method.initial_attributes(colors, generator))
    of_cover, of_message = (method.networks[f"{name}_decoder"] for name in ("scene", "message"))
    mixture = torch.tensor([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.3, 0.0, 1.0]])
    with torch.no_grad():
        of_message[0].weight += 0.5 * of_cover[0].weight
        of_cover[-1].weight.copy_(torch.einsum("cd,d...->c...", mixture, of_cover[-1].weight))
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    after = grained(before, method, cameras, LEVEL, coins(before), dither())
    cover, message = (differences(before, after, tmp_path, method, name) for name in (COVER, "message"))
    seen = cover @ COLORS.T
    assert max(rms(seen[..., LUMINANCE]), rms(seen[..., ACROSS])) < 0.1 * rms(seen[..., GRAIN])
    assert rms(message) < 0.1 * rms(cover)


def test_rounding_tells_no_coin(tmp_path: Path) -> None:
    """With one amount for all Gaussians, each published float32 could show which of two values it was rounded from."""
    artifact = small.splats(tmp_path / "splats")
    before, method = read_gaussians(artifact), read_method(artifact)
    cameras = read_scene(small.scene(tmp_path / "scene")).cameras
    after = grained(before, method, cameras, LEVEL, coins(before), dither())
    amounts = (after["sh_base"].double() - before["sh_base"].double()).abs()
    amount = amounts.mean(dim=0)
    steps = torch.nextafter(after["sh_base"], torch.tensor(torch.inf)) - after["sh_base"]
    assert ((amounts - amount).abs() > 2 * steps).double().mean() > 0.9
    assert (amounts - amount).abs().max() < 0.01 * amount.max()


def test_gaussians_without_colours_are_refused(tmp_path: Path) -> None:
    artifact = small.splats(tmp_path / "splats")
    gaussians, method = read_gaussians(artifact), read_method(artifact)
    bare = Gaussians({name: gaussians[name] for name in GEOMETRY})
    with pytest.raises(UserError, match="coupled features"):
        grained(bare, method, read_scene(small.scene(tmp_path / "scene")).cameras, LEVEL, coins(bare), dither())


def test_gaussians_that_no_camera_sees_are_refused(tmp_path: Path) -> None:
    artifact = small.splats(tmp_path / "splats")
    gaussians, method = read_gaussians(artifact), read_method(artifact)
    unseen = gaussians.with_parameters({"logit_opacities": torch.full((len(gaussians),), -50.0)})
    with pytest.raises(UserError, match="grain does not show"):
        grained(unseen, method, read_scene(small.scene(tmp_path / "scene")).cameras, LEVEL, coins(unseen), dither())

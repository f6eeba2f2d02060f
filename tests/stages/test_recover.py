"""A found container becomes one that the published one's secret reads, or is refused if it was not made from it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis.attacks.features import channel_permutation, compensated_rotation
from stages.analysis.attacks.pruning import random_pruning
from stages.analysis.attacks.rigid_motion import rigid_motion
from stages.analysis.attacks.target import Target
from stages.analysis.measurements import read_measurements
from stages.analysis.verdicts import IS_YOURS, MAY_BE_YOURS
from stages.hiding.coupled import FEATURES
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method, write_container, write_secret
from stages.recover import RecoverParameters, recover
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians
from tests.running import run_stage
from tests.stages import small
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, cameras, target_and_owner
from tests.stages.test_stopping import Asking

SAME = 2e-3


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def stored(folder: Path, target: Target) -> Artifact:
    with create(folder, "container") as writer:
        write_container(writer, target.gaussians, target.method)
    return load(folder)


def attacked(target: Target) -> Target:
    """Moved and pruned; features, if any, are rotated and their channels permuted, and the scene decoder with them."""
    if target.has_features:
        target = channel_permutation(compensated_rotation(target, 30.0, generator()), 16, generator())
    return random_pruning(rigid_motion(target, 90.0, generator()), 0.25, generator())


def refused(tmp_path: Path, found: Artifact, published: Artifact, method: str = "homogeneous") -> str:
    inputs, outputs = {"found": found, "published": published}, tmp_path / f"{found.path.name} refused"
    with pytest.raises(UserError) as refusal:
        run_stage(recover, RecoverParameters(method=method), inputs, outputs)
    return str(refusal.value)


def changed(target: Target, name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Target:
    return target.with_parameters({name: change(target.gaussians[name])})


@pytest.mark.parametrize("method", METHODS)
def test_the_secret_reads_what_was_recovered(tmp_path: Path, method: str) -> None:
    target, owner = target_and_owner(method)
    with create(tmp_path / "secret", "secret", private=True) as writer:
        write_secret(writer, owner, [MESSAGE])
    secret = load(tmp_path / "secret")
    inputs = {
        "found": stored(tmp_path / "found", attacked(target)),
        "published": stored(tmp_path / "published", target),
    }
    outputs = run_stage(recover, RecoverParameters(method=method), inputs, tmp_path / "outputs")
    container = outputs["container"]
    assert not container.private
    camera = single_cameras(cameras())[0]

    def pictures(artifact: Artifact) -> dict[str, torch.Tensor]:
        return dict(read_method(artifact, secret).render(read_gaussians(artifact), camera).pictures)

    expected = pictures(stored(tmp_path / "pruned", random_pruning(target, 0.25, generator())))
    back, harmed = pictures(container), pictures(inputs["found"])
    assert set(back) == {COVER, MESSAGE}
    assert all((back[name] - expected[name]).abs().max() < SAME for name in back)
    assert (harmed[MESSAGE] - expected[MESSAGE]).abs().max() > 0.05


def test_splats_of_3dgs_are_recovered_too(tmp_path: Path) -> None:
    published = small.splats(tmp_path / "published")
    target = Target(read_gaussians(published), read_method(published))
    spread = torch.linspace(-2, 2, len(target.gaussians))
    target = changed(target, "logit_opacities", lambda logits: logits + spread)
    inputs = {
        "found": stored(tmp_path / "found", rigid_motion(target, 40.0, generator())),
        "published": stored(tmp_path / "original", target),
    }
    made = run_stage(recover, RecoverParameters(method="plain"), inputs, tmp_path / "outputs")["container"]
    back, expected = (read_gaussians(each).means for each in (made, inputs["published"]))
    assert torch.allclose(back, expected, atol=1e-4)


def test_it_says_what_was_found(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    found = stored(tmp_path / "found", attacked(target))
    asking = Asking()
    services = asking.services()
    for name, artifact in (("moved", found), ("same", published)):
        inputs = {"found": artifact, "published": published}
        run_stage(recover, RecoverParameters(method="homogeneous"), inputs, tmp_path / name, services=services)
    first, second = asking.lines
    assert "turned by 90.000 degrees" in first
    assert "100.0% of the Gaussians are published ones, 75.0% of the published ones are there" in first
    assert "features changed back by 0." in first
    assert "turned by 0.000 degrees, moved by 0, scaled by 1;" in second
    assert "features left as they are" in second
    assert load(tmp_path / "same" / "container").digest == published.digest


def test_the_figures_say_whose_it_is_and_what_was_undone(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    places = target.gaussians.means
    noise = 0.025 * torch.randn(places.shape, generator=generator())
    shaken = changed(target, "means", lambda means: means + noise)
    for name, found, verdict, matched, again in (
        ("attacked", attacked(target), IS_YOURS, 1, 0.75),
        ("shaken", shaken, IS_YOURS, 0.3, 0.3),  # sizes are all alike, so only opacities distinguish Gaussians
        ("its shapes too", changed(shaken, "log_scales", lambda sizes: sizes + noise), MAY_BE_YOURS, 0.1, 0.1),
        ("flooded", with_invisible(target, 4), IS_YOURS, 0.2, 1),
        ("a flooded fragment", with_invisible(target.keeping(torch.arange(30)), 7), MAY_BE_YOURS, 0.125, 0.15),
    ):
        inputs = {"found": stored(tmp_path / name, found), "published": published}
        outputs = run_stage(recover, RecoverParameters(method="homogeneous"), inputs, tmp_path / f"{name} recovered")
        figures = {row.quantity: row.value for row in read_measurements(outputs["figures"])}
        assert figures[verdict] == 1
        assert {IS_YOURS, MAY_BE_YOURS} & figures.keys() == {verdict}
        assert (figures["matched"], figures["found_again"]) == pytest.approx((matched, again), abs=0.05)
        assert (figures["gaussians_found"], figures["gaussians_published"]) == (len(found.gaussians), 200)
        assert figures["degrees"] == pytest.approx(90 if name == "attacked" else 0, abs=0.01)


def with_invisible(target: Target, times: int) -> Target:
    """With a thief's scattered, invisible Gaussians added: `times` as many as there are."""
    given = target.gaussians
    more = {name: values.repeat(times, *[1] * (values.ndim - 1)) for name, values in given.parameters.items()}
    more["means"] = more["means"] + 0.5 * torch.randn(more["means"].shape, generator=generator())
    more["logit_opacities"] = torch.full_like(more["logit_opacities"], -12.0)
    return target.with_parameters({name: torch.cat([given[name], values]) for name, values in more.items()})


def test_what_was_not_made_from_it_is_refused(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    moved_away = changed(target, "means", lambda means: means.flip(0) * 3)
    strange = stored(tmp_path / "strange", changed(moved_away, "log_scales", lambda sizes: sizes.flip(0) - sizes))
    said = refused(tmp_path, strange, published)
    assert "matches nothing that was published" in said
    assert "found 200 Gaussians" in said
    none = stored(tmp_path / "none", target.keeping(torch.arange(0)))
    assert "found 0 Gaussians" in refused(tmp_path, none, published)
    few = refused(tmp_path, stored(tmp_path / "few", target.keeping(torch.arange(9))), published)
    assert "found 9 Gaussians" in few
    assert "at least ten of its Gaussians" in few


def test_what_is_known_and_cannot_be_read_is_not_called_unknown(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    few = target.keeping(torch.arange(12)).gaussians.parameters
    with create(tmp_path / "few", "container") as writer:
        write_container(writer, Gaussians(few | {FEATURES: few[FEATURES][:, :-1]}), target.method)
    said = refused(tmp_path, load(tmp_path / "few"), published)
    assert "This is your container, but too little of it is left" in said
    assert "12 of the published Gaussians" in said


def test_containers_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    other, _ = target_and_owner("gs_hider")
    said = refused(tmp_path, stored(tmp_path / "other", other), published)
    assert "another method" in said
    flat = stored(tmp_path / "flat", changed(target, "log_scales", lambda scales: scales[:, :2]))
    assert "different log_scales" in refused(tmp_path, flat, published)
    broken = stored(tmp_path / "broken", changed(target, "quats", lambda quats: quats / 0))
    assert "NaN or infinity in quats" in refused(tmp_path, broken, published)


def with_row(target: Target, name: str, value: float) -> Target:
    """The container with this parameter of one Gaussian set to `value`."""

    def change(values: torch.Tensor) -> torch.Tensor:
        values = values.clone()
        values[7] = value
        return values

    return changed(target, name, change)


def test_a_quaternion_as_long_as_can_be_does_not_keep_the_owner_from_what_is_his(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    moved = rigid_motion(target, 90.0, generator())
    inputs = {
        "found": stored(tmp_path / "found", with_row(moved, "quats", 3e38)),
        "published": stored(tmp_path / "published", target),
    }
    outputs = run_stage(recover, RecoverParameters(method="homogeneous"), inputs, tmp_path / "outputs")
    gaussians = read_gaussians(outputs["container"])
    assert all(values.isfinite().all() for values in gaussians.parameters.values())
    assert torch.allclose(gaussians.quats.norm(dim=1), torch.ones(len(gaussians)))


def test_values_that_become_infinite_are_refused_with_their_rows(tmp_path: Path) -> None:
    target, _ = target_and_owner("homogeneous")
    published = stored(tmp_path / "published", target)
    moved = rigid_motion(target, 90.0, generator())
    said = refused(tmp_path, stored(tmp_path / "far", with_row(moved, "means", 3e38)), published)
    assert "what was moved back has values that are not numbers" in said
    assert re.search(r"NaN or infinity in means of 1 of 200 Gaussians, rows \d+;", said)
    said = refused(tmp_path, stored(tmp_path / "broken", with_row(moved, "log_scales", float("nan"))), published)
    assert re.search(r"NaN or infinity in log_scales of 1 of 200 Gaussians, rows \d+;", said)

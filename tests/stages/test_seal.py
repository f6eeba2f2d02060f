"""A container is sealed, published, read back and opened; after pruning, the Gaussians that are left are opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.errors import UserError
from pipeline.stage import Finished
from stages.analysis.attacks.catalogue import UNATTACKED, restored
from stages.analysis.measurements import read_measurements
from stages.analysis.secrecy.conditions import APART, BLIND, OWNER
from stages.attack import AttackParameters, attack
from stages.draw_key import DrawKeyParameters, draw_key
from stages.evaluate import evaluate
from stages.export_container import ExportContainerParameters, export_container
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.coupled import FEATURES
from stages.hiding.expected import FACTS
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.method import build_method
from stages.hiding.opening import _seal_of, open_container, opener, read_container, refuse_sealed, rows_of
from stages.hiding.remarks import MOST_LEFT_OPEN, left_open
from stages.hiding.sealing import SEAL, SIGNS
from stages.hiding.storage import read_gaussians, read_method, write_container, write_secret
from stages.imaging.metric_table import read_rows
from stages.import_container import ImportContainerParameters, import_container
from stages.probe_secrecy import ProbeSecrecyParameters, probe_secrecy
from stages.render_path import render_path
from stages.reveal import RevealParameters, reveal
from stages.scene.gaussians import Gaussians
from stages.seal import SealParameters, seal
from stages.view_container import view_container
from tests.running import run_stage
from tests.stages.small import scene
from tests.stages.test_probe_decoder import SETTINGS, dotted_message

Made = dict[str, Artifact]


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return hidden_in(tmp_path_factory.mktemp("hidden"), {"feature_dim": 16})


def hidden_in(folder: Path, changed: Mapping[str, int]) -> Made:
    """A container, its secret, the scene and views it was made from, and a key."""
    cover = scene(folder / "cover")
    views = dotted_message(folder / "views", cover)
    chosen = HideScenesParameters.model_validate({**SETTINGS, "method": "homogeneous", **changed})
    made = run_stage(hide_scenes, chosen, {"cover": cover, "messages": (views,)}, folder / "made")
    key = run_stage(draw_key, DrawKeyParameters(seed=3), {}, folder / "key")["key"]
    return {"container": made["container"], "secret": made["secret"], "cover": cover, "views": views, "key": key}


@pytest.fixture(scope="module")
def closed(hidden: Made, tmp_path_factory: pytest.TempPathFactory) -> Made:
    return sealed(tmp_path_factory.mktemp("closed"), hidden)


def sealed(folder: Path, hidden: Made, method: str = "homogeneous", **chosen: bool) -> Made:
    given = {name: hidden[name] for name in ("container", "secret", "key")}
    return run_stage(seal, SealParameters(method=method, **chosen), given, folder)


def features(container: Artifact) -> torch.Tensor:
    return read_gaussians(container)[FEATURES].sigmoid()


@pytest.mark.parametrize("channels", [16, 40])  # the wider, the longer the secret's words
def test_it_is_published_and_opened_by_whoever_has_the_secret(tmp_path: Path, hidden: Made, channels: int) -> None:
    made = hidden if channels == 16 else hidden_in(tmp_path / "made", {"feature_dim": channels, "iterations": 1})
    closed = sealed(tmp_path / "closed", made)
    assert (closed["container"].private, closed["secret"].private) == (False, True)
    assert (features(closed["container"]) - features(made["container"])).abs().max() > 0.1
    bundles = run_stage(export_container, ExportContainerParameters(), closed, tmp_path / "exported")
    files = {"bundle": bundles["bundle"].path, "secret": bundles["secret_bundle"].path}
    read = run_stage(
        import_container, ImportContainerParameters(method="homogeneous", **files), {}, tmp_path / "imported"
    )
    opened = read_container(read["container"], read["secret"]).gaussians
    torch.testing.assert_close(opened[FEATURES].sigmoid(), features(made["container"]), rtol=0, atol=2e-4)


def test_nothing_of_the_seal_is_in_what_is_published(closed: Made) -> None:
    key = str(closed["secret"].attributes[SEAL])
    public = b"".join(file.read_bytes() for file in closed["container"].path.rglob("*") if file.is_file())
    assert key.encode() not in public
    assert bytes.fromhex(key) not in public


def test_a_seal_follows_from_the_key(tmp_path: Path, hidden: Made, closed: Made) -> None:
    again = sealed(tmp_path / "again", hidden)
    assert torch.equal(features(again["container"]), features(closed["container"]))
    other = run_stage(draw_key, DrawKeyParameters(seed=4), {}, tmp_path / "key")["key"]
    different = sealed(tmp_path / "other", hidden | {"key": other})
    assert different["secret"].attributes[SEAL] != again["secret"].attributes[SEAL]


def test_a_sealed_secret_still_says_which_view_hides_an_image(tmp_path: Path, hidden: Made) -> None:
    with create(tmp_path / "of an image", "secret", private=True) as writer:
        method = read_method(hidden["container"], hidden["secret"])
        write_secret(writer, method, method.messages, "003.png")
    secret = sealed(tmp_path / "sealed", hidden | {"secret": load(tmp_path / "of an image")})["secret"]
    assert secret.attributes[IMAGE_VIEW] == "003.png"
    assert SEAL in secret.attributes


def test_a_container_of_another_method_than_declared_is_not_sealed(tmp_path: Path, hidden: Made) -> None:
    with pytest.raises(UserError, match="by another method"):
        sealed(tmp_path / "sealed", hidden, "gs_hider")


def test_without_the_seal_the_message_can_be_looked_at_and_with_it_it_cannot(
    tmp_path: Path, hidden: Made, closed: Made
) -> None:
    def shown(name: str, made: Made) -> tuple[float, float]:
        given = {"container": made["container"], "secret": made["secret"], "cover": hidden["cover"]}
        chosen = ProbeSecrecyParameters(method="homogeneous", wrong_decoders=1, shares=())
        probed = run_stage(probe_secrecy, chosen, {**given, "messages": (hidden["views"],)}, tmp_path / name)
        rows = read_measurements(probed["measurements"])
        return tuple(
            float(np.mean([row.value for row in rows if (row.quantity, row.condition) == figure]))
            for figure in (("psnr_coloured", BLIND.format(APART)), ("psnr_covered", OWNER))
        )

    open_blind, open_psnr = shown("open", hidden)
    closed_blind, closed_psnr = shown("closed", closed)
    assert closed_blind < open_blind - 1  # dB; where the dots are can still be seen against black
    assert closed_psnr == pytest.approx(open_psnr, abs=0.02)


def kept(folder: Path, container: Artifact, share: float) -> Artifact:
    gaussians = read_gaussians(container)
    rows = torch.arange(len(gaussians)) < share * len(gaussians)
    with create(folder, "container", private=False) as writer:
        fewer = gaussians.select(rows)
        write_container(writer, fewer, read_method(container))
    return load(folder)


def test_it_is_attacked_as_it_is_published_and_opened_beside_it(tmp_path: Path, hidden: Made, closed: Made) -> None:
    chosen = AttackParameters.model_validate(
        {"method": "homogeneous", "attacks": ("random_pruning", "rigid_motion"), "cover_losses": (1,), "seeds": (0,)}
        | {"lpips": False}
    )

    def measured(name: str, made: Made) -> Mapping[tuple[str, float | None, bool], float]:
        given = {"container": made["container"], "secret": made["secret"], "cover": hidden["cover"]}
        rows = run_stage(attack, chosen, given | {"messages": (hidden["views"],)}, tmp_path / name)["measurements"]
        of_psnr = (row for row in read_measurements(rows) if row.quantity == "psnr")
        return {(row.condition, row.severity, row.message is None): row.value for row in of_psnr}

    unsealed, attacked = measured("unsealed", hidden), measured("attacked", closed)
    assert attacked.keys() == unsealed.keys()
    for (condition, severity, of_cover), value in unsealed.items():
        found = attacked[condition, severity, of_cover]
        if of_cover or condition in (UNATTACKED, "random_pruning", restored("rigid_motion")):
            assert found == pytest.approx(value, abs=0.05)


def test_the_secret_of_another_sealing_of_the_same_gaussians_is_refused(
    tmp_path: Path, hidden: Made, closed: Made
) -> None:
    """Such as one of the same container with a grain; otherwise noise would be shown as the message."""
    key = run_stage(draw_key, DrawKeyParameters(seed=4), {}, tmp_path / "key")["key"]
    other = sealed(tmp_path / "other", hidden | {"key": key})
    for container, secret in ((closed, other), (other, closed)):
        for published in (None, container["container"]):
            with pytest.raises(
                UserError, match=r"another sealing of the same Gaussians; found [456]\d % .* 75 % or more"
            ):
                read_container(container["container"], secret["secret"], published=published)


@pytest.mark.parametrize("name", ["means", "logit_opacities"])
def test_what_was_moved_or_shown_otherwise_is_not_opened_alone(tmp_path: Path, closed: Made, name: str) -> None:
    gaussians = read_gaussians(closed["container"])
    with create(tmp_path / "changed", "container", private=False) as writer:
        changed = gaussians.with_parameters({name: 1.001 * gaussians[name]})
        write_container(writer, changed, read_method(closed["container"]))
    with pytest.raises(UserError, match="secret belongs to another container, or this container was changed"):
        read_container(load(tmp_path / "changed"), closed["secret"])


def test_features_that_were_rounded_are_still_opened(tmp_path: Path, hidden: Made, closed: Made) -> None:
    gaussians = read_gaussians(closed["container"])
    rounded = {FEATURES: (gaussians[FEATURES].sigmoid() * 31).round().div(31).clamp(0.001, 0.999).logit()}
    with create(tmp_path / "rounded", "container", private=False) as writer:
        write_container(writer, gaussians.with_parameters(rounded), read_method(closed["container"]))
    opened = read_container(load(tmp_path / "rounded"), closed["secret"]).gaussians
    assert (opened[FEATURES].sigmoid() - features(hidden["container"])).abs().mean() < 0.1


def test_a_secret_from_before_there_were_signs_still_opens(tmp_path: Path, hidden: Made, closed: Made) -> None:
    with create(tmp_path / "earlier", "secret", private=True) as writer:
        for name in closed["secret"].names:
            writer.write(name, closed["secret"].read(name))
        writer.attributes |= {name: value for name, value in closed["secret"].attributes.items() if name != SIGNS}
    opened = read_container(closed["container"], load(tmp_path / "earlier")).gaussians
    torch.testing.assert_close(opened[FEATURES].sigmoid(), features(hidden["container"]), rtol=0, atol=2e-4)


def of_a_stranger(folder: Path, closed: Made) -> Artifact:
    """A container whose opened features would exceed their range; what is cut off shows in the cover."""
    gaussians, method = read_gaussians(closed["container"]), read_method(closed["container"], closed["secret"])
    read = _seal_of(closed["secret"], method, gaussians).places.read
    generator = torch.Generator().manual_seed(0)
    steps = 0.3 * torch.randn(len(gaussians), read.shape[1], generator=generator, dtype=torch.float64)
    moved = (gaussians[FEATURES].sigmoid() + steps @ read.T).clamp(0.001, 0.999).logit().float()
    with create(folder, "container", private=False) as writer:
        write_container(writer, gaussians.with_parameters({FEATURES: moved}), method)
    return load(folder)


@pytest.mark.parametrize("is_honest", [True, False])
def test_the_secret_changes_nothing_public(tmp_path: Path, hidden: Made, closed: Made, is_honest: bool) -> None:
    container = closed["container"] if is_honest else of_a_stranger(tmp_path / "stranger", closed)
    secret, cover = closed["secret"], hidden["cover"]
    opened, shown = read_gaussians(container), read_container(container, secret).gaussians
    assert (opened[FEATURES].sigmoid() - shown[FEATURES].sigmoid()).abs().max() > 0.1
    exporting = ExportContainerParameters(frames=4)
    exported = run_stage(export_container, exporting, closed | {"cover": cover}, tmp_path / "exported")
    importing = ImportContainerParameters(method="homogeneous", bundle=exported["bundle"].path)
    path = run_stage(import_container, importing, {}, tmp_path / "imported")["cameras"]
    stages = (
        (evaluate, {"cover": cover}, {"messages": (hidden["views"],)}, {"lpips": "none"}),
        (render_path, {"cover": cover}, {}, {"frames": 3}),
        (view_container, {"cameras": path}, {}, {"frames": 3}),
    )
    for number, (stage, inputs, owners, settings) in enumerate(stages):
        parameters = stage.parameters.model_validate({"method": "homogeneous", **settings})
        given = {"container": container, **inputs}
        alone = run_stage(stage, parameters, given, tmp_path / f"{number} alone")
        made = run_stage(stage, parameters, {**given, **owners, "secret": secret}, tmp_path / f"{number}")
        public = [name for name, output in made.items() if not output.private]
        assert public
        assert [made[name].digest for name in public] == [alone[name].digest for name in public], public


def test_what_was_pruned_is_opened_by_what_was_published(tmp_path: Path, hidden: Made, closed: Made) -> None:
    pruned = kept(tmp_path / "pruned", closed["container"], 0.8)
    with pytest.raises(UserError, match="secret belongs to another container, or this container was changed"):
        read_container(pruned, closed["secret"])
    opened = read_container(pruned, closed["secret"], published=closed["container"]).gaussians
    original = read_gaussians(hidden["container"])
    own = {tuple(mean.tolist()): row for row, mean in enumerate(original.means)}
    rows = [own[tuple(mean.tolist())] for mean in opened.means]
    assert len(rows) == len(read_gaussians(pruned))
    torch.testing.assert_close(opened[FEATURES].sigmoid(), original[FEATURES].sigmoid()[rows], rtol=0, atol=2e-4)


def test_what_was_pruned_is_revealed_beside_what_was_published(tmp_path: Path, hidden: Made, closed: Made) -> None:
    pruned = kept(tmp_path / "pruned", closed["container"], 0.99)
    given = {"container": pruned, "published": closed["container"], "secret": closed["secret"]}
    chosen = RevealParameters(method="homogeneous", threads=1)
    scores = run_stage(reveal, chosen, given | {"cover": hidden["cover"]}, tmp_path / "revealed")["scores"]
    of_messages = [row.value for row in read_rows(scores) if row.quantity == "psnr" and row.message is not None]
    assert min(of_messages) > 30


def changed_as(name: str, gaussians: Gaussians) -> Gaussians:
    """All Gaussians as a thief changes them, at hardly any cost to the cover."""
    generator = torch.Generator().manual_seed(0)
    if name == "decoys":
        decoys = gaussians.parameters | {
            FEATURES: torch.zeros_like(gaussians[FEATURES]),
            "logit_opacities": torch.full_like(gaussians["logit_opacities"], -9.0),
        }
        return Gaussians({each: torch.cat([decoys[each], values]) for each, values in gaussians.parameters.items()})
    if name == "clones":
        return Gaussians({each: torch.cat([values, values]) for each, values in gaussians.parameters.items()})
    noise = 0.01 * gaussians.means.std(dim=0) * torch.randn(gaussians.means.shape, generator=generator)
    order = torch.randperm(len(gaussians), generator=generator)
    return gaussians.with_parameters({"means": gaussians.means + noise}).select(order)


@pytest.mark.parametrize("name", ["decoys", "clones", "noise on positions"])
def test_each_gaussian_is_told_whatever_was_done_to_all(name: str, hidden: Made, closed: Made) -> None:
    published, original = read_gaussians(closed["container"]), read_gaussians(hidden["container"])
    opened = opener(read_method(closed["container"], closed["secret"]), closed["secret"], published)(
        changed_as(name, published)
    )
    assert len(opened) == len(original)
    torch.testing.assert_close(opened[FEATURES].sigmoid(), original[FEATURES].sigmoid(), rtol=0, atol=2e-4)


def test_what_the_scene_decoder_reads_tells_gaussians_whose_places_and_shapes_were_changed(closed: Made) -> None:
    published, generator = read_gaussians(closed["container"]), torch.Generator().manual_seed(0)
    sizes = {"means": 0.02 * published.means.std(dim=0), "log_scales": 0.1, "quats": 0.1, "logit_opacities": 0.1}
    changes = {
        name: published[name] + size * torch.randn(published[name].shape, generator=generator)
        for name, size in sizes.items()
    }
    seal = _seal_of(closed["secret"], read_method(closed["container"], closed["secret"]), published)
    rows = rows_of(published.with_parameters(changes), seal)
    assert (rows == torch.arange(len(published))).double().mean() > 0.95


def test_what_is_not_known_at_all_is_left_as_it_is(closed: Made) -> None:
    published = read_gaussians(closed["container"])
    stranger = published.with_parameters({"means": published.means.flip(0) * 7 + 3})
    method, few = read_method(closed["container"], closed["secret"]), stranger.select(torch.arange(5))
    opened = opener(method, closed["secret"], published)(few)
    assert torch.equal(opened[FEATURES], few[FEATURES])
    with pytest.raises(UserError, match="none of its Gaussians is known"):
        open_container(few, method, closed["secret"], published)


@pytest.fixture(scope="module")
def unsealable(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A container of GS-Hider, its secret and a key."""
    folder = tmp_path_factory.mktemp("unsealable")
    cover = scene(folder / "cover")
    views = dotted_message(folder / "views", cover)
    chosen = HideScenesParameters.model_validate({**SETTINGS, "method": "gs_hider", "iterations": 1})
    made = run_stage(hide_scenes, chosen, {"cover": cover, "messages": (views,)}, folder / "made")
    key = run_stage(draw_key, DrawKeyParameters(seed=3), {}, folder / "key")["key"]
    return {**made, "key": key}


def test_a_container_that_cannot_be_sealed_is_left_as_it_is(tmp_path: Path, unsealable: Made) -> None:
    left = sealed(tmp_path / "left", unsealable, "gs_hider")
    assert torch.equal(features(left["container"]), features(unsealable["container"]))
    assert SEAL not in left["secret"].attributes


def test_nothing_is_called_sealed_that_cannot_be(tmp_path: Path, hidden: Made, unsealable: Made) -> None:
    with pytest.raises(UserError, match=r"cannot be sealed: its scene decoder reads all.* Set sealed: false"):
        sealed(tmp_path / "asked for", unsealable, "gs_hider", sealed=True)
    with create(tmp_path / "none", "secret", private=True) as writer:
        write_secret(writer, read_method(hidden["container"]), ())
    with pytest.raises(UserError, match="cannot be sealed: nothing is hidden in it"):
        sealed(tmp_path / "empty", hidden | {"secret": load(tmp_path / "none")}, sealed=True)


def test_whoever_wants_a_seal_hears_that_there_is_none(
    tmp_path: Path, hidden: Made, unsealable: Made, recorded: dict[str, Json]
) -> None:
    def said(name: str, made: Made, method: str, **chosen: bool) -> list[str]:
        left = sealed(tmp_path / name, made, method, **chosen)
        return [remark.text for remark in left_open(Finished({}, left, recorded))]

    assert seal.remarks == f"{left_open.__module__}:{left_open.__name__}"
    (text,) = said("left", unsealable, "gs_hider")
    assert "without the secret" in text
    assert said("not wanted", unsealable, "gs_hider", sealed=False) == []
    assert said("sealed", hidden, "homogeneous") == []
    assert isinstance(recorded["left_open"], float)
    assert 0 < recorded["left_open"] < MOST_LEFT_OPEN
    with create(tmp_path / "none", "secret", private=True) as writer:
        write_secret(writer, read_method(hidden["container"]), ())
    assert said("hides nothing", hidden | {"secret": load(tmp_path / "none")}, "homogeneous") == []


def test_a_container_that_hides_nothing_is_left_as_it_is(tmp_path: Path, hidden: Made) -> None:
    with create(tmp_path / "none", "secret", private=True) as writer:
        write_secret(writer, read_method(hidden["container"]), ())
    left = sealed(tmp_path / "left", hidden | {"secret": load(tmp_path / "none")})
    assert left["container"].digest == hidden["container"].digest
    assert SEAL not in left["secret"].attributes


def test_it_is_left_as_it_is_where_no_seal_is_wanted(tmp_path: Path, hidden: Made) -> None:
    left = sealed(tmp_path / "left", hidden, sealed=False)
    assert torch.equal(features(left["container"]), features(hidden["container"]))
    opened = read_container(left["container"], left["secret"]).gaussians
    assert torch.equal(opened[FEATURES].sigmoid(), features(hidden["container"]))


@pytest.mark.parametrize(
    "wrong", [{SEAL: "no number"}, {FACTS[0]: None}, {FACTS[2]: [1.0]}, {SIGNS: "no number"}, {SIGNS: "00"}]
)
def test_a_broken_seal_is_told(tmp_path: Path, closed: Made, wrong: dict[str, object]) -> None:
    with create(tmp_path / "secret", "secret", private=True) as writer:
        for name in closed["secret"].names:
            writer.write(name, closed["secret"].read(name))
        writer.attributes.update(dict(closed["secret"].attributes) | wrong)
    with pytest.raises(UserError, match="the seal in the secret cannot be used"):
        read_container(closed["container"], load(tmp_path / "secret"))


def test_a_seal_of_another_method_is_told(closed: Made) -> None:
    with pytest.raises(UserError, match=r"cannot be used.* the seal of a container of plain"):
        opener(build_method("plain", {"sh_degree": 0}), closed["secret"], read_gaussians(closed["container"]))


def test_what_changes_containers_takes_none_that_is_sealed(closed: Made) -> None:
    with pytest.raises(UserError, match="add_grain was given a sealed container"):
        refuse_sealed(closed["secret"], "add_grain")

"""A container is attacked and measured, with every attack that applies to it, and no measurement is public."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import MANIFEST, Artifact
from pipeline.errors import Interrupted, UserError
from stages.analysis.attacks.catalogue import ATTACKS, ONE_COLOUR, UNATTACKED, restored
from stages.analysis.kept import kept, name_on
from stages.analysis.measurements import MEASUREMENTS_FILE, Measurement, read_measurements, to_lines
from stages.attack import AttackParameters, attack
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.imaging.metric_table import read_rows
from tests.running import run_stage
from tests.stages.small import NAMES, message_views, scene
from tests.stages.test_stopping import Asking

SMALL = {"iterations": 30, "decoder_width": 8, "feature_dim": 16, "message_points": 20}
QUICK = {"cover_losses": (0.5,), "seeds": (0,), "reoptimised": (1, 2), "lpips": False}
FEATURES = {
    "channel_dropping",
    "unread_directions",
    "channel_permutation",
    "feature_mixing",
    "feature_rotation",
    "compensated_rotation",
}
RENDERS = {"jpeg", "resizing"}
SECOND_ATTACK = 7
"""Each severity has one look, and quantisation and stripping have five each."""


def inputs(tmp_path: Path, method: str, hidden: int = 1) -> dict[str, Artifact | tuple[Artifact, ...]]:
    cover, views = scene(tmp_path / "cover"), message_views(tmp_path / "views")
    parameters = HideScenesParameters.model_validate({**SMALL, "method": method, "hidden": hidden})
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, tmp_path / "made")
    return {"container": made["container"], "secret": made["secret"], "cover": cover, "messages": (views,)}


@pytest.mark.parametrize(
    ("method", "without"),
    [
        ("homogeneous", RENDERS),
        pytest.param("gs_hider", RENDERS, marks=pytest.mark.slow),
        ("sh", RENDERS | FEATURES | {"reoptimisation_frozen"}),
        pytest.param("decoder", FEATURES | {"stripping", "reoptimisation_frozen"}, marks=pytest.mark.slow),
    ],
)
def test_every_attack_that_applies_is_measured(tmp_path: Path, method: str, without: set[str]) -> None:
    parameters = AttackParameters.model_validate({**QUICK, "method": method})
    given = inputs(tmp_path, method)
    made = run_stage(attack, parameters, given, tmp_path / "attacked")["measurements"]
    assert made.private
    rows = read_measurements(made)
    expected = ({*ATTACKS, UNATTACKED} - without) | {restored(name) for name in {*ATTACKS} - without - RENDERS}
    assert {row.condition for row in rows} == expected
    assert {row.method for row in rows} == {method}
    assert {row.quantity for row in rows if row.message is None} == {"psnr", "ssim"}
    of_message = {row.quantity for row in rows if row.message == "statue"}
    assert of_message == {"psnr", "ssim", "psnr_covered", ONE_COLOUR}
    shares = {row.severity for row in rows if row.condition == "random_pruning"}
    assert shares >= {0.05, 0.10, 0.15, 0.25}


def test_an_attack_does_not_go_on_without_the_lpips_that_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parameter says that it is measured, so a result without it would be kept under the wrong key."""
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "nothing"))
    monkeypatch.setattr("stages.attack.weights_installed", lambda network: True)
    parameters = AttackParameters.model_validate({**QUICK, "method": "sh", "attacks": ("quantisation",), "lpips": True})
    assert parameters.lpips
    with pytest.raises(UserError, match="LPIPS weights"):
        run_stage(attack, parameters, inputs(tmp_path, "sh"), tmp_path / "attacked")


@pytest.mark.parametrize(("most", "measured"), [(12, NAMES[:5]), (3, NAMES[:5:2])])
def test_test_views_are_measured_or_so_many_of_them_evenly_spread(
    tmp_path: Path, most: int, measured: tuple[str, ...]
) -> None:
    given = inputs(tmp_path, "sh") | {"cover": scene(tmp_path / "five test views", 5)}
    chosen = {"method": "sh", "attacks": ("quantisation",), "test_views": most, "lpips": False}
    made = run_stage(attack, AttackParameters.model_validate(chosen), given, tmp_path / "attacked")["measurements"]
    found = {(row.message, row.quantity): row.value for row in read_measurements(made) if row.condition == UNATTACKED}
    scores = run_stage(evaluate, EvaluateParameters(method="sh", lpips="none"), given, tmp_path / "scores")["scores"]
    rows = [row for row in read_rows(scores) if row.view in measured]
    for message in (None, "statue"):
        for quantity in ("psnr", "ssim"):
            expected = [row.value for row in rows if (row.message, row.quantity) == (message, quantity)]
            assert len(expected) == len(measured)
            assert found[message, quantity] == pytest.approx(sum(expected) / len(expected), rel=1e-4)


def test_a_secret_without_a_message_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the container hides none of the messages"):
        run_stage(attack, AttackParameters(method="gs_hider"), inputs(tmp_path, "gs_hider", 0), tmp_path / "attacked")


def test_a_container_of_another_method_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="made by another method"):
        run_stage(attack, AttackParameters(method="gs_hider"), inputs(tmp_path, "sh"), tmp_path / "attacked")


TWO_ATTACKS = AttackParameters.model_validate({**QUICK, "method": "sh", "attacks": ("quantisation", "stripping")})


def stopped(folder: Path, given: dict[str, Artifact | tuple[Artifact, ...]]) -> Path:
    """The scratch folder of a run that was stopped in the second of `TWO_ATTACKS`."""
    with pytest.raises(Interrupted):
        run_stage(attack, TWO_ATTACKS, given, folder, services=Asking(stop_at=SECOND_ATTACK).services())
    return folder / ".scratch"


def test_it_stops_when_it_is_asked_to_and_goes_on_with_the_next_attack(tmp_path: Path) -> None:
    given = inputs(tmp_path, "sh")
    scratch = stopped(tmp_path / "attacked", given)
    device = describe_drawing(working_device())
    assert (scratch / name_on(device, b"quantisation")).is_dir()
    assert not (scratch / name_on(device, b"stripping")).exists()
    shutil.copytree(scratch, tmp_path / "again" / ".scratch")
    again = run_stage(attack, TWO_ATTACKS, given, tmp_path / "again", services=(second := Asking()).services())
    whole = run_stage(attack, TWO_ATTACKS, given, tmp_path / "whole", services=(third := Asking()).services())
    assert second.looks < third.looks
    assert read_measurements(again["measurements"]) == read_measurements(whole["measurements"])


def test_what_another_device_measured_is_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = inputs(tmp_path, "sh")
    shutil.copytree(stopped(tmp_path / "attacked", given), tmp_path / "again" / ".scratch")
    monkeypatch.setattr("stages.attack.describe_drawing", lambda device: "another device")
    run_stage(attack, TWO_ATTACKS, given, tmp_path / "again", services=(again := Asking()).services())
    run_stage(attack, TWO_ATTACKS, given, tmp_path / "whole", services=(whole := Asking()).services())
    assert again.looks == whole.looks


@pytest.mark.parametrize("left", ["", "{", "half", "lines"])
@pytest.mark.parametrize("file", [MEASUREMENTS_FILE, MANIFEST])
def test_what_a_power_cut_damaged_is_measured_again(tmp_path: Path, file: str, left: str) -> None:
    rows = [Measurement("psnr", float(number), "noise", severity=0.1) for number in range(3)]
    assert kept(tmp_path, "noise", lambda: rows) == tuple(rows)
    assert kept(tmp_path, "noise", lambda: pytest.fail("it is there")) == tuple(rows)
    damaged = tmp_path / "noise" / file
    whole = damaged.read_text()
    damaged.chmod(0o600)
    damaged.write_text({"half": whole[: len(whole) // 2], "lines": to_lines(rows[:1])}.get(left, left))
    assert kept(tmp_path, "noise", lambda: rows) == tuple(rows)
    assert damaged.read_text() == whole

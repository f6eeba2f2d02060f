"""The owner's workflow for a stolen container: it reads what was published and kept, and what was found."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import plyfile
import pytest
import torch

from pipeline.artifact import create, load
from stages.analysis.comparisons import read_comparisons
from stages.analysis.measurements import read_measurements
from stages.analysis.verdicts import IS_YOURS
from stages.draw_key import DrawKeyParameters, draw_key
from stages.export_container import ExportContainerParameters, export_container
from stages.hiding.sealing import SEAL
from stages.hiding.storage import write_container, write_secret
from stages.imaging.metric_table import read_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.psnr import psnr
from stages.scene.cameras import Camera, single_cameras
from stages.seal import SealParameters, seal
from tests.running import run_stage
from tests.stages import small
from tests.stages.analysis.attacks.containers import MESSAGE, cameras, target_and_owner
from tests.stages.scene.splat_files.files import write_ply
from tests.stages.small import NAMES
from tests.workflows.test_published import REPOSITORY, run

WORKFLOW = REPOSITORY / "workflows" / "recover_container.yaml"
TURN, SCALE, SHIFT, SHARE = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), 2.5, np.array([3.0, -1, 7]), 0.85


def hidden(folder: Path) -> Path:
    """What the owner keeps, as hide_photos leaves it."""
    target, owner = target_and_owner("homogeneous")
    made = folder / "made"
    with create(made / "container", "container") as writer:
        write_container(writer, target.gaussians, target.method)
    with create(made / "secret", "secret", private=True) as writer:
        write_secret(writer, owner, [MESSAGE])
    inputs = {name: load(made / name) for name in ("container", "secret")}
    inputs |= run_stage(draw_key, DrawKeyParameters(seed=0), {}, made / "key")
    sealed = run_stage(seal, SealParameters(method="homogeneous"), inputs, made / "sealed")
    assert SEAL in sealed["secret"].attributes
    run_stage(export_container, ExportContainerParameters(), sealed, made / "published")
    kept = folder / "kept"
    kept.mkdir()
    for name in ("bundle", "secret_bundle"):
        (made / "published" / name).rename(kept / f"published.{name}")
    small.scene(kept / "cover_scene.scene")
    return kept


def stolen(published: Path, place: Path) -> np.ndarray:
    """Write a sealed container turned, scaled, shifted, pruned, with permuted channels, and columns in another order.

    Returns the original places of the Gaussians that were not pruned, [K, 3].
    """
    rows = plyfile.PlyData.read(str(published / "container.ply"))["vertex"].data
    generator = np.random.default_rng(0)
    kept = generator.permutation(len(rows))[: round(SHARE * len(rows))]
    columns = {name: rows[name][kept].astype(np.float64) for name in sorted(rows.dtype.names)}
    moved = SCALE * np.stack([columns[axis] for axis in "xyz"], axis=1) @ TURN.T + SHIFT
    columns |= dict(zip("xyz", moved.T, strict=True))
    w, x, y, z = (columns[f"rot_{number}"] for number in range(4))
    turned = [w - z, x - y, y + x, z + w]  # times the quaternion 1 0 0 1 of a quarter turn about z
    columns |= {f"rot_{number}": values for number, values in enumerate(turned)}
    columns |= {f"scale_{axis}": columns[f"scale_{axis}"] + np.log(SCALE) for axis in range(3)}
    features = [name for name in columns if name.startswith("feature_")]
    columns |= dict(
        zip(features, [columns[features[number]] for number in generator.permutation(len(features))], strict=True)
    )
    place.mkdir()
    write_ply(place / "nice scene.ply", columns, text=True)
    return np.stack([rows[axis][kept] for axis in "xyz"], axis=1)


def never_sealed(places: np.ndarray, camera: Camera) -> torch.Tensor:
    """The message as the owner saw it in the Gaussians at these places before they were sealed."""
    target, owner = target_and_owner("homogeneous")
    kept = (target.gaussians.means[:, None] == torch.from_numpy(places)).all(dim=2).any(dim=1)
    assert int(kept.sum()) == len(places)
    return owner.render(target.gaussians.select(kept), camera).pictures[MESSAGE].clamp(0, 1)


def given(place: Path, kept: Path) -> list[str]:
    return [f"--set=found={place}", f"--set=hidden={kept}"]


def test_what_was_stolen_shows_its_owner_the_message(tmp_path: Path, store: Path) -> None:
    kept = hidden(tmp_path)
    places = stolen(kept / "published.bundle", tmp_path / "found")
    made = run(WORKFLOW, store, *given(tmp_path / "found", kept))
    figures = {row.quantity: row.value for row in read_measurements(load(made["recovered"]["figures"]))}
    assert figures[IS_YOURS] == 1
    assert figures["degrees"] == pytest.approx(90, abs=1e-3)
    assert figures["scale"] == pytest.approx(SCALE, rel=1e-5)
    assert (figures["matched"], figures["gaussians_found"], figures["gaussians_published"]) == (1, 170, 200)

    shown = {each.title: each for each in read_comparisons(load(made["revealed"]["pictures"]))}[MESSAGE]
    views = dict(zip(NAMES, single_cameras(cameras()), strict=True))
    likenesses = [
        float(psnr(picture_to_tensor(picture), never_sealed(places, views[name])))
        for picture, name in zip(shown.rendered, shown.names, strict=True)
    ]
    assert min(likenesses) > 40, "those that were pruned took nothing from others; unopened ones have 17"
    assert any(row.message == MESSAGE for row in read_rows(load(made["revealed"]["scores"])))
    private = {("published", "secret"), ("revealed", "pictures"), ("revealed", "scores"), ("path", "videos")}
    for name, output in (*private, ("report", "owner")):
        assert made[name][output].stat().st_mode & 0o077 == 0
    owner, public = ((made["report"][name] / "report.html").read_text() for name in ("owner", "public"))
    assert MESSAGE in owner
    assert MESSAGE not in public
    assert (
        "This is your container: it has 85.0 % of the Gaussians you published, and they are 100.0 % of its own. "
        "It was turned by 90.0"
    ) in owner
    assert "your container" not in public


def test_what_is_not_his_is_told(tmp_path: Path, store: Path) -> None:
    kept = hidden(tmp_path)
    rows = plyfile.PlyData.read(str(kept / "published.bundle" / "container.ply"))["vertex"].data
    others = np.random.default_rng(1)
    foreign = write_ply(tmp_path / "foreign.ply", {name: others.permutation(rows[name]) for name in rows.dtype.names})
    command = [sys.executable, "-m", "pipeline", "run", str(WORKFLOW), "--store", str(store), "--serial"]
    command += ["recovered", *given(foreign, kept)]
    finished = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert finished.returncode == 1
    assert "recovered: failed" in finished.stderr
    assert "the found container matches nothing that was published" in finished.stderr
    assert MESSAGE not in finished.stderr + finished.stdout

"""A found file becomes a container with the published one's method and networks, ready to be recovered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.hiding.columns import columns_of
from stages.hiding.storage import write_container
from stages.import_found import ImportFoundParameters, import_found
from stages.recover import RecoverParameters, recover
from tests.running import run_stage
from tests.stages.analysis.attacks.containers import METHODS, target_and_owner
from tests.stages.scene.splat_files.files import write_ply
from tests.stages.test_stopping import Asking


def published(folder: Path, method: str) -> tuple[Artifact, dict[str, np.ndarray]]:
    """A published container, and the columns of its PLY."""
    target, _ = target_and_owner(method)
    with create(folder / "published", "container") as writer:
        write_container(writer, target.gaussians, target.method)
    container = load(folder / "published")
    return container, columns_of({name: container.read(name) for name in container.names if "/" not in name})


@pytest.mark.parametrize("method", METHODS)
def test_it_is_the_published_container_where_nothing_was_done(tmp_path: Path, method: str) -> None:
    container, columns = published(tmp_path, method)
    place = write_ply(tmp_path / "found.ply", dict(reversed(columns.items())), text=True)
    parameters = ImportFoundParameters(place=place, method=method)
    made = run_stage(import_found, parameters, {"published": container}, tmp_path / "outputs")["container"]
    assert made.digest == container.digest


def test_features_under_another_name_are_read_and_that_is_said(tmp_path: Path) -> None:
    container, columns = published(tmp_path, "homogeneous")
    renamed = {name.replace("feature_", "f_feat_"): values for name, values in columns.items()}
    place = write_ply(tmp_path / "found.ply", dict(reversed(renamed.items())))
    asking, parameters = Asking(), ImportFoundParameters(place=place, method="homogeneous")
    inputs = {"published": container}
    made = run_stage(import_found, parameters, inputs, tmp_path / "outputs", services=asking.services())["container"]
    assert made.digest == container.digest
    assert "no column has a feature's name; f_feat_0, f_feat_1, " in asking.lines[1]


def test_what_is_left_out_is_said_and_features_of_another_number_are_recovered(tmp_path: Path) -> None:
    container, columns = published(tmp_path, "homogeneous")
    del columns["feature_3"]
    columns["x"] = columns["x"].copy()
    columns["x"][:2] = np.nan
    asking, parameters = (
        Asking(),
        ImportFoundParameters(place=write_ply(tmp_path / "a.ply", columns), method="homogeneous"),
    )
    inputs = {"published": container}
    found = run_stage(import_found, parameters, inputs, tmp_path / "found", services=asking.services())["container"]
    assert asking.lines == ["198 Gaussians, of 200 that were published; 2 with values that no scene has are left out"]
    made = run_stage(
        recover, RecoverParameters(method="homogeneous"), {**inputs, "found": found}, tmp_path / "recovered"
    )["container"]
    assert made.read("raw_features").shape == (198, 16)
    others = np.delete(np.arange(16), 3)
    published_features = container.read("raw_features")[
        np.isin(container.read("means")[:, 1], made.read("means")[:, 1])
    ]
    np.testing.assert_allclose(made.read("raw_features")[:, others], published_features[:, others], atol=1e-3)


def test_another_method_than_declared_is_told(tmp_path: Path) -> None:
    container, columns = published(tmp_path, "homogeneous")
    parameters = ImportFoundParameters(place=write_ply(tmp_path / "a.ply", columns), method="gs_hider")
    with pytest.raises(UserError, match="Set the method of every stage that takes it to homogeneous"):
        run_stage(import_found, parameters, {"published": container}, tmp_path / "outputs")

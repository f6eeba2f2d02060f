"""Imported splats are like those of `train_scene`: Gaussians with the method that renders them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.errors import UserError
from pipeline.stage import Services
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import check_method, read_gaussians, read_method
from stages.import_splats import ImportSplatsParameters, import_splats
from stages.scene.cameras import Cameras
from tests.running import run_stage
from tests.stages.scene.splat_files.files import columns, write_ply


@pytest.mark.parametrize("degree", [0, 3])
def test_imported_splats_are_rendered(tmp_path: Path, degree: int) -> None:
    table = columns(20, degree)
    table["z"] += 8
    log: list[str] = []
    file = write_ply(tmp_path / "a.ply", table)
    made = run_stage(
        import_splats, ImportSplatsParameters(file=file), {}, tmp_path, services=Services(log=log.append), private=True
    )["splats"]
    assert made.kind == "splats"
    assert made.private
    check_method(made, "plain")
    gaussians, method = read_gaussians(made), read_method(made)
    assert method.settings == {"sh_degree": degree}
    np.testing.assert_array_equal(np.sort(gaussians.means[:, 2]), np.sort(table["z"]))
    camera = Cameras(("0",), np.eye(4)[None], np.array([[[20.0, 0, 16], [0, 20, 12], [0, 0, 1]]]), 32, 24)
    (shot,) = photographs(gaussians, method, camera)
    assert torch.isfinite(shot.pictures[COVER]).all()
    assert float(shot.alphas.mean()) > 0.1
    assert any("20 Gaussians" in line for line in log)


def test_a_file_that_is_no_splats(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"solid cube")
    with pytest.raises(UserError, match=r"a\.ply.*no known format"):
        run_stage(import_splats, ImportSplatsParameters(file=tmp_path / "a.ply"), {}, tmp_path)

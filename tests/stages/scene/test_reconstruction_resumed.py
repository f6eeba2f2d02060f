"""Structure from motion that was stopped while it matched more pairs gives the bits of one that was not."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.companion import work_together
from stages.scene.lens import Lens
from stages.scene.reconstruction_job import Job, Reconstruction, read_reconstruction, working_name
from tests.stages.scene.rigs import arc
from tests.stages.test_sfm import SIZE, photograph

VIEWS, FIRST = 16, 8
"""All photos, and those among which pairs are matched first: too few to place the others."""


class Stopped(Exception):
    pass


def job(folder: Path) -> Job:
    folder.mkdir()
    cameras = arc(np.zeros(3), views=VIEWS, degrees=50, radius=5.0, height=0.8, size=SIZE, focal=240.0)
    pictures = photograph(cameras)
    for row, number in enumerate([*range(0, VIEWS, 2), *range(1, VIEWS, 2)]):  # named in no order of taking
        cv2.imwrite(str(folder / working_name(row)), pictures[number][..., ::-1])
    first = tuple(combinations(range(FIRST), 2))
    return Job(
        folder,
        (Lens("SIMPLE_RADIAL", (240.0, SIZE[0] / 2, SIZE[1] / 2, 0.0), *SIZE),) * VIEWS,
        focal_known=(False,) * VIEWS,
        taken_by=(0,) * VIEWS,
        poses=None,
        pairs=first,
        pairs_in_need=tuple(sorted({*combinations(range(VIEWS), 2)} - {*first})),
        max_features=8192,
        width=100,
        height=74,
        seed=0,
        threads=1,
    )


def reconstructed(task: Job, stopped: bool = False) -> Reconstruction:
    """The result; if `stopped`, raises `Stopped` once some of the pairs in need are matched."""

    def heard(told: dict) -> None:
        if stopped and told["phase"] == "matching" and told["total"] == len(task.pairs_in_need) and told["done"]:
            raise Stopped

    work_together("sfm", "stages.scene.reconstruction_process", [task.write()], heard, lambda: None)
    return read_reconstruction(task.folder)


def test_stopped_while_the_pairs_in_need_are_matched(tmp_path: Path) -> None:
    undisturbed, task = reconstructed(job(tmp_path / "undisturbed")), job(tmp_path / "stopped")
    with pytest.raises(Stopped):
        reconstructed(task, stopped=True)
    resumed = reconstructed(task)
    assert resumed.rows == undisturbed.rows
    assert len(resumed.rows) > FIRST, "they were needed"
    np.testing.assert_array_equal(resumed.world_to_camera, undisturbed.world_to_camera)
    np.testing.assert_array_equal(resumed.points, undisturbed.points)

"""Photos that no lens took, such as a phone's panorama, are left out; so are the few that would crop all others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from stages.scene.lens import Lens
from stages.scene.reconstruction_job import Job, Reconstruction, read_corners, read_reconstruction

VIEWS, SIZE = 12, (200, 150)
DESCRIBE = """
import sys
from pathlib import Path
from stages.scene.reconstruction_process import describe
import pycolmap
from stages.scene.reconstruction_job import read_job, working_name

job, panoramas = read_job(Path(sys.argv[1])), int(sys.argv[2])
pycolmap.set_random_seed(0)
options = pycolmap.SyntheticDatasetOptions(num_rigs=len(job.lenses), num_frames_per_rig=1, num_points3D=60)
model = pycolmap.synthesize_dataset(options)
for row, key in enumerate(sorted(model.reg_image_ids())):
    model.images[key].name = working_name(row)
    if row < panoramas and sys.argv[3] == "upright":
        camera = model.cameras[model.images[key].camera_id]
        camera.width, camera.height, camera.params = 768, 1024, [1280, 384, 512, 0]
    elif row < panoramas:  # 110 degrees across, as COLMAP places it: its lens cannot be inverted on the left and right
        camera = model.cameras[model.images[key].camera_id]
        camera.width, camera.height, camera.params = 960, 280, [500, 480, 140, -0.257]
describe(job, model, {}).write(job.folder)
"""


def described(folder: Path, others: int, kind: str = "panoramas") -> Reconstruction:
    """The result for a model of `VIEWS` photos, each with its own lens; the first `others` are of this kind."""
    guesses = (Lens("SIMPLE_PINHOLE", (1200.0, 512.0, 384.0), 1024, 768),) * VIEWS
    job = Job(folder, guesses, (False,) * VIEWS, (0,) * VIEWS, None, (), (), 100, *SIZE, seed=0, threads=1)
    command = [sys.executable, "-c", DESCRIBE, str(job.write()), str(others), kind]
    subprocess.run(command, check=True, cwd=Path(__file__).parents[3])
    return read_reconstruction(folder)


@pytest.mark.parametrize("panoramas", [0, 1, 2])
def test_photos_of_estimated_lenses_that_fold_over_are_left_out(tmp_path: Path, panoramas: int) -> None:
    found = described(tmp_path, panoramas)
    assert found.folded == tuple(range(panoramas))
    assert found.rows == tuple(range(panoramas, VIEWS))
    assert len(found.world_to_camera) == len(found.lens_of) == len(read_corners(tmp_path)) == VIEWS - panoramas
    assert found.lens_shares == pytest.approx([1] * (VIEWS - panoramas))
    assert len(found.points) > 30


def test_where_hardly_any_lens_is_one_nothing_was_placed(tmp_path: Path) -> None:
    found = described(tmp_path, VIEWS - 2)
    assert (found.rows, found.folded) == ((), tuple(range(VIEWS - 2)))


@pytest.mark.parametrize(("upright", "left_out"), [(0, 0), (1, 1), (2, 0)])
def test_one_upright_photo_among_wide_ones_is_left_out_and_two_of_twelve_are_not(
    tmp_path: Path, upright: int, left_out: int
) -> None:
    """With it, all pictures would show half of what they could; two are more than a tenth, and stay."""
    found = described(tmp_path, upright, "upright")
    assert (found.cropping, found.folded) == (tuple(range(left_out)), ())
    assert found.rows == tuple(range(left_out, VIEWS))
    assert (min(found.lens_shares) < 0.7) == (upright > left_out)

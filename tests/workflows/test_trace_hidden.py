"""From photos to the verdict on a picture of a container that hides something: renders of the published one are found.

A render of the container from before the grain, which was not published, is not.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import load
from stages.analysis.measurements import read_measurements
from stages.find_grain import FOUND
from stages.hiding.sealing import SEAL
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.rendering import renders
from stages.imaging.pictures import encode_png
from stages.scene.scene import read_scene
from tests.workflows.test_batch_pairs import photograph
from tests.workflows.test_published import REPOSITORY, run

WORKFLOWS = REPOSITORY / "workflows"


@pytest.mark.slow  # three trainings, and SfM
def test_renders_of_what_was_published_are_told(tmp_path: Path) -> None:
    for seed, name in enumerate(("cover", "message")):
        photograph(seed, tmp_path / name)
    changes = {"cover": tmp_path / "cover", "message": tmp_path / "message", "grain": 1.5}
    changes |= {"width": 128, "iterations": 300, "gaussians": 8000}
    settings = [f"--set={name}={value}" for name, value in changes.items()]
    made = run(WORKFLOWS / "hide_photos.yaml", tmp_path / "store", "published", *settings)
    assert SEAL in load(made["sealed"]["secret"]).attributes
    public = {
        f"{name}.{output}" for name, outputs in made.items() for output, at in outputs.items() if not load(at).private
    }
    assert public == {"cover_photos.capture", "cover_scene.scene", "sealed.container", "published.bundle"}

    scene = read_scene(load(made["cover_scene"]["scene"]))
    cameras = scene.cameras.select(scene.test_names[:1])
    suspects = tmp_path / "pictures"
    suspects.mkdir()
    for name, stage in (("copied", "sealed"), ("before", "hide")):
        container = load(made[stage]["container"])
        [picture] = renders(read_gaussians(container), read_method(container), cameras, lambda: None)
        (suspects / f"{name}.png").write_bytes(encode_png(picture))
    (suspects / "photo.png").write_bytes((tmp_path / "cover" / scene.test_names[0]).read_bytes())
    hidden = tmp_path / "store" / "latest" / "hide_photos"
    given = [f"--set=hidden={hidden}", f"--set=pictures={suspects}"]
    found = run(WORKFLOWS / "trace_hidden.yaml", tmp_path / "store", *given)
    assert all(load(at).private for outputs in found.values() for at in outputs.values())
    rows = read_measurements(load(found["found"]["scores"]))
    assert {row.view: row.value for row in rows if row.quantity == FOUND} == {
        "before.png": 0.0,
        "copied.png": 1.0,
        "photo.png": 0.0,
    }

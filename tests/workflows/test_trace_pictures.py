"""From photos to the verdict on a picture: what was rendered from the published bundle is found, a photo is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import load
from stages.analysis.measurements import read_measurements
from stages.find_grain import FOUND
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.rendering import renders
from stages.imaging.pictures import encode_png
from stages.scene.scene import read_scene
from tests.workflows.test_batch_pairs import photograph
from tests.workflows.test_published import REPOSITORY, run

WORKFLOW = REPOSITORY / "workflows" / "trace_pictures.yaml"


@pytest.mark.slow  # a training, and SfM
def test_renders_of_what_was_published_are_found(tmp_path: Path) -> None:
    photograph(0, tmp_path / "cover")
    suspects = tmp_path / "pictures"
    suspects.mkdir()
    changes = {"cover": tmp_path / "cover", "pictures": suspects, "width": 128, "iterations": 300, "grain": 3}
    settings = [f"--set={name}={value}" for name, value in changes.items()]
    made = run(WORKFLOW, tmp_path / "store", "published", "cover_scene", *settings)
    assert (made["published"]["bundle"] / "container.ply").is_file()
    public = {
        f"{name}.{output}" for name, outputs in made.items() for output, at in outputs.items() if not load(at).private
    }
    assert public == {"grain.container", "published.bundle"}

    scene, container = read_scene(load(made["cover_scene"]["scene"])), load(made["grain"]["container"])
    cameras = scene.cameras.select(scene.test_names[:1])
    [picture] = renders(read_gaussians(container), read_method(container), cameras, lambda: None)
    (suspects / "copied.png").write_bytes(encode_png(picture))
    (suspects / "photo.png").write_bytes((tmp_path / "cover" / scene.test_names[0]).read_bytes())
    found = run(WORKFLOW, tmp_path / "store", *settings)["found"]["scores"]
    rows = {row.view: row.value for row in read_measurements(load(found)) if row.quantity == FOUND}
    assert rows == {"copied.png": 1.0, "photo.png": 0.0}

"""Of a folder of pictures, those are named that were rendered from the container with the grain."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.artifact import create, load
from pipeline.stage import Services, run_stage
from stages.add_grain import AddGrainParameters, add_grain
from stages.analysis.measurements import read_measurements
from stages.draw_key import DrawKeyParameters, draw_key
from stages.find_grain import FOUND, SCORE, UNREADABLE, FindGrainParameters, find_grain
from stages.hiding.storage import read_gaussians, read_method
from stages.imaging.pictures import encode_jpeg, encode_png, resize_picture
from stages.scene.capture import Capture, write_capture
from stages.scene.unreadable import write_unreadable_names
from tests.stages import watermarks
from tests.stages.hiding.relocalisation import scenes


def test_pictures_with_the_grain_are_named(tmp_path: Path) -> None:
    gaussians, method = scenes.cloud()
    before = watermarks.stored_splats(tmp_path / "before", gaussians, method)
    cover = watermarks.stored_scene(tmp_path / "cover", gaussians, method, scenes.rig())
    key = run_stage(draw_key, DrawKeyParameters(seed=1), {}, tmp_path / "key")["key"]
    given = {"container": before, "cover": cover, "key": key}
    published = run_stage(add_grain, AddGrainParameters(method="plain", level=3), given, tmp_path / "grain")
    camera = scenes.beside(scenes.rig())
    container = published["container"]
    copied = scenes.photograph(read_gaussians(container), read_method(container), camera)
    own = scenes.photograph(gaussians, method, camera)
    other = scenes.photograph(*scenes.cloud(seed=7), camera)
    files = {
        "copied.jpg": encode_jpeg(copied, 90),
        "grey.png": encode_png(np.repeat(copied[..., :1], 3, axis=-1)),
        "enlarged.png": encode_png(resize_picture(copied, 384, 288)),
        "other.png": encode_png(other),
        "own.png": encode_png(own),
    }
    with create(tmp_path / "suspects", "capture") as writer:
        write_capture(
            writer, Capture(tuple(files), ((128, 96),) * len(files), (None,) * len(files), True), files.__getitem__
        )
        write_unreadable_names(writer, ["broken.jpg"])
    asked = {"before": before, "cover": cover, "key": key, "pictures": load(tmp_path / "suspects")}
    log: list[str] = []
    made = run_stage(find_grain, FindGrainParameters(), asked, tmp_path / "found", services=Services(log=log.append))
    assert made["scores"].private
    rows = {(row.quantity, row.view): row.value for row in read_measurements(made["scores"])}
    assert [name for name in files if rows[FOUND, name]] == ["copied.jpg", "enlarged.png"]
    assert rows[SCORE, "grey.png"] == 0
    assert [line for line in log if "no colour" in line] == [next(line for line in log if "grey.png" in line)]
    assert abs(rows[SCORE, "other.png"]) < 5
    assert [key for key in rows if key[1] == "broken.jpg"] == [(UNREADABLE, "broken.jpg")]
    assert any(line.startswith("broken.jpg: cannot be read") for line in log)
    assert abs(rows[SCORE, "own.png"]) < 5

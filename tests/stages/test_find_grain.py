"""Of a folder of pictures, those rendered from the container with the grain are named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services
from stages.add_grain import AddGrainParameters, add_grain
from stages.analysis.measurements import read_measurements
from stages.draw_key import DrawKeyParameters, draw_key
from stages.find_grain import FOUND, SCORE, UNREADABLE, FindGrainParameters, find_grain
from stages.hiding.storage import read_gaussians, read_method
from stages.hiding.watermark.reading import GrainReader
from stages.imaging.pictures import Picture, encode_jpeg, encode_png, resize_picture
from stages.scene.capture import Capture, write_capture
from stages.scene.unreadable import write_unreadable_names
from tests.running import run_stage
from tests.stages import small, watermarks
from tests.stages.hiding.relocalisation import scenes
from tests.stages.test_stopping import Asking


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
    assert [name for name in files if rows[FOUND, name] == 1] == ["copied.jpg", "enlarged.png"]
    assert rows[SCORE, "grey.png"] == 0
    assert math.isnan(rows[FOUND, "grey.png"]), "not a clean no"
    assert rows[FOUND, "own.png"] == 0
    assert [line for line in log if "no colour" in line] == [next(line for line in log if "grey.png" in line)]
    assert abs(rows[SCORE, "other.png"]) < 5
    assert [key for key in rows if key[1] == "broken.jpg"] == [(UNREADABLE, "broken.jpg")]
    assert any(line.startswith("broken.jpg: inconclusive: the file cannot be read") for line in log)
    assert abs(rows[SCORE, "own.png"]) < 5


class Counted(GrainReader):
    """A reader that counts the pictures it scores; the score identifies a picture."""

    def __init__(self) -> None:
        self.looks = 0

    def score(self, picture: Picture) -> float:
        """The picture's width."""
        self.looks += 1
        return float(picture.shape[1])


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Counted:
    counted = Counted()
    monkeypatch.setattr("stages.find_grain.owners_reader", lambda *given: counted)
    return counted


def suspects(folder: Path, shades: dict[str, int]) -> Artifact:
    """A picture for each name, in one colour, whose shade also sets its width; equal shades give copies."""
    pictures = {name: np.full((4, 4 + shade, 3), (shade, 0, 9), np.uint8) for name, shade in shades.items()}
    return watermarks.stored_capture(folder, pictures)


def found(folder: Path, attempt: str, pictures: Artifact, asking: Asking | None = None) -> dict[str | None, float]:
    """The scores by name; all attempts share a scratch folder."""
    given = {"before": small.splats(folder / attempt / "before"), "cover": small.scene(folder / attempt / "cover")}
    (folder / "scratch").mkdir(exist_ok=True)
    (folder / attempt / ".scratch").symlink_to(folder / "scratch")
    inputs, services = {**given, "pictures": pictures}, (asking or Asking()).services()
    made = run_stage(find_grain, FindGrainParameters(), inputs, folder / attempt, services=services)
    assert made["scores"].private, "even if no input is"
    return {row.view: row.value for row in read_measurements(made["scores"]) if row.quantity == SCORE}


def test_an_interrupted_look_through_goes_on_with_the_next_picture(tmp_path: Path, reader: Counted) -> None:
    pictures = suspects(tmp_path / "pictures", {"a.png": 1, "b.png": 2, "c.png": 3, "d.png": 4})
    with pytest.raises(Interrupted, match="stopped before picture 3 of 4"):
        found(tmp_path, "stopped", pictures, Asking(stop_at=3))
    assert reader.looks == 2
    assert found(tmp_path, "again", pictures) == {"a.png": 5, "b.png": 6, "c.png": 7, "d.png": 8}
    assert reader.looks == 4, "each is looked at once"


def test_what_is_kept_of_a_picture_is_of_its_bytes_and_not_of_its_name(tmp_path: Path, reader: Counted) -> None:
    given = suspects(tmp_path / "pictures", {"a.png": 1, "b.png": 2, "c.png": 2})
    with pytest.raises(Interrupted):
        found(tmp_path, "stopped", given, Asking(stop_at=3))
    changed = suspects(tmp_path / "changed", {"a.png": 7, "b.png": 2, "c.png": 2})
    assert found(tmp_path, "again", changed) == {"a.png": 11, "b.png": 6, "c.png": 6}
    assert reader.looks == 3, "a.png twice, and b.png once with its copy"


def test_a_container_of_another_method_than_declared_is_refused(tmp_path: Path) -> None:
    given = {"before": small.splats(tmp_path / "before"), "cover": small.scene(tmp_path / "cover")}
    pictures = suspects(tmp_path / "pictures", {"a.png": 1})
    with pytest.raises(UserError, match="by another method"):
        run_stage(find_grain, FindGrainParameters(method="sh"), given | {"pictures": pictures}, tmp_path / "found")

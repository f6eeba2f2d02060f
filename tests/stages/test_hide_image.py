"""An image is hidden in one view, decoded there by its secret, and scored where it is hidden."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis.comparisons import read_comparisons
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_image import chosen_view, hide_image
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.key import KEY_BYTES, generator_apart, key_generator, write_key
from stages.imaging.image import filling, read_image, write_image
from stages.imaging.metric_table import read_rows
from stages.scene.scene import read_scene
from tests.running import run_stage
from tests.stages.small import HEIGHT, NAMES, WIDTH, scene

SETTINGS = {"iterations": 150, "decoder_width": 16, "feature_dim": 8, "lambda_message": 1.0, "sh_degree": 1}


@pytest.fixture
def cover(tmp_path: Path) -> Artifact:
    return scene(tmp_path / "cover")


@pytest.fixture
def emblem(tmp_path: Path) -> Artifact:
    """A picture unlike any view of the cover."""
    picture = np.zeros((HEIGHT, 2 * WIDTH, 3), np.uint8)
    picture[6:18, 20:44] = (250, 200, 20)
    with create(tmp_path / "emblem", "image", private=True) as writer:
        write_image(writer, "emblem", picture)
    return load(tmp_path / "emblem")


def test_a_picture_of_a_camera_is_one_file(tmp_path: Path) -> None:
    picture = np.zeros((40, 6000, 3), np.uint8)
    with create(tmp_path / "photo", "image", private=True) as writer:
        write_image(writer, "photo", picture)
    np.testing.assert_array_equal(read_image(load(tmp_path / "photo"))[1], picture)
    assert len([path for path in (tmp_path / "photo").rglob("*") if path.is_file()]) < 8


def hidden(folder: Path, cover: Artifact, emblem: Artifact, **settings: object) -> dict[str, Artifact]:
    parameters = hide_image.parameters.model_validate(SETTINGS | settings)
    return run_stage(hide_image, parameters, {"cover": cover, "image": emblem}, folder)


def scores(folder: Path, made: dict[str, Artifact], cover: Artifact, emblem: Artifact, method: str, lpips="none"):
    inputs = {"container": made["container"], "secret": made["secret"], "cover": cover, "image": emblem}
    return run_stage(evaluate, EvaluateParameters(method=method, lpips=lpips), inputs, folder)


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous", "sh", "decoder"])
def test_the_image_is_decoded_at_its_view(tmp_path: Path, cover: Artifact, emblem: Artifact, method: str) -> None:
    made = hidden(tmp_path / "made", cover, emblem, method=method, view=NAMES[3])
    rows = read_rows(scores(tmp_path / "scores", made, cover, emblem, method)["scores"])
    image = {row.quantity: row for row in rows if row.message == "emblem"}
    assert {row.view for row in image.values()} == {NAMES[3]}
    assert image["hides_image"].value == 1
    black = filling(emblem.read("picture"), WIDTH, HEIGHT) / 255.0
    assert image["psnr"].value > -10 * np.log10((black**2).mean()) + 3


def test_the_public_never_hears_of_the_image(tmp_path: Path, cover: Artifact, emblem: Artifact) -> None:
    made = hidden(tmp_path / "made", cover, emblem, iterations=2)
    assert "emblem" not in str(made["container"].attributes)
    assert not made["container"].private
    assert made["secret"].private
    found = scores(tmp_path / "scores", made, cover, emblem, "gs_hider")
    public = read_rows(found["public_scores"])
    assert public
    assert not any(row.message or row.quantity in ("hides_image", "total_bytes") for row in public)


def test_the_public_cannot_tell_which_view_hides_the_image(tmp_path: Path, cover: Artifact, emblem: Artifact) -> None:
    made = hidden(tmp_path / "made", cover, emblem, iterations=2, view=NAMES[5])
    known = scores(tmp_path / "scores", made, cover, emblem, "gs_hider", lpips="vgg")
    parameters = EvaluateParameters(lpips="vgg")
    unknown = run_stage(evaluate, parameters, {"container": made["container"], "cover": cover}, tmp_path / "unknown")
    assert read_rows(known["public_scores"]) == read_rows(unknown["public_scores"])
    assert unknown["public_pictures"].digest == known["public_pictures"].digest
    owner, public = read_comparisons(known["pictures"]), read_comparisons(known["public_pictures"])
    assert NAMES[5] in owner[0].names
    assert NAMES[5] not in public[0].names
    trained = [row for row in read_rows(known["public_scores"]) if row.split == "train"]
    assert {row.quantity for row in trained} == {"psnr", "ssim"}
    assert len(trained) == 2
    assert not any(row.view for row in trained)
    every = [row.value for row in read_rows(known["scores"]) if row.split == "train" and not row.message]
    assert trained[0].value == pytest.approx(np.mean(every[::2]), abs=1e-9)


def key_of(folder: Path, byte: int) -> Artifact:
    with create(folder / f"key {byte}", "key", private=True) as writer:
        write_key(writer, bytes([byte]) * KEY_BYTES)
    return load(folder / f"key {byte}")


def test_the_key_chooses_the_view(tmp_path: Path, cover: Artifact) -> None:
    """Without a key it is the middle view, which anyone could guess."""
    scene = read_scene(cover)
    chosen = [chosen_view(scene, None, key_of(tmp_path, byte)) for byte in range(40)]
    assert set(chosen) == set(scene.train_names)
    assert chosen_view(scene, None, load(tmp_path / "key 7")) == chosen[7]
    assert chosen_view(scene, NAMES[3], load(tmp_path / "key 7")) == NAMES[3]
    assert chosen_view(scene, None, None) == scene.train_names[len(scene.train_names) // 2]


def test_what_a_training_draws_from_the_key_does_not_tell_the_view(tmp_path: Path, cover: Artifact) -> None:
    """Initial features can be guessed from a container, and initial weights from its decoders."""
    scene = read_scene(cover)
    keys = [key_of(tmp_path, byte) for byte in range(12)]
    chosen = [chosen_view(scene, None, key) for key in keys]
    for generators in ([key_generator(key, 0) for key in keys], [generator_apart(key, "weights") for key in keys]):
        drawn = [scene.train_names[generator.integers(len(scene.train_names))] for generator in generators]
        assert drawn != chosen


def test_the_secret_says_which_view_the_key_chose(tmp_path: Path, cover: Artifact, emblem: Artifact) -> None:
    key = next(
        key
        for key in (key_of(tmp_path, byte) for byte in range(9))
        if chosen_view(read_scene(cover), None, key) != chosen_view(read_scene(cover), None, None)
    )
    parameters = hide_image.parameters.model_validate(SETTINGS | {"iterations": 1})
    made = run_stage(hide_image, parameters, {"cover": cover, "image": emblem, "key": key}, tmp_path / "made")
    assert made["secret"].attributes[IMAGE_VIEW] == chosen_view(read_scene(cover), None, key)


def test_a_view_that_is_not_trained_on_is_refused(tmp_path: Path, cover: Artifact, emblem: Artifact) -> None:
    with pytest.raises(UserError, match="not a training view"):
        hidden(tmp_path / "made", cover, emblem, view=NAMES[0])  # a test view


def test_an_image_that_is_not_the_hidden_one_is_refused(tmp_path: Path, cover: Artifact, emblem: Artifact) -> None:
    made = hidden(tmp_path / "made", cover, emblem, iterations=1)
    with create(tmp_path / "other", "image", private=True) as writer:
        write_image(writer, "other", emblem.read("picture"))
    with pytest.raises(UserError, match="this is not the image that is hidden"):
        scores(tmp_path / "scores", made, cover, load(tmp_path / "other"), "gs_hider")


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
def test_decoders_too_narrow_for_their_start_are_refused(
    tmp_path: Path, cover: Artifact, emblem: Artifact, method: str
) -> None:
    with pytest.raises(UserError, match="decoder_width of at least 3"):
        hidden(tmp_path / "narrow", cover, emblem, method=method, decoder_width=2)
    hidden(tmp_path / "made", cover, emblem, method=method, decoder_width=3, iterations=1)


def test_the_image_fills_the_view_unstretched() -> None:
    wide = np.zeros((10, 40, 3), np.uint8)
    wide[:, 15:25] = 255
    np.testing.assert_array_equal(filling(wide, 10, 10), np.full((10, 10, 3), 255))
    assert filling(wide, 5, 20).shape == (20, 5, 3)
    with pytest.raises(UserError, match="so different a shape; found 200000 x 1 pixels"):
        filling(np.zeros((1, 200_000, 3), np.uint8), 1216, 800)  # enlarged whole, it would take 400 GB

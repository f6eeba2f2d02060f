"""The public files show the cover; with the secret, they also show the messages. No photos are needed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.analysis import filming
from stages.analysis.comparisons import Comparison, read_comparisons
from stages.analysis.videos import read_videos
from stages.export_container import ExportContainerParameters, export_container
from stages.hide_image import hide_image
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.imaging.image import filling, write_image
from stages.imaging.pictures import picture_to_tensor, tensor_to_picture
from stages.imaging.psnr import psnr
from stages.import_container import ImportContainerParameters, import_container
from stages.scene.scene import read_scene
from stages.view_container import ViewContainerParameters, view_container
from tests.running import run_stage
from tests.stages import small
from tests.workflows.secret_windows import SecretWindows, everything_in

FRAMES = ExportContainerParameters(frames=8)
HIDING_VIEW = small.NAMES[3]
PICTURE = "Zebraquartz"
TINY = {"decoder_width": 16, "feature_dim": 8}


@pytest.fixture(scope="module")
def cover(tmp_path_factory: pytest.TempPathFactory) -> Artifact:
    return small.scene(tmp_path_factory.mktemp("small") / "cover")


@pytest.fixture(scope="module")
def of_scenes(tmp_path_factory: pytest.TempPathFactory, cover: Artifact) -> dict[str, Artifact]:
    """What `hide_scenes` made with a message called `statue`, and its bundles."""
    folder = tmp_path_factory.mktemp("scenes")
    views = small.message_views(folder / "views")
    parameters = HideScenesParameters.model_validate(TINY | {"iterations": 4, "method": "homogeneous", "threads": 1})
    made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (views,)}, folder / "made")
    return made | published(folder, made, cover)


@pytest.fixture(scope="module")
def emblem() -> np.ndarray:
    """A picture unlike any view of the cover."""
    picture = np.zeros((small.HEIGHT, 2 * small.WIDTH, 3), np.uint8)
    picture[6:18, 20:44] = (250, 200, 20)
    return picture


@pytest.fixture(scope="module")
def of_a_picture(tmp_path_factory: pytest.TempPathFactory, cover: Artifact, emblem: np.ndarray) -> dict[str, Artifact]:
    """What `hide_image` made, and its bundles."""
    folder = tmp_path_factory.mktemp("picture")
    with create(folder / "emblem", "image", private=True) as writer:
        write_image(writer, PICTURE, emblem)
    settings = TINY | {"iterations": 150, "lambda_message": 1.0, "view": HIDING_VIEW, "threads": 1}
    inputs = {"cover": cover, "image": load(folder / "emblem")}
    made = run_stage(hide_image, hide_image.parameters.model_validate(settings), inputs, folder / "made")
    return made | published(folder, made, cover)


def published(folder: Path, made: dict[str, Artifact], cover: Artifact | None) -> dict[str, Artifact]:
    inputs = {"container": made["container"], "secret": made["secret"]} | ({"cover": cover} if cover else {})
    return run_stage(export_container, FRAMES, inputs, folder / "published")


def seen(
    folder: Path, bundle: Path, secret: Path | None = None, method: str = "gs_hider", **changes: int
) -> dict[str, Artifact]:
    """What the files show to whoever received them."""
    importing = ImportContainerParameters(bundle=bundle, secret=secret, method=method)
    received = run_stage(import_container, importing, {}, folder / "received")
    parameters = ViewContainerParameters.model_validate({"method": method, "pictures": 3, "threads": 1} | changes)
    return run_stage(view_container, parameters, received, folder / "seen")


def pictures(made: dict[str, Artifact], name: str = "pictures") -> dict[str, Comparison]:
    return {each.title: each for each in read_comparisons(made[name])}


def panels(made: dict[str, Artifact], name: str = "videos") -> set[str]:
    return {video.title for video in read_videos(made[name])}


def test_who_has_the_public_files_sees_the_cover(tmp_path: Path, of_scenes: dict[str, Artifact]) -> None:
    made = seen(tmp_path, of_scenes["bundle"].path, method="homogeneous")
    for name in ("", "public_"):
        assert panels(made, f"{name}videos") == {COVER}
        assert pictures(made, f"{name}pictures").keys() == {COVER}
    shown = pictures(made)[COVER]
    assert shown.names == ("0000", "0003", "0007")
    assert not shown.has_truth
    assert made["pictures"].names == ("0/rendered",), "no picture twice, and none that calls itself the truth"
    assert shown.rendered.shape[1:] == (small.HEIGHT, small.WIDTH, 3)
    assert np.asarray(shown.rendered).std() > 0
    assert not np.array_equal(shown.rendered[0], shown.rendered[1]), "the camera moves"


def test_who_has_the_secret_sees_the_message_beside_it(tmp_path: Path, of_scenes: dict[str, Artifact]) -> None:
    alone = seen(tmp_path / "alone", of_scenes["bundle"].path, method="homogeneous")
    secret = of_scenes["secret_bundle"].path
    made = seen(tmp_path / "friend", of_scenes["bundle"].path, secret, "homogeneous")
    assert panels(made) == {COVER, "statue", "side by side"}
    assert pictures(made).keys() == {COVER, "statue"}
    for name in ("videos", "pictures"):
        assert made[name].private
        assert not made[f"public_{name}"].private
        assert made[f"public_{name}"].digest == alone[f"public_{name}"].digest, "the secret changes nothing public"


def test_a_picture_is_seen_from_the_camera_that_hides_it(
    tmp_path: Path, of_a_picture: dict[str, Artifact], cover: Artifact, emblem: np.ndarray
) -> None:
    made = seen(tmp_path, of_a_picture["bundle"].path, of_a_picture["secret_bundle"].path)
    assert panels(made) == {COVER}, "from elsewhere there is nothing of it to see"
    [shown] = pictures(made)[PICTURE].rendered
    method = read_method(of_a_picture["container"], of_a_picture["secret"])
    camera = read_scene(cover).cameras.select([HIDING_VIEW])
    [rendering] = photographs(read_gaussians(of_a_picture["container"]), method, camera)
    np.testing.assert_array_equal(shown, tensor_to_picture(rendering.pictures[PICTURE]))
    truth = filling(emblem, small.WIDTH, small.HEIGHT)
    black = -10 * np.log10(((truth / 255) ** 2).mean())
    assert psnr(picture_to_tensor(shown), picture_to_tensor(truth)) > black + 3
    assert not any(PICTURE.encode() in data for _, data in everything_in(made["public_pictures"]))


def test_the_path_tells_neither_photos_nor_the_view_that_hides_a_picture(
    tmp_path: Path, of_a_picture: dict[str, Artifact], cover: Artifact
) -> None:
    bundle, secret = of_a_picture["bundle"], of_a_picture["secret_bundle"]
    text = (bundle.path / "cameras.json").read_text()
    alone = run_stage(
        export_container, FRAMES, {"container": of_a_picture["container"], "cover": cover}, tmp_path / "alone"
    )
    assert alone["bundle"].digest == bundle.digest, "the secret has no say in it"
    assert not any(name in text for name in small.NAMES)
    rig = read_scene(cover).cameras
    numbers = {number for camera in json.loads(text)["world_to_camera"] for number in camera}
    assert not numbers & {float(each) for each in rig.world_to_camera[:, :3].ravel() if each not in (0, 1)}
    hiding = json.loads((secret.path / "image_camera.json").read_text())["world_to_camera"]
    np.testing.assert_array_equal(np.reshape(hiding, (3, 4)), rig.select([HIDING_VIEW]).world_to_camera[0, :3])
    windows = SecretWindows([json.dumps(hiding).encode(), np.array(hiding).tobytes()])
    assert not [name for name, data in everything_in(bundle) if windows.first_in(data) is not None]
    assert any(windows.first_in(data) is not None for _, data in everything_in(secret))


def test_the_secret_of_scenes_has_no_camera(of_scenes: dict[str, Artifact]) -> None:
    assert "image_camera.json" not in of_scenes["secret_bundle"].files


def test_the_secret_comes_back_bit_for_bit_with_the_camera_beside_it(
    tmp_path: Path, of_a_picture: dict[str, Artifact]
) -> None:
    parameters = ImportContainerParameters(
        bundle=of_a_picture["bundle"].path, secret=of_a_picture["secret_bundle"].path
    )
    received = run_stage(import_container, parameters, {}, tmp_path)
    assert received["container"].digest == of_a_picture["container"].digest
    assert received["secret"].digest == of_a_picture["secret"].digest
    assert received["image_camera"].private
    assert not received["cameras"].private


def test_bundles_of_earlier_versions_are_imported_and_say_what_to_ask_for(
    tmp_path: Path, of_a_picture: dict[str, Artifact]
) -> None:
    earlier = published(tmp_path, of_a_picture, None)
    assert set(earlier["bundle"].files) == set(of_a_picture["bundle"].files) - {"cameras.json"}
    with pytest.raises(UserError, match=r"Ask whoever published it for cameras\.json"):
        seen(tmp_path / "public", earlier["bundle"].path)
    with pytest.raises(UserError, match=r"Ask whoever gave you the secret for image_camera\.json") as raised:
        seen(tmp_path / "secret", of_a_picture["bundle"].path, earlier["secret_bundle"].path)
    assert PICTURE not in str(raised.value)
    assert HIDING_VIEW not in str(raised.value)


def test_the_cover_of_another_secret_is_told(tmp_path: Path, of_a_picture: dict[str, Artifact]) -> None:
    scene = read_scene(small.scene(tmp_path / "original"))
    with create(tmp_path / "other", "scene") as writer:
        original = load(tmp_path / "original")
        for name in original.names:
            writer.write(name, original.read(name))
        writer.attributes |= {"names": [f"other {name}" for name in scene.cameras.names], "test_names": []}
    with pytest.raises(UserError, match="not in this cover") as raised:
        published(tmp_path, of_a_picture, load(tmp_path / "other"))
    assert HIDING_VIEW not in str(raised.value)


def test_what_is_published_large_is_shown_small(tmp_path: Path, of_a_picture: dict[str, Artifact]) -> None:
    """The same view with even numbers of pixels, and fewer frames than were published, evenly spread."""
    bundle, secret = of_a_picture["bundle"].path, of_a_picture["secret_bundle"].path
    made = seen(tmp_path, bundle, secret, width=18, frames=4)
    shown = pictures(made)
    assert shown[COVER].rendered.shape == (3, 14, 18, 3)
    assert shown[PICTURE].rendered.shape == (1, 14, 18, 3)
    assert shown[COVER].names == ("0000", "0002", "0007")
    whole = pictures(seen(tmp_path / "whole", bundle, secret))[COVER].rendered[0]
    assert abs(float(whole.mean()) - float(shown[COVER].rendered[0].mean())) < 12


def test_videos_larger_than_memory_are_refused(
    tmp_path: Path, of_scenes: dict[str, Artifact], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few kilobytes of a stranger's can name a thousand messages."""
    bundle, secret = of_scenes["bundle"].path, of_scenes["secret_bundle"].path
    monkeypatch.setattr(filming, "MOST_BYTES", 8 * 4 * small.HEIGHT * small.WIDTH * 3)  # pictures are doubled
    seen(tmp_path / "cover", bundle, method="homogeneous")
    with pytest.raises(UserError, match=r"2 videos of 8 frames .* fewer frames, or a smaller width"):
        seen(tmp_path / "both", bundle, secret, "homogeneous")

"""From a container in the store to files and back: the same artifacts, bit for bit, and only public facts in files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import plyfile
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.canonical import Json
from pipeline.errors import UserError
from pipeline.stage import Finished
from stages.export_container import ExportContainerParameters, export_container
from stages.export_splats import ExportSplatsParameters, export_splats
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.bundle import CAMERAS
from stages.hiding.camera_reading import read_cameras_file
from stages.hiding.method import build_method
from stages.hiding.remarks import ANOTHER_CONTAINER, not_as_exported
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method, write_container, write_secret
from stages.import_container import ImportContainerParameters, import_container
from stages.scene.camera_path import camera_path
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians, gaussians_at
from stages.scene.scene import read_scene
from stages.train_scene import TrainSceneParameters, train_scene
from tests.running import run_stage
from tests.stages import small

COUPLED = {"feature_dim": 5, "layers": 3, "decoder_width": 12, "kernel_size": 1, "precision": "float32"}
SETTINGS = {
    "gs_hider": COUPLED,
    "homogeneous": COUPLED,
    "plain": {"sh_degree": 3},
    "sh": {"sh_degree": 2},
    "decoder": {"sh_degree": 1, "layers": COUPLED["layers"], "decoder_width": 8, "precision": "float32"},
}
MESSAGES = ["a-name-that-must-not-be-published", "台所\u3000写真"]
COLUMNS_OF_3DGS = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *(f"f_rest_{number}" for number in range(45)),
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
"""In the order of its `save_ply`."""


def stored(folder: Path, name: str, count: int = 20, messages: tuple[str, ...] = ()) -> tuple[Artifact, Artifact]:
    """A container and its secret as a stage writes them, with random values."""
    torch.manual_seed(count)
    method = build_method(name, SETTINGS[name] | ({"messages": messages} if messages else {}))
    generator = np.random.default_rng(count)
    colors = {picture: generator.uniform(size=(count, 3)) for picture in (COVER, *messages)}
    gaussians = gaussians_at(generator.normal(size=(count, 3)), method.initial_attributes(colors, generator))
    shaken = {name: tensor + torch.randn_like(tensor) for name, tensor in gaussians.parameters.items()}
    with create(folder / "container", "container") as writer:
        write_container(writer, Gaussians(shaken), method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, method, messages)
        writer.attributes |= {"view": "Screenshot 3.45\u202fPM.png"} if messages else {}
    return load(folder / "container"), load(folder / "secret")


def exported(folder: Path, container: Artifact, secret: Artifact | None = None) -> dict[str, Artifact]:
    inputs = {"container": container} | ({"secret": secret} if secret else {})
    return run_stage(export_container, ExportContainerParameters(), inputs, folder / "exported")


def imported(folder: Path, method: str, bundle: Path, secret: Path | None = None) -> dict[str, Artifact]:
    parameters = ImportContainerParameters(bundle=bundle, secret=secret, method=method)
    return run_stage(import_container, parameters, {}, folder / "imported")


def published(artifact: Artifact) -> bytes:
    return b"".join(path.read_bytes() for path in artifact.path.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", ["gs_hider", "homogeneous", "sh", "decoder"])
def test_container_and_secret_come_back_bit_for_bit(tmp_path: Path, name: str) -> None:
    container, secret = stored(tmp_path, name, messages=tuple(MESSAGES))
    files = exported(tmp_path, container, secret)
    again = imported(tmp_path, name, files["bundle"].path, files["secret_bundle"].path)
    assert again["container"].digest == container.digest
    assert again["secret"].digest == secret.digest
    assert again["secret"].private


@pytest.mark.parametrize("name", ["gs_hider", "homogeneous", "sh", "decoder"])
def test_a_container_without_gaussians_goes_into_files_and_is_told_when_it_comes_back(
    tmp_path: Path, name: str
) -> None:
    container, _ = stored(tmp_path, name, 0, tuple(MESSAGES))
    bundle = exported(tmp_path, container)["bundle"].path
    with pytest.raises(UserError, match="a file without Gaussians; found 0; expected at least one"):
        imported(tmp_path, name, bundle)


@pytest.mark.parametrize("name", ["gs_hider", "homogeneous", "plain", "sh", "decoder"])
def test_without_the_secret_the_container_comes_back_alone(tmp_path: Path, name: str) -> None:
    container, _ = stored(tmp_path, name, messages=() if name == "plain" else tuple(MESSAGES))
    again = imported(tmp_path, name, exported(tmp_path, container)["bundle"].path)
    assert again["container"].digest == container.digest
    assert again["secret"].attributes["messages"] == []
    assert not again["secret"].names


def test_what_is_public_tells_nothing_of_messages(tmp_path: Path) -> None:
    """Whether there are messages, and how many, changes only values of Gaussians and weights."""
    files = {}
    for count in (0, 1, 2):
        container, secret = stored(tmp_path / str(count), "gs_hider", messages=tuple(MESSAGES[:count]))
        outputs = exported(tmp_path / str(count), container, secret)
        assert not outputs["bundle"].private
        assert outputs["secret_bundle"].private
        content = published(outputs["bundle"])
        assert b"message" not in content.lower()
        assert not any(name.encode() in content for name in MESSAGES)
        header = (outputs["bundle"].path / "container.ply").read_bytes().partition(b"end_header\n")[0]
        sizes = {name: (outputs["bundle"].path / name).stat().st_size for name in outputs["bundle"].files}
        files[count] = (header, sizes, (outputs["bundle"].path / "container.json").read_text())
    assert files[0] == files[1] == files[2]


def test_splats_are_written_as_3dgs_writes_them(tmp_path: Path) -> None:
    """Column by column like its `save_ply`: all harmonics of red, then green, then blue; zero normals; raw values."""
    container, _ = stored(tmp_path, "plain")
    with create(tmp_path / "splats", "splats", private=True) as writer:
        write_container(writer, read_gaussians(container), read_method(container))
    outputs = run_stage(
        export_splats, ExportSplatsParameters(), {"splats": load(tmp_path / "splats")}, tmp_path / "outputs"
    )
    assert outputs["bundle"].private, "they may be a message's"
    data = plyfile.PlyData.read(outputs["bundle"].path / "splats.ply")
    assert not data.text
    assert data.byte_order == "<"
    (vertex,) = data.elements
    assert [each.name for each in vertex.properties] == COLUMNS_OF_3DGS
    assert {each.val_dtype for each in vertex.properties} == {"f4"}
    gaussians = {name: tensor.numpy() for name, tensor in read_gaussians(container).parameters.items()}
    for column in range(3):
        np.testing.assert_array_equal(vertex["xyz"[column]], gaussians["means"][:, column])
        np.testing.assert_array_equal(vertex[f"f_dc_{column}"], gaussians["sh_base"][:, column])
        np.testing.assert_array_equal(vertex[f"scale_{column}"], gaussians["log_scales"][:, column])
        assert not vertex["n" + "xyz"[column]].any()
        for harmonic in range(15):
            np.testing.assert_array_equal(
                vertex[f"f_rest_{15 * column + harmonic}"], gaussians["sh_rest"][:, harmonic, column]
            )
    for column in range(4):
        np.testing.assert_array_equal(vertex[f"rot_{column}"], gaussians["quats"][:, column])
    np.testing.assert_array_equal(vertex["opacity"], gaussians["logit_opacities"])


def test_features_are_named_plainly_and_activations_said(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "gs_hider")
    folder = exported(tmp_path, container)["bundle"].path
    data = plyfile.PlyData.read(folder / "container.ply")
    names = [each.name for each in data["vertex"].properties]
    geometry = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert names == ["x", "y", "z", *(f"feature_{number}" for number in range(5)), *geometry]
    np.testing.assert_array_equal(data["vertex"]["feature_4"], container.read("raw_features")[:, 4])
    description = json.loads((folder / "container.json").read_text())
    assert description["method"] == "gs_hider"
    assert description["settings"] == COUPLED
    assert "sigmoid" in description["columns"]["feature_0 to feature_4"]
    for columns, activation in description["columns"].items():
        assert f"{columns}: {activation}" in data["vertex"].comments


def test_a_ply_alone_is_a_container_where_there_are_no_networks(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "plain")
    ply = exported(tmp_path, container)["bundle"].path / "container.ply"
    assert imported(tmp_path, "plain", ply)["container"].digest == container.digest
    container, _ = stored(tmp_path / "coupled", "gs_hider")
    ply = exported(tmp_path / "coupled", container)["bundle"].path / "container.ply"
    with pytest.raises(UserError, match=r"the weights of scene_decoder are missing.* Give the folder of the bundle"):
        imported(tmp_path / "coupled", "gs_hider", ply)


def test_the_published_path_is_along_the_training_cameras(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "plain")
    cover = small.scene(tmp_path / "cover", test_views=3)
    chosen, inputs = ExportContainerParameters(frames=5, bends=4), {"container": container, "cover": cover}
    bundle = run_stage(export_container, chosen, inputs, tmp_path / "exported")["bundle"]
    scene = read_scene(cover)
    path = read_cameras_file(bundle.path, CAMERAS)
    assert path is not None
    expected = camera_path(scene.cameras.select(scene.cameras.names[3:]), scene.points, 5, 4)
    np.testing.assert_array_equal(path.world_to_camera, expected.world_to_camera)


def test_a_private_container_is_not_published(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "plain")
    with create(tmp_path / "private", "container", private=True) as writer:
        write_container(writer, read_gaussians(container), read_method(container))
    with pytest.raises(UserError, match="would publish a private container"):
        exported(tmp_path, load(tmp_path / "private"))


def test_a_container_that_could_not_be_read_again_is_not_exported(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "plain")
    gaussians, method = read_gaussians(container), read_method(container)
    gaussians.parameters["means"][3, 1] = torch.nan
    with create(tmp_path / "broken", "container") as writer:
        write_container(writer, gaussians, method)
    with pytest.raises(UserError, match="'means' cannot be exported; found NaN or infinity"):
        exported(tmp_path, load(tmp_path / "broken"))


def test_another_method_than_declared_is_told(tmp_path: Path) -> None:
    container, _ = stored(tmp_path, "homogeneous")
    bundle = exported(tmp_path, container)["bundle"].path
    with pytest.raises(UserError, match="Set the method of every stage that takes it to homogeneous"):
        imported(tmp_path, "gs_hider", bundle)


@pytest.mark.parametrize("method", ["gs_hider", "homogeneous"])
@pytest.mark.parametrize("messages", [0, 3])
def test_decoders_too_narrow_to_start_as_colours_come_back(tmp_path: Path, method: str, messages: int) -> None:
    """Features can still start from zeros, and the trained container can be imported."""
    views = [small.message_views(tmp_path / str(number), f"statue {number}") for number in range(messages)]
    made = run_stage(
        hide_scenes,
        HideScenesParameters.model_validate(
            {"method": method, "feature_dim": 4, "layers": 2, "decoder_width": 2, "iterations": 1}
            | {"initial_features": "zeros"}
        ),
        {"cover": small.scene(tmp_path / "scene"), "messages": tuple(views)},
        tmp_path / "hidden",
    )
    files = exported(tmp_path, made["container"], made["secret"])
    again = imported(tmp_path, method, files["bundle"].path, files["secret_bundle"].path)
    assert again["container"].digest == made["container"].digest
    assert again["secret"].digest == made["secret"].digest


def test_trained_containers_come_back_and_show_the_same(tmp_path: Path) -> None:
    """Made by the real stages; pictures of cover and message are those of the original, bit for bit."""
    scene, views = small.scene(tmp_path / "scene"), small.message_views(tmp_path / "views")
    brief = {"iterations": 4, "threads": 1}
    made = run_stage(
        hide_scenes,
        HideScenesParameters(method="homogeneous", feature_dim=8, layers=3, decoder_width=12, **brief),
        {"cover": scene, "messages": (views,)},
        tmp_path / "hidden",
    )
    files = exported(tmp_path, made["container"], made["secret"])
    again = imported(tmp_path, "homogeneous", files["bundle"].path, files["secret_bundle"].path)
    assert again["container"].digest == made["container"].digest
    assert again["secret"].digest == made["secret"].digest
    intrinsics = torch.tensor([[20.0, 0, 8], [0, 20.0, 6], [0, 0, 1]])
    camera = Camera(torch.eye(4), intrinsics, torch.zeros(3), 16, 12)
    before, after = (
        read_method(each["container"], each["secret"]).render(read_gaussians(each["container"]), camera).pictures
        for each in (made, again)
    )
    assert set(before) == {COVER, "statue"}
    assert all(torch.equal(before[name], after[name]) for name in before)

    splats = run_stage(train_scene, TrainSceneParameters(**brief), {"scene": scene}, tmp_path / "plain")["splats"]
    bundle = run_stage(export_splats, ExportSplatsParameters(), {"splats": splats}, tmp_path / "ply")["bundle"]
    plain = imported(tmp_path / "again", "plain", bundle.path / "splats.ply")["container"]
    for name in splats.names:
        np.testing.assert_array_equal(plain.read(name), splats.read(name))


def flip(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:-40] + bytes([data[-40] ^ 1]) + data[-39:])


@pytest.mark.parametrize("secret_of_another", [False, True])
def test_files_that_are_not_what_was_exported_are_told(
    tmp_path: Path, recorded: dict[str, Json], secret_of_another: bool
) -> None:
    """They may fit the method all the same, and show the cover in wrong colours. Without a manifest nobody knows."""

    def said(name: str, bundle: Path, secret: Path) -> list[str]:
        made = imported(tmp_path / name, "gs_hider", bundle, secret)
        return [remark.text for remark in not_as_exported(Finished({}, made, recorded))]

    assert import_container.remarks == f"{not_as_exported.__module__}:{not_as_exported.__name__}"
    made = exported(tmp_path, *stored(tmp_path, "gs_hider", messages=("reef",)))
    bundle, secret = (shutil.copytree(made[name].path, tmp_path / name) for name in ("bundle", "secret_bundle"))
    assert said("whole", bundle, secret) == []
    decoder = secret / "message_decoder.safetensors" if secret_of_another else bundle / "scene_decoder.safetensors"
    flip(decoder)
    text, *others = said("altered", bundle, secret)
    assert text.startswith(f"{decoder.name} is not what was exported")
    assert others == ([] if secret_of_another else [ANOTHER_CONTAINER])
    (decoder.parent / "manifest.json").unlink()
    assert said("untold", bundle, secret) == others


def test_the_secret_tells_a_container_that_a_stranger_altered(tmp_path: Path, recorded: dict[str, Json]) -> None:
    """A single feature of a single Gaussian, which a seal does not protect from being changed; there is no manifest."""
    made = exported(tmp_path, *stored(tmp_path, "gs_hider", messages=("reef",)))
    bundle, secret = (shutil.copytree(made[name].path, tmp_path / name) for name in ("bundle", "secret_bundle"))
    for place in (bundle, secret):
        (place / "manifest.json").unlink()

    def said(name: str) -> list[str]:
        again = imported(tmp_path / name, "gs_hider", bundle, secret)
        return [remark.text for remark in not_as_exported(Finished({}, again, recorded))]

    ply = plyfile.PlyData.read(bundle / "container.ply", mmap=False)
    ply.elements[0].data = np.roll(ply.elements[0].data, 7)
    ply.write(bundle / "container.ply")
    assert said("in another order") == []
    ply.elements[0].data["feature_2"][5] *= -1
    ply.write(bundle / "container.ply")
    assert said("altered") == [ANOTHER_CONTAINER]
    facts = json.loads((secret / "secret.json").read_text(encoding="utf-8"))
    del facts["facts"]["container_sha256"]
    (secret / "secret.json").write_text(json.dumps(facts), encoding="utf-8")
    assert said("with an earlier secret") == []

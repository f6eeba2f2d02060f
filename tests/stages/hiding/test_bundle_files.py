"""Bundles from strangers: whatever is wrong with a file gives one clear error, in bounded time and memory."""

from __future__ import annotations

import json
import os
import re
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.export_container import ExportContainerParameters, export_container
from stages.hiding.bundle_files import read_container_bundle, read_secret_bundle
from stages.hiding.fitting import fitted_method
from stages.hiding.method import build_method
from stages.hiding.rendering import COVER
from stages.hiding.storage import write_container, write_secret
from stages.hiding.weights import read_weights, weights_file
from stages.import_container import ImportContainerParameters, import_container
from stages.scene.gaussians import gaussians_at
from stages.scene.ply.reading import read_ply
from stages.scene.ply.writing import write_ply
from tests.running import run_stage

SETTINGS = {"feature_dim": 5, "layers": 3, "decoder_width": 12, "precision": "float32"}
MESSAGE = "a-name-that-no-error-tells"


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `bundle` and `secret_bundle` of a small container."""
    folder = tmp_path_factory.mktemp("good")
    torch.manual_seed(0)
    method = build_method("gs_hider", SETTINGS | {"messages": [MESSAGE]})
    generator = np.random.default_rng(0)
    colors = {name: generator.uniform(size=(9, 3)) for name in (COVER, MESSAGE)}
    gaussians = gaussians_at(generator.normal(size=(9, 3)), method.initial_attributes(colors, generator))
    with create(folder / "container", "container") as writer:
        write_container(writer, gaussians, method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, method, [MESSAGE])
    inputs = {name: load(folder / name) for name in ("container", "secret")}
    run_stage(export_container, ExportContainerParameters(), inputs, folder)
    return folder


@pytest.fixture
def copied(good: Path, tmp_path: Path) -> Path:
    for name in ("bundle", "secret_bundle"):
        shutil.copytree(good / name, tmp_path / name)
    return tmp_path


def import_from(folder: Path) -> None:
    outputs = folder / "outputs"
    shutil.rmtree(outputs, ignore_errors=True)
    parameters = ImportContainerParameters(bundle=folder / "bundle", secret=folder / "secret_bundle")
    run_stage(import_container, parameters, {}, outputs)


def told(folder: Path) -> str:
    """The error of an import, which must be one line of readable length, without the messages' names."""
    with pytest.raises(UserError) as raised:
        import_from(folder)
    said = str(raised.value)
    assert "\n" not in said
    assert len(said) < 1500
    assert MESSAGE not in said
    return said


def change(path: Path, **changes: Any) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def change_settings(folder: Path, **changes: Any) -> None:
    path = folder / "bundle" / "container.json"
    change(path, settings=json.loads(path.read_text())["settings"] | changes)


def change_attributes(folder: Path, **changes: Any) -> None:
    path = folder / "bundle" / "container.json"
    change(path, attributes=json.loads(path.read_text())["attributes"] | changes)


def change_column(folder: Path, name: str, values: np.ndarray | None) -> None:
    """Replace or add a column; `None` removes it."""
    path = folder / "bundle" / "container.ply"
    rows = read_ply(path).rows("vertex")
    columns = {each: rows[each] for each in rows.dtype.names or ()}
    columns |= {name: values} if values is not None else {}
    write_ply(path, {each: column for each, column in columns.items() if each != name or values is not None})


def keep_rows(folder: Path, count: int) -> None:
    path = folder / "bundle" / "container.ply"
    rows = read_ply(path).rows("vertex")
    write_ply(path, {each: rows[each][:count] for each in rows.dtype.names or ()})


def change_weight(path: Path, name: str, values: np.ndarray | None) -> None:
    weights = {**read_weights(path)} | ({name: values} if values is not None else {})
    path.write_bytes(weights_file({each: kept for each, kept in weights.items() if each != name or values is not None}))


SCENE_DECODER, MESSAGE_DECODER = "bundle/scene_decoder.safetensors", "secret_bundle/message_decoder.safetensors"


def swap_folders(folder: Path) -> None:
    (folder / "bundle").rename(folder / "aside")
    (folder / "secret_bundle").rename(folder / "bundle")
    (folder / "aside").rename(folder / "secret_bundle")


def zip_folder(folder: Path) -> None:
    shutil.make_archive(str(folder.parent / "aside"), "zip", folder)
    shutil.rmtree(folder)
    (folder.parent / "aside.zip").rename(folder)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda folder: shutil.rmtree(folder / "bundle"), "no such PLY file"),
        (
            lambda folder: zip_folder(folder / "bundle"),
            "not a PLY file; found a zip; .* Unpack it, and give the folder",
        ),
        (lambda folder: zip_folder(folder / "secret_bundle"), "found a file; expected a folder.*if this is a zip"),
        (
            lambda folder: (folder / "bundle/container.json").unlink(),
            "no bundle; found container.ply, .* expected a file",
        ),
        (
            lambda folder: (folder / "bundle/container.ply").unlink(),
            "container.ply in it. If the PLY has another name here, rename it",
        ),
        (lambda folder: (folder / SCENE_DECODER).unlink(), "scene_decoder are missing.* Give the folder of the bundle"),
        (lambda folder: (folder / MESSAGE_DECODER).unlink(), "message_decoder are missing"),
        (lambda folder: shutil.rmtree(folder / "secret_bundle"), "no secret bundle; found no folder"),
        (swap_folders, "no bundle; .*This is the secret folder: give it as `secret`"),
        (lambda folder: (folder / "bundle/container.json").write_bytes(b"{"), "no JSON"),
        (lambda folder: (folder / "bundle/container.json").write_bytes(b"\xff\xfe\xfd"), "no JSON"),
        (lambda folder: (folder / "bundle/container.json").write_bytes(b"[" * 10**6), "no JSON"),
        (lambda folder: (folder / "bundle/container.json").write_bytes(b"[" * 10**7), "no description"),
        (lambda folder: os.truncate(folder / "bundle/container.json", 10**8), "no description"),
        (lambda folder: (folder / "bundle/container.json").write_text("[]"), "no description"),
        (lambda folder: change(folder / "bundle/container.json", version=2), "version 2; expected .* version 1"),
        (
            lambda folder: change(folder / "bundle/container.json", format="x" * 10**5),
            "description of the wrong format",
        ),
        (lambda folder: change(folder / "bundle/container.json", method="homogeneous"), "by another method"),
        (lambda folder: change(folder / "bundle/container.json", method="../os"), "not understood"),
        (lambda folder: change(folder / "bundle/container.json", settings=None), "not understood"),
        (lambda folder: change(folder / "bundle/container.json", attributes={"x" * 10**5: [1]}), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[10**18]), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[13, 13]), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[-5]), "not understood"),
        (lambda folder: change_attributes(folder, raw_features="5"), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[True]), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[1, 1, 1, 1, 5]), "not understood"),
        (lambda folder: change_attributes(folder, raw_features=[0]), "'raw_features' is not what .* found 0 values"),
        (lambda folder: change_attributes(folder, raw_features=[4]), "'raw_features' is not what .* found 4 values"),
        (lambda folder: change_attributes(folder, means=[]), r"'means' of another shape; found \(\)"),
        (lambda folder: change_attributes(folder, sh_rest=[5]), r"'sh_rest' of another shape; found \(5,\)"),
        (lambda folder: change_attributes(folder, **{f"a{n}": [0] for n in range(10**4)}), "not understood"),
        (lambda folder: change_attributes(folder, more=[0, 10**18]), "not understood"),
        (lambda folder: change_attributes(folder, more=[2]), "2 of 2 properties .* no more_0, more_1 among"),
        (lambda folder: change_settings(folder, feature_dim=10**9), "'feature_dim' is none; found 1000000000"),
        (lambda folder: change_settings(folder, layers=10**30), "'layers' is none"),
        (lambda folder: change_settings(folder, layers=float("nan")), "'layers' is none; found nan"),
        (lambda folder: change_settings(folder, layers=1024, decoder_width=1024), "scene_decoder do not fit"),
        (lambda folder: change_settings(folder, feature_dim=6), "scene_decoder do not fit .* expected '0.weight'"),
        (lambda folder: change_settings(folder, layers=0), "settings are none of the method gs_hider"),
        (lambda folder: change_settings(folder, decoder_width=-3), "settings are none"),
        (lambda folder: change_settings(folder, decoder_width=0), "settings are none of .* would have no channels"),
        (lambda folder: change_settings(folder, feature_dim=0), "settings are none of .* would have no channels"),
        (lambda folder: change_settings(folder, decoder_width="wide"), "settings are none"),
        (lambda folder: change_settings(folder, precision="float1"), "settings are none"),
        (lambda folder: change_settings(folder, precision="nn"), "settings are none"),
        (lambda folder: change_settings(folder, precision="float64"), "settings are none"),
        (lambda folder: change_settings(folder, precision="x" * 10**5), "'precision' is none"),
        (lambda folder: change_settings(folder, kernel_size=4), "settings are none of .* odd side, not 4"),
        (lambda folder: change_settings(folder, unknown=1), "settings are none of the method gs_hider"),
        (lambda folder: change_settings(folder, messages=["a"]), "'messages' is none"),
        (lambda folder: change_column(folder, "rot_2", None), "'quats'|rot_2"),
        (lambda folder: change_column(folder, "feature_4", None), "no feature_4 among"),
        (lambda folder: change_column(folder, "x", np.arange(9.0)), "'x' is of another type"),
        (lambda folder: change_column(folder, "x", np.full(9, np.nan, "f4")), "'x' of row 0 is not finite"),
        (lambda folder: change_column(folder, "x", np.full(9, 3e38, "f4")), "absurd means; found 9 of 9, .* row 0: 3e"),
        (lambda folder: change_column(folder, "scale_1", np.full(9, 1e38, "f4")), "absurd log_scales"),
        (lambda folder: change_column(folder, "rot_3", np.full(9, 3e38, "f4")), "absurd quats"),
        (lambda folder: change_column(folder, "rot_0", np.zeros(9, "f4")), "quaternions of no length; found 9 of 9"),
        (lambda folder: keep_rows(folder, 0), "a file without Gaussians"),
        (lambda folder: change_weight(folder / SCENE_DECODER, "0.bias", None), r"expected '0.bias' \(12,\)"),
        (lambda folder: change_weight(folder / SCENE_DECODER, "0.bias", np.ones(13, "f4")), r"found '0.bias' \(13,\)"),
        (lambda folder: change_weight(folder / SCENE_DECODER, "../../x", np.ones(1, "f4")), "found '../../x'"),
        (lambda folder: change_weight(folder / SCENE_DECODER, "0.bias", np.full(12, np.inf, "f4")), "NaN or infinity"),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", messages=[MESSAGE, "b"]),
            "message_decoder do not",
        ),
        (lambda folder: change(folder / "secret_bundle/secret.json", messages=[]), "message_decoder, which"),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", messages=[MESSAGE] * 2),
            "without the messages' names",
        ),
        (lambda folder: change(folder / "secret_bundle/secret.json", messages=[COVER]), "without the messages' names"),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", messages=["\ud800"]),
            "without the messages' names",
        ),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", messages=[str(n) for n in range(1001)]),
            "without the messages' names",
        ),
        (lambda folder: change(folder / "secret_bundle/secret.json", messages=MESSAGE), "without the messages' names"),
        (lambda folder: change(folder / "secret_bundle/secret.json", messages=[["a"]]), "without the messages' names"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts=[1]), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"messages": "a"}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": float("nan")}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": ["x"]}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a b": 1}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": 2**53 + 1}), "facts are invalid"),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": [0] * (2**17 + 1)}),
            "facts are invalid",
        ),
        (
            lambda folder: change(folder / "secret_bundle/secret.json", facts={f"a{n}": 0 for n in range(33)}),
            "facts are invalid",
        ),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": [[1]]}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": [float("nan")]}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", facts={"a": "x" * 10**5}), "facts are invalid"),
        (lambda folder: change(folder / "secret_bundle/secret.json", format="gs-hider container"), "the wrong format"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(copied: Path, damage: Callable[[Path], None], expected: str) -> None:
    damage(copied)
    tracemalloc.start()
    try:
        said = told(copied)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert re.search(expected, said), said
    assert peak < 60 * 2**20


@pytest.mark.parametrize("file", ["container.json", "container.ply", "scene_decoder.safetensors"])
@given(data=st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_is_an_answer_or_one_error(good: Path, tmp_path: Path, file: str, data: st.DataObject) -> None:
    """A damaged file of a bundle is still read as a container of its method, or one line says why not."""
    folder = tmp_path / "damaged"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good / "bundle", folder / "bundle")
    content = (good / "bundle" / file).read_bytes()
    place, replaced = data.draw(st.integers(0, len(content))), data.draw(st.integers(0, 40))
    damaged = content[:place] + data.draw(st.binary(max_size=40)) + content[place + replaced :]
    (folder / "bundle" / file).write_bytes(damaged)
    said = ""
    try:
        bundle = read_container_bundle(folder / "bundle")
        fitted_method(folder, bundle.method, bundle.settings, (), bundle.shapes, bundle.networks)
    except UserError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize("network", ["scene_decoder", "message_decoder"])
def test_an_attribute_that_is_called_as_a_network_is_refused(copied: Path, network: str) -> None:
    """In the store, a network's weights are in a group of that name."""
    for number in range(2):
        change_column(copied, f"{network}_{number}", np.zeros(9, np.float32))
    change_attributes(copied, **{network: [2]})
    assert f"'{network}' has the name of a network" in told(copied)


def test_files_beside_a_bundle_are_left_alone(copied: Path) -> None:
    """A message decoder in the public folder is not read: only the parameter `secret` says where secrets are."""
    shutil.copy(copied / MESSAGE_DECODER, copied / "bundle")
    (copied / "bundle" / "notes.txt").write_text("mine")
    parameters = ImportContainerParameters(bundle=copied / "bundle")
    outputs = run_stage(import_container, parameters, {}, copied / "outputs")
    assert not outputs["secret"].names


def test_a_folder_that_cannot_be_looked_into_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be read; found File name too long"):
        read_secret_bundle(tmp_path / ("x" * 300))


def test_a_ply_of_another_origin_is_told(tmp_path: Path) -> None:
    write_ply(tmp_path / "splats.ply", {name: np.zeros(2, np.float32) for name in "xyz"}, ["Generated by someone"])
    with pytest.raises(UserError, match="does not say which container it is"):
        run_stage(import_container, ImportContainerParameters(bundle=tmp_path / "splats.ply"), {}, tmp_path / "outputs")

"""Files of a found container, as other programs and thieves leave them: read by column names, or a clear error."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import plyfile
import pytest

from pipeline.errors import UserError
from stages.hiding.columns import columns_of
from stages.hiding.found_files import read_found
from tests.stages.scene.splat_files.files import compressed_ply, records, write_ply

COUNT, CHANNELS = 9, 4
SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "raw_features": (CHANNELS,)}
OF_3DGS = SHAPES | {"sh_base": (3,), "sh_rest": (3, 3)}


def attributes(shapes: dict[str, tuple[int, ...]] = SHAPES) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(0)
    return {name: generator.normal(size=(COUNT, *shape)).astype(np.float32) for name, shape in shapes.items()}


def table(shapes: dict[str, tuple[int, ...]] = SHAPES) -> dict[str, np.ndarray]:
    return columns_of(attributes(shapes))


def refused(place: Path) -> str:
    with pytest.raises(UserError) as refusal:
        read_found(place, SHAPES)
    return str(refusal.value)


@pytest.mark.parametrize(
    "saved",
    [
        {},
        {"text": True},
        {"byte_order": ">"},
    ],
)
def test_any_format_order_and_type_of_columns_will_do(tmp_path: Path, saved: dict) -> None:
    """Other columns stand between the known ones, and no comment says that the file is a container."""
    columns = table(OF_3DGS)
    mixed = {"segment": np.arange(COUNT, dtype=np.int32)}
    for name in reversed(columns):
        mixed |= {name: columns[name].astype(np.float64), f"{name}_gradient": np.full(COUNT, np.nan, np.float32)}
    found = read_found(write_ply(tmp_path / "saved.ply", mixed, **saved), OF_3DGS)
    assert found.left_out == 0
    assert found.attributes.keys() == OF_3DGS.keys()
    for name, values in attributes(OF_3DGS).items():
        assert found.attributes[name].dtype == np.float32
        np.testing.assert_array_equal(found.attributes[name], values)


def test_harmonics_may_have_been_padded_to_a_higher_degree(tmp_path: Path) -> None:
    """Programs that write degree 3 always; all of red is stored before green, which is then numbered anew."""
    padded = attributes(OF_3DGS)
    padded["sh_rest"] = np.concatenate([padded["sh_rest"], np.zeros((COUNT, 12, 3), np.float32)], axis=1)
    found = read_found(write_ply(tmp_path / "padded.ply", columns_of(padded)), OF_3DGS)
    np.testing.assert_array_equal(found.attributes["sh_rest"], attributes(OF_3DGS)["sh_rest"])


def test_harmonics_that_were_dropped_are_told(tmp_path: Path) -> None:
    left = {name: values for name, values in table(OF_3DGS).items() if not name.startswith("f_rest")}
    with pytest.raises(UserError, match="dropped harmonics"):
        read_found(write_ply(tmp_path / "dropped.ply", left), OF_3DGS)


def test_features_may_be_more_or_fewer_and_need_not_be_numbered_anew(tmp_path: Path) -> None:
    columns = table()
    more = columns | {"feature_9": columns["x"], "feature_10": columns["y"], "feature_0005": columns["z"]}
    more["feature_00"] = columns["x"]  # the published name counts
    features = read_found(write_ply(tmp_path / "more.ply", more), SHAPES).attributes["raw_features"]
    np.testing.assert_array_equal(
        features, np.hstack([attributes()["raw_features"], attributes()["means"][:, [2, 0, 1]]])
    )
    del columns["feature_0"], columns["feature_2"]
    fewer = read_found(write_ply(tmp_path / "fewer.ply", columns), SHAPES).attributes["raw_features"]
    np.testing.assert_array_equal(fewer, attributes()["raw_features"][:, 1::2])


def test_features_may_be_numbered_with_leading_zeros(tmp_path: Path) -> None:
    shapes = SHAPES | {"raw_features": (16,)}
    columns = table(shapes)
    padded = {re.sub("feature_([0-9])$", "feature_0\\1", name): values for name, values in columns.items()}
    found = read_found(write_ply(tmp_path / "padded.ply", padded), shapes)
    np.testing.assert_array_equal(found.attributes["raw_features"], attributes(shapes)["raw_features"])


def test_channels_beyond_all_measure_are_not_read(tmp_path: Path) -> None:
    many = table() | {f"feature_{number}": np.zeros(COUNT, np.float32) for number in range(2000)}
    assert read_found(write_ply(tmp_path / "many.ply", many), SHAPES).attributes["raw_features"].shape == (COUNT, 1024)


def test_gaussians_that_no_scene_has_are_left_out(tmp_path: Path) -> None:
    """Quaternions of any length but 0 count as rotations, and infinite logits as opacities of 0 or 1."""
    columns = {name: values.astype(np.float64) for name, values in table().items()}
    for row, (name, value) in enumerate(
        {"x": np.nan, "feature_1": np.inf, "y": 1e30, "z": 1e300, "scale_0": 99.0, "rot_0": 3e38}.items()
    ):
        columns[name][row] = value
    columns["opacity"][6:8] = np.inf, -np.inf
    for number in range(4):
        columns[f"rot_{number}"][8] = 0
    found = read_found(write_ply(tmp_path / "broken.ply", columns), SHAPES)
    assert found.left_out == 6
    np.testing.assert_array_equal(found.attributes["means"], attributes()["means"][5:8])
    np.testing.assert_array_equal(found.attributes["logit_opacities"][1:], [30, -30])
    assert found.attributes["quats"][0, 0] == np.float32(3e38)


@pytest.mark.parametrize("count", [0, COUNT])
def test_a_file_of_which_nothing_is_left_is_told(tmp_path: Path, count: int) -> None:
    columns = {name: np.full(count, np.nan, np.float32) for name in table()}
    said = refused(write_ply(tmp_path / "none.ply", columns))
    assert "a file without Gaussians that a scene may have" in said
    assert f"found {count}" in said


def test_the_only_ply_of_a_folder_is_taken_or_the_one_that_is_called_as_it_was(tmp_path: Path) -> None:
    write_ply(tmp_path / "Stolen.PLY", table())
    (tmp_path / "readme.txt").write_text("mine")
    assert len(read_found(tmp_path, SHAPES).attributes["means"]) == COUNT
    write_ply(tmp_path / "another.ply", {"x": np.zeros(3)})
    assert "several files that may be the container; found Stolen.PLY, another.ply" in refused(tmp_path)
    write_ply(tmp_path / "container.ply", table())
    assert len(read_found(tmp_path, SHAPES).attributes["means"]) == COUNT


def test_a_folder_without_a_ply_is_told(tmp_path: Path) -> None:
    assert "no container; found an empty folder" in refused(tmp_path)
    for number in range(7):
        (tmp_path / f"{number}.jpg").touch()
    assert "found 0.jpg, 1.jpg, 2.jpg, 3.jpg, 4.jpg and 2 more; expected container.ply" in refused(tmp_path)


def test_splats_without_the_features_of_a_container_are_told(tmp_path: Path) -> None:
    columns = {name: values for name, values in table(OF_3DGS).items() if not name.startswith("feature")}
    said = refused(write_ply(tmp_path / "plain.ply", columns))
    assert "not a container like the published one; found no columns feature_0 among x, y, z" in said
    assert "hide no message" in said


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("found.SPLAT", records().tobytes(), "a .splat"),
        ("found.compressed.ply", compressed_ply([[0, 0, 0, 0]], [[0.0] * 18]), "a compressed PLY"),
    ],
    ids=["splat", "compressed"],
)
def test_formats_that_keep_no_features_are_told(tmp_path: Path, name: str, content: bytes, what: str) -> None:
    (tmp_path / name).write_bytes(content)
    said = refused(tmp_path / name)
    assert f"a file in a format without features; found {what}; expected a PLY" in said
    assert "the message in them, are gone" in said
    assert "Look for an uncompressed PLY" in said


def test_a_ply_is_read_whatever_its_name(tmp_path: Path) -> None:
    assert len(read_found(write_ply(tmp_path / "found.splat", table()), SHAPES).attributes["means"]) == COUNT


def test_what_is_no_number_is_told(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "listed.ply", table())
    rows = plyfile.PlyData.read(str(path))["vertex"].data
    wide = np.empty(COUNT, [*((name, "f4") for name in rows.dtype.names[:-1]), (rows.dtype.names[-1], "O")])
    for name in rows.dtype.names:
        wide[name] = rows[name] if name != "rot_3" else [np.zeros(2, np.float32)] * COUNT
    plyfile.PlyData([plyfile.PlyElement.describe(wide, "vertex", val_types={"rot_3": "f4"})]).write(str(path))
    assert "the element 'vertex' of a PLY cannot be read" in refused(path)

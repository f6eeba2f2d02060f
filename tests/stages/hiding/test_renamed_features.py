"""A found container with renamed features: read if it is clear which they are, else the error says what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stages.hiding.found_files import read_found
from tests.stages.hiding.test_found_files import CHANNELS, SHAPES, attributes, refused, table
from tests.stages.scene.splat_files.files import write_ply

OTHERS = {name: values for name, values in table().items() if not name.startswith("feature")}
FEATURES = attributes()["raw_features"].T


def numbered(stem: str, *numbers: int) -> dict[str, np.ndarray]:
    """The features under other names, last first, and the other columns."""
    return OTHERS | {f"{stem}{number}": FEATURES[place] for place, number in reversed([*enumerate(numbers)])}


@pytest.mark.parametrize(("stem", "numbers"), [("f_feat_", (0, 1, 2, 3)), ("c", (8, 9, 10, 11))])
def test_as_many_columns_of_one_name_are_the_features(tmp_path: Path, stem: str, numbers: tuple[int, ...]) -> None:
    columns = numbered(stem, *numbers) | {"confidence": OTHERS["x"], "f_rest_0": OTHERS["x"], "nx": OTHERS["x"]}
    found = read_found(write_ply(tmp_path / "renamed.ply", columns), SHAPES)
    np.testing.assert_array_equal(found.attributes["raw_features"], attributes()["raw_features"])
    assert found.renamed == tuple(f"{stem}{number}" for number in numbers)


def test_features_of_their_own_names_are_read_whatever_stands_beside_them(tmp_path: Path) -> None:
    columns = {name.replace("feature_", "c"): np.zeros_like(values) for name, values in table().items()} | table()
    found = read_found(write_ply(tmp_path / "both.ply", columns), SHAPES)
    assert found.renamed == ()
    np.testing.assert_array_equal(found.attributes["raw_features"], attributes()["raw_features"])


@pytest.mark.parametrize(
    "columns",
    [
        numbered("c", 0, 1, 2),
        numbered("c", 0, 1, 2, 3) | {"c4": OTHERS["x"]},
        numbered("c", 0, 1, 2, 3) | numbered("d", 0, 1, 2, 3),
        OTHERS | dict.fromkeys(("red_shift", "blue", "left", "up"), OTHERS["x"]),
    ],
)
def test_where_it_is_not_plain_the_columns_are_named_with_what_to_do(
    tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    said = refused(write_ply(tmp_path / "renamed.ply", columns))
    assert "hide no message" not in said
    assert "These may be its features: " in said
    assert "Rename them to feature_0, ... in their order." in said


def test_other_columns_that_are_missing_are_not_called_features(tmp_path: Path) -> None:
    columns = {name.replace("scale_", "size_"): values for name, values in table().items()}
    said = refused(write_ply(tmp_path / "renamed.ply", columns))
    assert "These may be the missing ones: size_0, size_1, size_2. Rename them as they were" in said


def test_columns_of_whole_numbers_are_no_features(tmp_path: Path) -> None:
    whole = {f"c{number}": np.zeros(len(OTHERS["x"]), np.int32) for number in range(CHANNELS)}
    assert "hide no message" in refused(write_ply(tmp_path / "plain.ply", OTHERS | whole))

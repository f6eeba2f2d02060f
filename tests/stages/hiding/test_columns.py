"""Attributes of any shape come back from their columns bit for bit, in 3DGS's order where it has one."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.errors import UserError
from stages.hiding import columns
from stages.hiding.bundle import ContainerBundle, write_gaussians
from stages.hiding.bundle_files import read_container_bundle
from stages.hiding.columns import columns_of

VALUES = st.floats(width=32, allow_nan=False, allow_infinity=False)
GEOMETRY = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": ()}


@st.composite
def bundles(draw: st.DrawFn) -> ContainerBundle:
    """Bundles of 0 to 5 Gaussians, with any of the methods' attributes and one that no method has."""
    count, harmonics, messages = draw(st.integers(0, 5)), draw(st.sampled_from([0, 3, 8, 15])), draw(st.integers(1, 3))
    optional = {
        "sh_base": (3,),
        "sh_rest": (harmonics, 3),
        "raw_features": (draw(st.integers(1, 20)),),
        "message_sh_base": (messages, 3),
        "message_sh_rest": (messages, harmonics, 3),
        "something_new": draw(st.sampled_from([(), (1,), (2, 0), (2, 3, 2)])),
    }
    chosen = draw(st.lists(st.sampled_from(sorted(optional)), unique=True))
    shapes = GEOMETRY | {name: optional[name] for name in chosen}
    attributes = {name: draw(arrays.arrays("<f4", (count, *shape), elements=VALUES)) for name, shape in shapes.items()}
    return ContainerBundle("a_method", {"sh_degree": 3, "share": draw(VALUES), "word": "x"}, attributes)


@given(bundle=bundles())
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_attributes_of_any_shape_come_back_bit_for_bit(tmp_path: Path, bundle: ContainerBundle) -> None:
    write_gaussians(tmp_path / "container.ply", bundle)
    again = read_container_bundle(tmp_path / "container.ply")
    assert (again.method, again.settings) == (bundle.method, bundle.settings)
    assert again.shapes == bundle.shapes
    for name, values in bundle.attributes.items():
        assert again.attributes[name].tobytes() == values.tobytes()
        assert again.attributes[name].dtype == np.float32


def test_columns_of_two_attributes_may_not_have_one_name() -> None:
    with pytest.raises(ValueError, match="another's names"):
        columns_of({name: np.zeros((1, 2), np.float32) for name in ("raw_features", "feature")})


@pytest.mark.usefixtures("any_arrays")
@pytest.mark.parametrize(
    "wrong",
    [
        {"quats": np.zeros((2, 4))},
        {"quats": np.full((2, 4), np.inf, np.float32)},
        {"quats": np.zeros((3, 4), np.float32)},
        {"raw_features": np.zeros((1, 5), np.float32)},
        {"logit_opacities": np.zeros((), np.float32)},
        {"quats": None},
    ],
)
def test_what_could_not_be_read_again_is_not_written(tmp_path: Path, wrong: dict[str, np.ndarray | None]) -> None:
    attributes = {name: np.zeros((2, *shape), np.float32) for name, shape in GEOMETRY.items()} | wrong
    bundle = ContainerBundle(
        "a_method", {}, {name: values for name, values in attributes.items() if values is not None}
    )
    with pytest.raises(UserError, match="cannot be exported"):
        write_gaussians(tmp_path / "container.ply", bundle)
    assert not (tmp_path / "container.ply").exists()


def test_examples() -> None:
    assert doctest.testmod(columns).failed == 0

"""Splats of every format become the same stored values, and a broken file gives a one-line error."""

from __future__ import annotations

import math
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import UserError
from stages.scene.spherical_harmonics import CONSTANT_HARMONIC
from stages.scene.splat_files.reading import read_splats
from tests.stages.scene.splat_files.files import REST, columns, compressed_ply, pack, records, write_ply

REAL = Path(__file__).resolve().parents[5] / "shared" / "data" / "splats"
LOW = [-1.0, 0.0, 2.0, math.log(0.1), math.log(0.2), math.log(0.3), 0.0, 0.5, -0.2]
HIGH = [1.0, 4.0, 3.0, math.log(0.4), math.log(0.2), math.log(3.0), 1.0, 0.75, 1.2]
LEAST = [0, pack([0, 0, 512, 512], (2, 10, 10, 10)), 0, 0]
LARGEST = [pack([2047, 1023, 2047], (11, 10, 11)), LEAST[1], pack([2047, 1023, 2047], (11, 10, 11)), 2**32 - 1]

fuzzed = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def refusal(path: Path, content: bytes) -> str:
    path.write_bytes(content)
    with pytest.raises(UserError) as raised:
        read_splats(path)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 1000
    return str(raised.value)


def test_a_single_gaussian_is_no_view_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(records(1).tobytes())
    with warnings.catch_warnings(action="error"):
        gaussians, _ = read_splats(tmp_path / "a.splat")
    gaussians["means"][0, 0] = 1.0  # in read-only mapped memory this would end the process


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("form", ["little", "big", "ascii"])
def test_ply_of_3dgs(tmp_path: Path, degree: int, form: str) -> None:
    table = columns(7, degree)
    path = write_ply(tmp_path / "any name", table, ">" if form == "big" else "<", text=form == "ascii")
    gaussians, found = read_splats(path)
    assert found == degree
    assert len(gaussians) == 7
    assert all(tensor.dtype == torch.float32 for tensor in gaussians.parameters.values())

    def close(name: str, *properties: str) -> None:
        expected = np.stack([table[each] for each in properties], axis=1)
        np.testing.assert_allclose(gaussians[name].numpy().reshape(7, -1), expected, rtol=1e-6)

    close("means", "x", "y", "z")
    close("quats", "rot_0", "rot_1", "rot_2", "rot_3")
    close("log_scales", "scale_0", "scale_1", "scale_2")
    close("logit_opacities", "opacity")
    close("sh_base", "f_dc_0", "f_dc_1", "f_dc_2")
    each = REST[degree] // 3  # the number of harmonics per colour; the file groups them by colour
    close("sh_rest", *(f"f_rest_{color * each + k}" for k in range(each) for color in range(3))) if each else None
    assert gaussians["sh_rest"].shape == (7, each, 3)


def test_other_properties_types_and_elements_do_not_matter(tmp_path: Path) -> None:
    table = {name: column.astype(np.float64) for name, column in reversed(columns(4, 1).items())}
    table["quality"] = np.arange(4, dtype=np.uint8)
    plain, _ = read_splats(write_ply(tmp_path / "a.ply", columns(4, 1)))
    path = write_ply(tmp_path / "b.ply", table)
    with_faces = path.read_bytes().replace(b"end_header\n", b"element face 1\nproperty list uchar int v\nend_header\n")
    path.write_bytes(with_faces + b"\x03" + bytes(12))
    other, _ = read_splats(path)
    for name, tensor in plain.parameters.items():
        torch.testing.assert_close(other[name], tensor, rtol=0, atol=0)


@pytest.mark.parametrize("width", [0.0, 0.3, 50.0])
def test_the_filter_of_mip_splatting_is_part_of_sizes_and_opacities(tmp_path: Path, width: float) -> None:
    """Without it, Gaussians would be too thin and too opaque; a filter of no width changes nothing."""
    table = columns(7, 0)
    read, _ = read_splats(write_ply(tmp_path / "a.ply", {**table, "filter_3D": np.full(7, width, np.float32)}))
    variances = np.exp(np.stack([table[f"scale_{axis}"] for axis in range(3)], axis=1).astype(np.float64)) ** 2
    larger = variances + np.float32(width).astype(np.float64) ** 2
    opacities = 1 / (1 + np.exp(-table["opacity"].astype(np.float64))) * np.sqrt((variances / larger).prod(axis=1))
    np.testing.assert_allclose(read.scales.numpy(), np.sqrt(larger), rtol=1e-5)
    np.testing.assert_allclose(read.opacities.numpy(), opacities, rtol=1e-5)
    plain, _ = read_splats(write_ply(tmp_path / "b.ply", table))
    for name in read.parameters.keys() - {"log_scales", "logit_opacities"}:
        torch.testing.assert_close(read[name], plain[name], rtol=0, atol=0)


def test_filters_and_opacities_that_are_not_finite(tmp_path: Path) -> None:
    """Opacity 1 may be stored as an infinite logit; without a filter it stays the largest that is kept."""
    table = columns(5, 0) | {"filter_3D": np.zeros(5, np.float32)}
    table["opacity"][:2] = np.inf, -np.inf
    read, _ = read_splats(write_ply(tmp_path / "a.ply", table))
    np.testing.assert_array_equal(read["logit_opacities"][:2], [30, -30])
    table["filter_3D"][3] = np.nan
    said = refusal(tmp_path / "b.ply", write_ply(tmp_path / "whole.ply", table).read_bytes())
    assert "log_scales of NaN or infinity" in said
    assert "1 of 5, the first in row 3" in said


def test_splat(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(records().tobytes())
    gaussians, degree = read_splats(tmp_path / "a.splat")
    assert degree == 0
    assert gaussians.means.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    torch.testing.assert_close(gaussians.scales[1], torch.tensor([0.5, 0.25, 0.125]))
    assert gaussians["quats"][1].tolist() == [0.5, 0.0, -0.5, -1.0]
    torch.testing.assert_close(gaussians.opacities, torch.full((3,), 0.4))
    torch.testing.assert_close(gaussians["sh_base"][2] * CONSTANT_HARMONIC + 0.5, torch.tensor([1.0, 0.0, 0.2]))
    assert gaussians["sh_rest"].shape == (3, 0, 3)


def test_opacities_of_none_and_all_stay_finite(tmp_path: Path) -> None:
    rows = records(2)
    rows["color"][:, 3] = [0, 255]
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    opacities = read_splats(tmp_path / "a.splat")[0].opacities
    assert (255 * opacities).tolist() == pytest.approx([0.25, 254.75])
    table = columns(2, 0) | {"opacity": np.array([-np.inf, np.inf], np.float32)}
    logits = read_splats(write_ply(tmp_path / "a.ply", table))[0]["logit_opacities"]
    assert torch.isfinite(logits).all()
    assert logits.sigmoid().tolist() == pytest.approx([0, 1], abs=1e-12)


def test_compressed_ply(tmp_path: Path) -> None:
    middle = [0, LEAST[1], pack([1024, 0, 0], (11, 10, 11)), pack([0, 51, 0, 102], (8, 8, 8, 8))]
    path = tmp_path / "a.ply"
    path.write_bytes(compressed_ply([LEAST, LARGEST, middle], [LOW + HIGH]))
    gaussians, degree = read_splats(path)
    assert degree == 0
    torch.testing.assert_close(gaussians.means[:2], torch.tensor([LOW[:3], HIGH[:3]]))
    torch.testing.assert_close(gaussians["log_scales"][:2], torch.tensor([LOW[3:6], HIGH[3:6]]))
    torch.testing.assert_close(gaussians["sh_base"][:2] * CONSTANT_HARMONIC + 0.5, torch.tensor([LOW[6:], HIGH[6:]]))
    torch.testing.assert_close(gaussians.opacities[2], torch.tensor(0.4))
    torch.testing.assert_close(gaussians["sh_base"][2, 1] * CONSTANT_HARMONIC + 0.5, torch.tensor(0.5 + 0.2 * 0.25))


@pytest.mark.parametrize("largest", range(4))
def test_rotations_of_a_compressed_ply(tmp_path: Path, largest: int) -> None:
    quat = torch.tensor([0.1, -0.3, 0.2, 0.35])
    quat[largest] = 0.0
    quat[largest] = (1 - quat.square().sum()).sqrt()
    others = [round((float(value) / math.sqrt(2) + 0.5) * 1023) for at, value in enumerate(quat) if at != largest]
    turned = [0, pack([largest, *others], (2, 10, 10, 10)), 0, 0]
    (tmp_path / "a.ply").write_bytes(compressed_ply([turned], [LOW + HIGH]))
    torch.testing.assert_close(read_splats(tmp_path / "a.ply")[0]["quats"][0], quat, rtol=0, atol=1e-3)


def test_chunks_and_the_first_version_without_colours(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(compressed_ply([LEAST] * 300, [LOW + HIGH, [7.0] * 18]))
    means = read_splats(tmp_path / "a.ply")[0].means
    assert (means[255].tolist(), means[256].tolist()) == (LOW[:3], [7.0, 7.0, 7.0])
    (tmp_path / "b.ply").write_bytes(compressed_ply([LARGEST], [LOW[:6] + HIGH[:6]], colored=False))
    torch.testing.assert_close(
        read_splats(tmp_path / "b.ply")[0]["sh_base"] * CONSTANT_HARMONIC + 0.5, torch.ones(1, 3)
    )


def test_harmonics_of_a_compressed_ply(tmp_path: Path) -> None:
    stored = [[0, 255, 128, *range(10, 16)]]
    (tmp_path / "a.ply").write_bytes(compressed_ply([LEAST], [LOW + HIGH], harmonics=stored))
    gaussians, degree = read_splats(tmp_path / "a.ply")
    assert degree == 1
    assert gaussians["sh_rest"].shape == (1, 3, 3)
    assert gaussians["sh_rest"][0, :, 0].tolist() == [-4.0, 4.0, 0.015625]  # the three harmonics of red
    assert gaussians["sh_rest"][0, 0, 1] == 8 * (10.5 / 256 - 0.5)


VERTEX = b"element vertex 3\n"
WHOLE = compressed_ply([LEAST, LARGEST], [LOW + HIGH])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (VERTEX, b"element vertex 1000000000000000000\n", ["cut off", "1000000000000000000 rows of vertex"]),
        (VERTEX, b"element vertex 4\n", ["cut off"]),
        (VERTEX, b"element vertex 2\n", ["longer than its header says"]),
        (VERTEX, b"element vertex -3\n", ["line 3", "not understood"]),
        (VERTEX, b"element vertex 3\nproperty float x\n", ["not understood"]),
        (VERTEX, b"element empty 1000000000000000000\nelement vertex 3\n", ["'empty' of a PLY has no properties"]),
        (b"property float f_dc_1\n", b"", ["longer than its header says"]),
        (b"float f_dc_1\n", b"float red\n", ["no f_dc_1", "3D Gaussian Splatting"]),
        (b"float f_rest_8\n", b"float f_rest_9\n", ["not make up a whole degree"]),
        (b"float nx\n", b"list uchar int nx\n", ["cannot be read", "lists in 'vertex'"]),
        (b"float nx\n", b"quad nx\n", ["not understood", "quad"]),
        (b"end_header", b"end_hearder", ["header does not end"]),
        (b"binary_little_endian", b"binary_middle_endian", ["unknown format"]),
        (b"1.0", b"2.0", ["unknown format"]),
        (b"ply\n", b"plyers\n", ["not a PLY file"]),
    ],
)
def test_a_broken_ply(tmp_path: Path, old: bytes, new: bytes, words: list[str]) -> None:
    whole = write_ply(tmp_path / "whole.ply", columns(3, 1)).read_bytes()
    assert old in whole
    said = refusal(tmp_path / "broken.ply", whole.replace(old, new, 1))
    assert all(word in said for word in ["broken.ply", *words]), said


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("x", np.nan, "means of NaN or infinity"),
        ("rot_1", np.inf, "quats of NaN or infinity"),
        ("opacity", np.nan, "logit_opacities of NaN"),
        ("scale_2", 90.0, "absurd log_scales"),
        ("scale_2", -np.inf, "log_scales of NaN or infinity"),
        ("f_rest_0", -1e30, "absurd sh_rest"),
        ("y", 1e20, "absurd means"),
    ],
)
def test_values_that_no_scene_has(tmp_path: Path, name: str, value: float, words: str) -> None:
    table = columns(5, 1)
    table[name][3] = value
    said = refusal(tmp_path / "a.ply", write_ply(tmp_path / "whole.ply", table).read_bytes())
    assert words in said
    assert "1 of 5, the first in row 3" in said


def test_rotations_of_no_length(tmp_path: Path) -> None:
    table = columns(5, 0)
    for axis in range(4):
        table[f"rot_{axis}"][[1, 4]] = 0
    said = refusal(tmp_path / "a.ply", write_ply(tmp_path / "whole.ply", table).read_bytes())
    assert "quaternions of no length; found 2 of 5, the first in row 1" in said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (WHOLE[:-1], "cut off"),
        (WHOLE.replace(b"packed_scale", b"packed_skill"), "vertex lacks the property packed_scale"),
        (WHOLE.replace(b"uint packed_scale", b"float packed_scale"), "float32"),
        (WHOLE.replace(b"float max_scale_y", b"float max_scule_y"), "chunk lacks the property max_scale_y"),
        (compressed_ply([LEAST] * 300, [LOW + HIGH]), "1 for 300 Gaussians"),
        (compressed_ply([LEAST], [LOW + HIGH] * 2), "2 for 1 Gaussians"),
        (compressed_ply([LEAST], [LOW + HIGH], harmonics=[[0] * 9] * 2), "2 rows for 1 Gaussians"),
        (compressed_ply([LEAST], [LOW + HIGH], harmonics=[[0] * 10]), "not make up a whole degree"),
        (compressed_ply([LEAST], [[math.nan] * 18]), "NaN"),
        (compressed_ply([LARGEST], [LOW + [1e38] * 9]), "NaN or infinity|absurd"),
        (compressed_ply([], []), "without Gaussians"),
        (compressed_ply([], [], harmonics=np.zeros((0, 45), np.uint8)), "without Gaussians"),
    ],
)
def test_a_broken_compressed_ply(tmp_path: Path, content: bytes, words: str) -> None:
    said = refusal(tmp_path / "a.ply", content)
    assert any(word in said for word in words.split("|")), said


@pytest.mark.parametrize("word", [b"one", b"1e", b"--1", b"\xff\xfe"])
def test_what_is_no_number_in_text(tmp_path: Path, word: bytes) -> None:
    whole = write_ply(tmp_path / "whole.ply", columns(3, 0), text=True).read_bytes()
    start = whole.index(b"end_header\n") + len(b"end_header\n")
    said = refusal(tmp_path / "a.ply", whole[:start] + word + b" " + whole[start:])
    assert "not a number" in said or "numbers after the header" in said
    assert "numbers after the header" in refusal(tmp_path / "b.ply", whole + b" 1 2 3")
    assert "cut off" in refusal(tmp_path / "c.ply", whole[: start + 100])


def test_a_broken_splat(tmp_path: Path) -> None:
    whole = records().tobytes()
    assert "cut off" in refusal(tmp_path / "a.splat", whole[:-5])
    assert "without Gaussians" in refusal(tmp_path / "b.splat", b"")
    nothing, flat = records(), records()
    nothing["mean"][1, 1] = np.nan
    flat["scale"][2, 0] = 0
    assert "means of NaN" in refusal(tmp_path / "c.splat", nothing.tobytes())
    assert "no size; found 1 of 3" in refusal(tmp_path / "d.splat", flat.tobytes())
    no_rotation = records()
    no_rotation["quat"] = 128
    assert "quaternions of no length" in refusal(tmp_path / "e.splat", no_rotation.tobytes())
    with pytest.raises(UserError, match="found a folder"):
        read_splats(tmp_path)


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_what_a_header_claims_takes_no_memory(tmp_path: Path, form: str) -> None:
    path = tmp_path / "a.ply"
    names = "".join(f"property double {name}\n" for name in columns(1, 3))
    path.write_bytes(f"ply\nformat {form} 1.0\nelement vertex 99999999999\n{names}end_header\n".encode() + b"1 " * 999)
    tracemalloc.start()
    with pytest.raises(UserError, match="cut off"):
        read_splats(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def read_or_refuse(path: Path, content: bytes) -> None:
    """Read a file, which must give sound Gaussians or a `UserError`."""
    path.write_bytes(content)
    try:
        gaussians, degree = read_splats(path)
    except UserError:
        return
    assert len(gaussians) > 0
    assert gaussians["sh_rest"].shape == (len(gaussians), (degree + 1) ** 2 - 1, 3)
    assert all(torch.isfinite(tensor).all() for tensor in gaussians.parameters.values())


@fuzzed
@given(st.binary(max_size=400))
def test_any_bytes(tmp_path: Path, content: bytes) -> None:
    read_or_refuse(tmp_path / "a", content)
    read_or_refuse(tmp_path / "b", b"ply\n" + content)


def damaged(whole: bytes) -> st.SearchStrategy[bytes]:
    """A file with a few bytes removed, inserted or changed."""
    edit = st.tuples(st.integers(0, len(whole)), st.integers(0, 8), st.binary(max_size=8))

    def apply(edits: list[tuple[int, int, bytes]]) -> bytes:
        content = whole
        for start, length, new in edits:
            content = content[:start] + new + content[start + length :]
        return content

    return st.lists(edit, min_size=1, max_size=4).map(apply)


@fuzzed
@given(st.data())
def test_damaged_files(tmp_path: Path, data: st.DataObject) -> None:
    forms = [
        write_ply(tmp_path / "a.ply", columns(2, 1)).read_bytes(),
        write_ply(tmp_path / "b.ply", columns(2, 0), byte_order=">").read_bytes(),
        write_ply(tmp_path / "c.ply", columns(2, 1), text=True).read_bytes(),
        compressed_ply([LEAST, LARGEST], [LOW + HIGH], harmonics=[[7] * 9] * 2),
        records().tobytes(),
    ]
    read_or_refuse(tmp_path / "damaged", data.draw(st.sampled_from(forms).flatmap(damaged)))


# Renders were inspected: a truck and a biker, upright and sharp. The figures come from another reader.
@pytest.mark.skipif(not REAL.is_dir(), reason="the real scenes are not at hand")
@pytest.mark.parametrize(
    ("name", "count", "opacity", "color", "scale"),
    [
        ("truck.splat", 116_544, 0.62837, (0.4252, 0.4895, 0.5431), 0.0015962),
        ("biker.compressed.ply", 152_746, 0.29663, (0.3189, 0.3077, 0.3007), 0.0031128),
    ],
)
def test_real_files(tmp_path: Path, name: str, count: int, opacity: float, color: tuple, scale: float) -> None:
    (tmp_path / "no extension").write_bytes((REAL / name).read_bytes())
    gaussians, degree = read_splats(tmp_path / "no extension")
    assert (len(gaussians), degree) == (count, 0)
    assert ((gaussians["quats"].norm(dim=1) - 1).abs() < 0.02).all()
    assert float(gaussians.opacities.mean()) == pytest.approx(opacity, rel=1e-3)
    torch.testing.assert_close(
        gaussians["sh_base"].mean(dim=0) * CONSTANT_HARMONIC + 0.5, torch.tensor(color), rtol=1e-3, atol=0
    )
    assert float(gaussians.scales.median()) == pytest.approx(scale, rel=1e-3)

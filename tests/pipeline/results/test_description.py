"""What `show` reports about an artifact, in which words, and what it keeps back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.console.showing import lines_of
from pipeline.console.tables import in_short, rows_table
from pipeline.disk import size_words
from pipeline.errors import CorruptArtifact
from pipeline.results.description import Range, as_json, describe, range_of
from tests.pipeline.helpers import CHAIN, Workspace


def artifact_of(folder: Path, arrays: dict[str, np.ndarray], private: bool = False) -> Artifact:
    with create(folder / "artifact", "things", private) as writer:
        for name, array in arrays.items():
            writer.write(name, array)
        writer.attributes |= {"word": "treasure", "list": list(range(100))}
        writer.write_file("notes.txt", "".join(f"line {number} of the treasure\n" for number in range(60)))
    return load(folder / "artifact")


def shown(artifact: Artifact, reveal: bool = False, everything: bool = False) -> str:
    return "\n".join(lines_of(describe(artifact, None, reveal), everything))


def test_ranges(tmp_path: Path) -> None:
    mixed = np.array([1.0, np.nan, np.inf, -np.inf, np.nan, 4.0, 1.0], np.float32)
    arrays = {
        "mixed": mixed,
        "nothing": np.zeros((0, 3)),
        "only_nan": np.full(3, np.nan),
        "scalar": np.array(7),
        "flags": np.array([True, False, True, True]),
        "large": np.array([2**63, 2**63 + 2], np.uint64),
        "complex": np.array([1j]),
        "half": np.full(70000, 3.0, np.float16),
    }
    artifact = artifact_of(tmp_path, arrays)
    assert range_of(artifact, "mixed") == Range(1.0, 2.0, 4.0, nan=2, infinite=2)
    assert range_of(artifact, "nothing") == Range(None, None, None, 0, 0)
    assert range_of(artifact, "only_nan") == Range(None, None, None, 3, 0)
    assert range_of(artifact, "scalar") == Range(7.0, 7.0, 7.0, 0, 0)
    assert range_of(artifact, "flags") == Range(0.0, 0.75, 1.0, 0, 0)
    assert range_of(artifact, "large") == Range(2.0**63, 2.0**63, 2.0**63 + 2, 0, 0)
    assert range_of(artifact, "complex") is None
    assert range_of(artifact, "half") == Range(3.0, 3.0, 3.0, 0, 0), "the sum is beyond float16"
    text = shown(artifact)
    assert "2 not a number, 2 infinite" in text
    assert "one number" in text


def test_a_large_array_is_read_chunk_by_chunk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).normal(size=(5, 48, 48, 3))
    artifact = artifact_of(tmp_path, {"values": values})
    largest = max(block.size for block in artifact.blocks("values"))
    assert largest == values[0].size, "a picture at a time"
    monkeypatch.setattr(Artifact, "read", lambda *_: pytest.fail("read as a whole"))
    found = range_of(artifact, "values")
    assert found is not None
    assert (found.least, found.greatest) == (values.min(), values.max())
    assert found.mean == pytest.approx(values.mean(), abs=1e-15)


def test_a_damaged_chunk_is_told(tmp_path: Path) -> None:
    artifact = artifact_of(tmp_path, {"values": np.arange(1000.0)})
    chunk = next(artifact.path.glob("arrays.zarr/values/c/*"))
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(CorruptArtifact, match="cannot be read"):
        describe(artifact, None, reveal=False)


def test_an_artifact_in_lines(tmp_path: Path) -> None:
    artifact = artifact_of(tmp_path, {"values": np.arange(12, dtype=np.float32).reshape(3, 4)})
    text = shown(artifact)
    assert text.splitlines()[0] == "things"
    assert f"digest  {artifact.digest}" in text
    assert "word  treasure" in text
    assert "list  100: 0, 1, 2" in text
    assert [line.split() for line in text.splitlines() if line.startswith("  values")] == [
        ["values", "3", "×", "4", "float32", "whole", *size_words(stored(artifact)).split(), "0", "5.5", "11"]
    ]
    assert "line 39 of" in text
    assert "line 40 of" not in text
    assert "20 more lines; --all shows them" in text
    assert "line 59 of" in shown(artifact, everything=True)


def test_long_lines_cells_and_names_are_whole_only_if_everything_is_shown(tmp_path: Path) -> None:
    line, cell, name = "l" * 200, "c" * 200, "n" * 200
    with create(tmp_path / "artifact", "things") as writer:
        writer.write_file("notes.txt", f"{line}\n")
        writer.write_file("table.jsonl", json.dumps({"cell": cell}) + "\n" + json.dumps({"cell": "short"}))
        writer.write_file(name, "")
    artifact = load(tmp_path / "artifact")
    for text in (line, cell, name):
        assert text in shown(artifact, everything=True)
        assert f"{text[:119]}…" in shown(artifact)
        assert text not in shown(artifact)


def test_a_long_cell_widens_no_other_row() -> None:
    """Otherwise one cell of a stranger's table could make the text as large as its length times the number of rows."""
    lines = rows_table([{"cell": "c" * 10_000, "next": "a"}, {"cell": "short", "next": "b"}], str)
    assert lines[1] == f"{'c' * 10_000}  a"
    assert lines[2] == f"{'short':120}  b"


def stored(artifact: Artifact) -> int:
    return sum(path.stat().st_size for path in (artifact.path / "arrays.zarr/values").rglob("*") if path.is_file())


def test_of_a_private_artifact_no_value_is_told(tmp_path: Path) -> None:
    artifact = artifact_of(tmp_path, {"key": np.array([81281.0, 81283.0])}, private=True)
    for text in (
        shown(artifact),
        shown(artifact, everything=True),
        json.dumps(as_json(describe(artifact, None, False))),
    ):
        assert "key" in text
        for secret in ("treasure", "81281", "81282", "81283", "8.128e+04", "line 1"):
            assert secret not in text.replace(artifact.digest, "").replace(str(tmp_path), "")
    assert "Add --reveal" in shown(artifact)
    revealed = shown(artifact, reveal=True)
    assert "treasure" in revealed
    assert "81282" in revealed
    assert "--reveal" not in revealed


def test_nothing_that_a_terminal_would_obey(tmp_path: Path) -> None:
    with create(tmp_path / "artifact", "evil\x1b[2J") as writer:
        writer.attributes["title\x07"] = "\x1b]0;owned\x07"
        writer.write_file("a.txt", "\x1b[31mred\r\n")
        writer.write_file("b\x1b[2J.jsonl", json.dumps({"na\x1bme": "va\x1blue"}))
    for everything in (False, True):
        text = shown(load(tmp_path / "artifact"), everything=everything)
        assert all(character.isprintable() or character == "\n" for character in text)


def test_how_it_was_made(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    store = ran.project.store
    description = describe(ran.artifact("sum", "total"), store, reveal=False)
    origin = description.origin
    assert origin is not None
    assert (origin.made_by, origin.uses, origin.key) == ("chain/sum", "total", ran.ended["sum"].key)
    assert [(step.name, step.uses) for step in origin.lineage] == [
        ("base", "numbers"),
        ("twice", "scale"),
        ("other", "scale"),
        ("sum", "total"),
    ]
    assert [taken.made_by for taken in origin.inputs["numbers"]] == ["twice", "other"]
    assert description.names == ("chain/sum.total",)
    twice = describe(ran.artifact("twice"), store, reveal=False)
    text = "\n".join(lines_of(twice, everything=False))
    assert "by      chain/twice (scale)" in text
    assert "factor  2" in text
    assert f"numbers  base {ran.artifact('base').digest[:12]}" in text


def test_what_made_it_first_is_told_whatever_made_the_same_later(workspace: Workspace) -> None:
    """An import of what was published makes the same again, for example."""
    ran = workspace.write(CHAIN).run()
    workspace.write("name: again\nstages:\n  imported: {uses: numbers, with: {note: again}}\n").run()
    sum_of_both, base = (ran.artifact(*name) for name in (("sum", "total"), ("base",)))
    store = ran.project.store
    assert sum(base.digest in record.outputs.values() for record in store.records()) == 2
    for artifact, made_by in ((base, "chain/base"), (sum_of_both, "chain/sum")):
        origin = describe(artifact, store, reveal=False).origin
        assert origin is not None
        assert origin.made_by == made_by
        assert origin.lineage[0].name == "base"


def test_parameters_of_what_is_private_are_not_told(workspace: Workspace) -> None:
    workspace.write("stages:\n  key: {uses: numbers, private: true, with: {first: 8128, note: treasure}}\n")
    ran = workspace.run()
    hidden = describe(ran.artifact("key"), ran.project.store, reveal=False)
    assert "treasure" not in json.dumps(as_json(hidden))
    assert "8128" not in "\n".join(lines_of(hidden, everything=True))
    revealed = describe(ran.artifact("key"), ran.project.store, reveal=True).origin
    assert revealed is not None
    assert revealed.parameters == {"count": 3, "first": 8128.0, "note": "treasure"}


def test_what_is_public_does_not_tell_of_its_private_sister(workspace: Workspace) -> None:
    """A container and its secret come from one action, whose parameters and facts may reveal what the secret does."""
    workspace.write("stages:\n  some: {uses: numbers}\n  both: {uses: total, in: {numbers: [some]}}\n")
    ran = workspace.run()
    page = ran.artifact("both", "page")
    assert not page.private
    told = {reveal: describe(page, ran.project.store, reveal=reveal).origin for reveal in (False, True)}
    assert told[False] is not None
    assert (told[False].parameters, told[False].facts) == (None, None)
    assert told[True] is not None
    assert (told[True].parameters, told[True].facts) == ({}, {})


def rows_of(views: int, quantities: int) -> list[dict[str, object]]:
    return [
        {"quantity": f"q{quantity}", "value": float(view), "view": f"{view:03}", "split": "test", "message": None}
        for view in range(views)
        for quantity in range(quantities)
    ]


def test_short_tables_are_shown_whole() -> None:
    rows = rows_of(2, 2)
    assert in_short(rows, 40) == (rows, None)
    assert rows_table(rows)[:2] == ["quantity  value  view  split", "q0            0  000   test"]
    assert rows_table([]) == []


def test_long_tables_of_figures_are_shown_by_their_means() -> None:
    rows, how = in_short(rows_of(21, 5), 40)
    assert how == "105 rows, summarised over view"
    assert len(rows) == 5
    assert rows[0] == {"quantity": "q0", "split": "test", "rows": 21, "mean": 10.0, "least": 0.0, "greatest": 20.0}


def test_curves_end_with_the_last_figure() -> None:
    curve = [{"quantity": "loss", "value": 1.0 / step, "iteration": step} for step in range(1, 100)]
    (row,), how = in_short(curve, 40)
    assert how == "99 rows, summarised"
    assert (row["greatest"], row["last"], row["rows"]) == (1.0, 1.0 / 99, 99)


def test_other_long_tables_are_cut() -> None:
    rows, how = in_short([{"name": f"{number}"} for number in range(100)], 4)
    assert how == "first 2 and last 2 of 100 rows"
    assert [row["name"] for row in rows] == ["0", "1", "98", "99"]


def test_figures_that_could_not_be_measured() -> None:
    rows = [{"quantity": "psnr", "value": None, "view": f"{view}"} for view in range(50)]
    assert in_short(rows, 40)[0] == [{"quantity": "psnr", "rows": 50}]


def test_a_figure_that_is_infinite_is_no_text_and_is_not_in_the_mean() -> None:
    figures = [{"quantity": "psnr", "value": 20.0 + view % 2, "view": f"{view}"} for view in range(60)]
    figures[7]["value"] = "inf"
    rows, how = in_short(figures, 40)
    assert how == "60 rows, summarised over view"
    mean = (30 * 20.0 + 29 * 21.0) / 59
    assert rows == [
        {"quantity": "psnr", "rows": 60, "mean": mean, "not in mean": 1, "least": 20.0, "greatest": float("inf")}
    ]
    assert rows_table(rows)[1].split() == ["psnr", "60", "20.49", "20", "inf", "1"]


@pytest.mark.parametrize("unknown", ["nan", float("nan"), None])
def test_a_verdict_that_is_not_a_number_makes_no_group(unknown: object) -> None:
    verdicts: list[dict[str, object]] = [{"quantity": "legal", "value": number % 2} for number in range(60)]
    verdicts[7]["value"] = unknown
    rows, how = in_short(verdicts, 40)
    assert how == "60 rows, summarised"
    assert rows == [{"quantity": "legal", "rows": 60, "mean": 29 / 59, "not in mean": 1, "least": 0.0, "greatest": 1.0}]


def test_verdicts_that_are_words_are_counted() -> None:
    verdicts = [{"quantity": "legal", "value": "yes" if number % 3 else "no"} for number in range(60)]
    assert [(row["value"], row["rows"]) for row in in_short(verdicts, 40)[0]] == [("no", 20), ("yes", 40)]


DEEP = "[" * 500 + "]" * 500


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{"value": 1e999}', "inf"),
        ('{"value": NaN}', "nan"),
        ('{"value": -Infinity}', "-inf"),
        (f'{{"value": {10**400}}}', "1000"),
        ('{"value": [3, {"a": null}]}', "[3, {'a': None}]"),
        (f'{{"value": {DEEP}}}', "[[["),
        (f'{{"value": {DEEP * 100}}}', "[[["),
        (f'{{"value": {"[" * 100_000}}}', "[[["),
    ],
)
@pytest.mark.parametrize("others", [0, 60])
def test_strange_tables_are_shown_all_the_same(tmp_path: Path, line: str, words: str, others: int) -> None:
    """Some are not tables, and are shown as the lines that they are."""
    with create(tmp_path / "artifact", "things") as writer:
        rows = [json.dumps({"quantity": "psnr", "value": 1.5, "view": number}) for number in range(others)]
        figure = line.replace('{"value"', '{"quantity": "psnr", "value"', 1)
        writer.write_file("measured.jsonl", "\n".join([line if not others else figure, *rows]))
    artifact = load(tmp_path / "artifact")
    assert words in shown(artifact, everything=True)
    assert "measured.jsonl" in shown(artifact)
    assert json.dumps(as_json(describe(artifact, None, reveal=False)))


def test_a_list_among_the_texts_of_a_long_table() -> None:
    rows = [{"quantity": "psnr", "value": 1.0, "view": ["a"] if view % 2 else f"{view}"} for view in range(50)]
    rows += [{"quantity": "psnr", "value": 10**400, "view": "a"}]
    ((row,), how) = in_short(rows, 4)
    assert (row["rows"], row["least"], row["greatest"], how) == (51, 1.0, float("inf"), "51 rows, summarised over view")

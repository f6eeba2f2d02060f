"""What runs, what is taken from the store, and what a failure holds up."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import CommandError
from pipeline.events import StageProgressed, as_json
from pipeline.resources import Resources
from pipeline.run.action import Ancestor, read_lineage
from pipeline.run.executor import SerialExecutor, Tell, Work
from tests.pipeline.helpers import CHAIN, Workspace


class Watched(SerialExecutor):
    """Records which stages it had at the same time."""

    def __init__(self) -> None:
        super().__init__()
        self.groups: list[set[str]] = []
        self.given: set[str] = set()

    def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
        super().start(name, work, subject, urgency, needs)
        self.given.add(name)
        self.groups.append(set(self.given))

    def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
        ended = super().wait(tell, seconds)
        if ended:
            self.given.discard(ended[0])
        return ended


def test_a_second_run_executes_nothing(workspace: Workspace) -> None:
    first = workspace.write(CHAIN).run()
    assert set(first.states.values()) == {"ran"}
    np.testing.assert_array_equal(first.values("sum", "total"), [6.0, 15.0])
    second = workspace.run()
    assert second.states == dict.fromkeys(["base", "twice", "other", "sum"], "cached")
    assert second.ended["sum"].outputs == first.ended["sum"].outputs
    assert second.ended["sum"].key == first.ended["sum"].key
    assert second.summary.counts == {"cached": 4}


def test_a_changed_parameter_reruns_exactly_what_depends_on_it(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    assert workspace.run("factor=3.0").states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "ran"}
    assert workspace.run("other.factor=7").states == {"base": "cached", "twice": "cached", "other": "ran", "sum": "ran"}
    assert set(workspace.run().states.values()) == {"cached"}, "the first results are still there"


def test_an_integer_and_the_same_float_are_one_value(workspace: Workspace) -> None:
    workspace.write(CHAIN).run("factor=2")
    assert set(workspace.run("factor=2.0").states.values()) == {"cached"}


def test_early_cutoff(workspace: Workspace) -> None:
    """If a stage runs again and makes the same bits, nothing after it runs again."""
    workspace.write(CHAIN).run()
    states = workspace.run("base.note=changed").states
    assert states == {"base": "ran", "twice": "cached", "other": "cached", "sum": "cached"}


def test_a_name_in_the_workflow_does_not_matter(workspace: Workspace) -> None:
    workspace.write(CHAIN).run()
    workspace.write(CHAIN.replace("twice", "double").replace("name: chain", "name: renamed"))
    assert set(workspace.run().states.values()) == {"cached"}


def test_equal_stages_run_once(workspace: Workspace) -> None:
    workspace.write("stages:\n  a: {uses: numbers}\n  b: {uses: numbers}\n")
    executor = Watched()
    assert workspace.run(executor=executor).states == {"a": "ran", "b": "cached"}
    assert executor.groups == [{"a"}], "b does not hold a worker up with waiting"


def test_only_what_the_named_stages_need(workspace: Workspace) -> None:
    assert set(workspace.write(CHAIN).run(stages=["other"]).states) == {"base", "other"}
    with pytest.raises(CommandError, match="did you mean 'other'"):
        workspace.run(stages=["othr"])


def test_a_failure_holds_up_only_its_dependents(workspace: Workspace) -> None:
    workspace.write("""
        stages:
          base:  {uses: numbers}
          bad:   {uses: fail, in: {numbers: base}, with: {how: user}}
          worse: {uses: fail, in: {numbers: base}, with: {how: defect}}
          mute:  {uses: fail, in: {numbers: base}, with: {how: silence}}
          after: {uses: scale, in: {numbers: bad}}
          last:  {uses: scale, in: {numbers: after}}
          fine:  {uses: scale, in: {numbers: base}}
        """)
    ran = workspace.run()
    assert ran.states == {
        "base": "ran",
        "bad": "failed",
        "worse": "failed",
        "mute": "failed",
        "after": "skipped",
        "last": "skipped",
        "fine": "ran",
    }
    assert ran.ended["bad"].cause == "photos/: no pictures; expected JPEG or PNG files. Look there."
    assert ran.ended["worse"].cause == "ZeroDivisionError: division by zero"
    assert ran.ended["mute"].cause == "the stage wrote nothing to its output 'numbers'"
    log = ran.ended["worse"].log
    assert log is not None
    text = log.read_text()
    assert "about to fail" in text
    assert "Traceback" in text
    assert workspace.plan()["worse"].failed == "ZeroDivisionError: division by zero"
    again = workspace.run("bad.how=silence")
    assert again.states["base"] == again.states["fine"] == "cached"


def test_a_cause_has_nothing_that_a_terminal_would_obey(workspace: Workspace) -> None:
    """It may quote the name of a stranger's file, and is printed and kept."""
    workspace.write(
        "stages:\n  base: {uses: numbers}\n  bad: {uses: fail, in: {numbers: base}, with: {how: stranger}}\n"
    )
    assert workspace.run().ended["bad"].cause == "x?]0;owned?.txt: missing"


def test_what_measures_time_runs_alone(workspace: Workspace) -> None:
    workspace.write("""
        stages:
          a: {uses: numbers, with: {first: 1}}
          b: {uses: measure}
          c: {uses: numbers, with: {first: 2}}
        """)
    executor = Watched()
    assert set(workspace.run(executor=executor).states.values()) == {"ran"}
    assert {"a", "c"} in executor.groups
    assert [group for group in executor.groups if "b" in group] == [{"b"}]


def test_nothing_is_started_beside_what_measures_time(workspace: Workspace) -> None:
    workspace.write("stages:\n  a: {uses: measure}\n  b: {uses: numbers}\n")
    executor = Watched()
    assert set(workspace.run(executor=executor).states.values()) == {"ran"}
    assert executor.groups == [{"a"}, {"b"}]


def test_privacy_spreads(workspace: Workspace) -> None:
    """From a stage declared private to all that is made from it, except outputs declared public."""
    workspace.write("""
        stages:
          open:   {uses: numbers}
          hidden: {uses: numbers, private: true, with: {first: 5}}
          scaled: {uses: scale, in: {numbers: hidden}}
          sum:    {uses: total, in: {numbers: [open, scaled]}}
        """)
    ran = workspace.run()
    private = {
        (name, output): ran.artifact(name, output).private for name in ran.ended for output in ran.ended[name].outputs
    }
    assert private == {
        ("open", "numbers"): False,
        ("hidden", "numbers"): True,
        ("scaled", "numbers"): True,
        ("sum", "total"): True,
        ("sum", "page"): False,
        ("sum", "key"): True,
    }
    store = ran.project.store
    for name, paths in {name: event.outputs.values() for name, event in ran.ended.items()}.items():
        for path in paths:
            for file in (path, *path.rglob("*")):
                open_to_others = bool(stat.S_IMODE(file.stat().st_mode) & 0o077)
                assert open_to_others != store.artifact(path.name).private, file
        log = store.log("workflow", name, private=name != "open")
        modes = [stat.S_IMODE(path.stat().st_mode) for path in (log, log.parent)]
        assert (modes == [0o600, 0o700]) == (name != "open")
        record = store.root / "actions" / str(ran.ended[name].key)
        assert bool(record.stat().st_mode & 0o077) == (name == "open")


def test_the_private_flag_is_in_the_key(workspace: Workspace) -> None:
    """And the log of the public run, in which others could look for a reason, goes."""
    store = workspace.write("stages:\n  a: {uses: numbers}\n").run().project.store
    assert workspace.write("stages:\n  a: {uses: numbers, private: true}\n").run().states == {"a": "ran"}
    logs = store.root / "logs/workflow"
    assert [path for path in logs.rglob("*") if path.is_file()] == [logs / "private/a.log"]


def test_foreach(workspace: Workspace) -> None:
    """Stages with the same foreach go item by item; a reference from outside takes all items, in order."""
    workspace.write("""
        vars: {firsts: [30, 10]}
        stages:
          each:   {uses: numbers, foreach: {first: "${firsts}"}, with: {first: "${item.first}", count: 1}}
          scaled: {uses: scale, foreach: {first: "${firsts}"}, in: {numbers: each}}
          sum:    {uses: total, in: {numbers: scaled}}
        """)
    ran = workspace.run()
    assert list(ran.states) == ["each[30]", "each[10]", "scaled[30]", "scaled[10]", "sum"]
    np.testing.assert_array_equal(ran.values("scaled[10]"), [20.0])
    np.testing.assert_array_equal(ran.values("sum", "total"), [60.0, 20.0])
    more = workspace.run("firsts=[30, 20, 10]")
    assert {name for name, state in more.states.items() if state == "ran"} == {"each[20]", "scaled[20]", "sum"}
    assert set(workspace.run(stages=["each"]).states) == {"each[30]", "each[10]"}


def test_what_closes_a_row_is_done_before_the_next_row_begins(workspace: Workspace) -> None:
    """A run that is stopped then has the scores of every training that it finished."""
    workspace.write("""
        vars: {firsts: [30, 10]}
        stages:
          base:   {uses: numbers, foreach: {first: "${firsts}"}, with: {first: "${item.first}", count: 1}}
          train:  {uses: scale, foreach: {first: "${firsts}"}, in: {numbers: base}}
          scores: {uses: scale, foreach: {first: "${firsts}"}, in: {numbers: train}}
          table:  {uses: total, in: {numbers: scores}}
        """)
    rows = ["train[30]", "scores[30]", "train[10]", "scores[10]"]
    assert list(workspace.run().states) == ["base[30]", "base[10]", *rows, "table"]
    assert list(workspace.run("train.factor=7", stages=["scores"]).states) == ["base[30]", "base[10]", *rows]


def test_stages_that_need_no_other_run_first(workspace: Workspace) -> None:
    """They read what is outside: that a folder holds no photos shows at once, not after the training of the cover."""
    workspace.write("""
        stages:
          cover:   {uses: numbers}
          train:   {uses: scale, in: {numbers: cover}}
          message: {uses: numbers, with: {first: 7}}
          hide:    {uses: total, in: {numbers: [train, message]}}
        """)
    assert [*workspace.run().states] == ["cover", "message", "train", "hide"]


def test_lineage_is_the_way_to_the_inputs(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    page = ran.artifact("sum", "page").file("report.html").read_text()
    assert page == "<ul><li>base numbers []</li><li>twice scale ['base']</li><li>other scale ['base']</li></ul>"


def test_lineage_tells_of_the_machine_but_not_its_name(workspace: Workspace) -> None:
    """Published pages show it."""
    ran = workspace.write(CHAIN).run()
    key = str(ran.ended["base"].key)
    record = ran.project.store.record(key)
    assert record is not None
    assert record.provenance["machine"]["host"]
    (told,) = read_lineage(ran.project.store, {"base": Ancestor(key, ())})
    assert "cores" in told.facts
    assert "host" not in told.facts


def test_external_files_count_by_content(workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths in the file are relative to it, those of --set to the current directory; only names and bytes count."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    (tmp_path / "data.txt").write_text("1\n2\n")
    (elsewhere / "data.txt").write_text("7\n")
    workspace.write("""
        vars: {file: data.txt}
        stages:
          base: {uses: numbers, with: {file: "${file}"}}
        """)
    np.testing.assert_array_equal(workspace.run().values("base"), [1.0, 2.0])
    np.testing.assert_array_equal(workspace.run("file=data.txt").values("base"), [7.0])
    np.testing.assert_array_equal(workspace.run("base.file=data.txt").values("base"), [7.0])
    moved = tmp_path / "moved"
    moved.mkdir()
    (moved / "data.txt").write_text("7\n")
    assert workspace.run(f"file={moved / 'data.txt'}").states == {"base": "cached"}
    (tmp_path / "data.txt").write_text("3\n")
    assert workspace.run().states == {"base": "ran"}


def test_external_files_may_be_named_by_default(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    workspace.write("stages:\n  a: {uses: usual}\n")
    ran = workspace.run()
    assert (ran.states, ran.values("a").tolist()) == ({"a": "ran"}, [])
    (tmp_path / "usual.txt").write_text("7\n")
    ran = workspace.run()
    assert (ran.states, ran.values("a").tolist()) == ({"a": "ran"}, [7.0])
    assert workspace.run().states == {"a": "cached"}
    assert workspace.open().graph.nodes["a"].outside_paths == ("usual.txt",)
    (tmp_path / "usual.txt").write_text("8\n")

    class Edited(SerialExecutor):
        """The file is edited between the plan and the stage."""

        def start(self, name: str, work: Work, subject: object, urgency: int, needs: Resources) -> None:
            (tmp_path / "usual.txt").write_text("9\n")
            super().start(name, work, subject, urgency, needs)

    ran = workspace.run(executor=Edited())
    assert "usual.txt: changed since the run began" in str(ran.ended["a"].cause)


def test_latest_points_to_the_last_results(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    link = workspace.folder / "store/latest/chain/sum.total"
    assert link.resolve() == ran.ended["sum"].outputs["total"]
    assert not Path(os.readlink(link)).is_absolute(), "the store can be moved"  # noqa: PTH115 — Path would resolve it
    workspace.run("factor=9")
    assert link.resolve() != ran.ended["sum"].outputs["total"]


def test_what_failed_leaves_no_result_of_a_run_before_in_latest(workspace: Workspace) -> None:
    """A page made from other inputs would be taken for this run's."""
    store = workspace.write(CHAIN).run().project.store
    twice = 'twice: {uses: scale, in: {numbers: base}, with: {factor: "${factor}"}}'
    failing = workspace.write(CHAIN.replace(twice, "twice: {uses: fail, in: {numbers: base}}"))
    assert failing.run().states == {"base": "cached", "twice": "failed", "other": "cached", "sum": "skipped"}
    for names in (store.latest_digests(), store.history.latest_digests()):
        assert not {name for name in names if name.startswith("chain/twice.")}
    assert set(store.latest_digests()) == {"chain/base.numbers", "chain/other.numbers"}
    again = workspace.write(CHAIN).run()
    assert set(again.states.values()) == {"cached"}
    assert "chain/sum.total" in store.latest_digests(), "a run that made it gives it back"


def test_a_result_that_lost_an_object_is_made_again(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    ran.ended["twice"].outputs["numbers"].rename(workspace.folder / "gone")
    assert workspace.plan()["twice"].state == "run"
    again = workspace.run()
    assert again.states == {"base": "cached", "twice": "ran", "other": "cached", "sum": "cached"}
    assert again.ended["twice"].outputs == ran.ended["twice"].outputs
    again.artifact("twice").verify()


@pytest.mark.parametrize(
    "file",
    ["arrays.zarr/values/c/0", "arrays.zarr/values/zarr.json", "manifest.json"],
    ids=["chunk", "zarr", "manifest"],
)
@pytest.mark.parametrize("damage", [lambda text: text[:-2], lambda text: b"", lambda text: text[:9] + b"~" + text[10:]])
def test_a_damaged_input_is_made_again(workspace: Workspace, file: str, damage: Callable[[bytes], bytes]) -> None:
    """Whether the plan, the worker or only the stage that reads it notices the damage."""
    ran = workspace.write(CHAIN).run()
    path = ran.ended["base"].outputs["numbers"] / file
    path.write_bytes(damage(path.read_bytes()))
    again = workspace.run("factor=7")
    np.testing.assert_array_equal(again.values("sum", "total"), [21.0, 15.0])
    assert again.states == {"base": "ran", "twice": "ran", "other": "cached", "sum": "ran"}
    assert again.ended["base"].outputs == ran.ended["base"].outputs
    again.artifact("base").verify()


def test_json_events(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    lines = [json.loads(line) for line in map(as_json, ran.events) if line]
    assert [list(line) for line in lines[:-1]] == [["event", "name", "state", "key", "seconds", "outputs"]] * 4
    assert [line["name"] for line in lines[:-1]] == ["base", "twice", "other", "sum"]
    assert set(lines[3]["outputs"]) == {"total", "page", "key"}
    assert list(lines[-1]) == ["event", "ran", "cached", "failed", "skipped", "seconds"]
    assert lines[-1] | {"seconds": 0} == {
        "event": "summary",
        "ran": 4,
        "cached": 0,
        "failed": 0,
        "skipped": 0,
        "seconds": 0,
    }


def test_progress_reaches_the_listener(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    told = [event for event in ran.events if isinstance(event, StageProgressed) and event.name == "twice"]
    assert told[-1] == StageProgressed("twice", 3.0, 3.0, {"factor": 2.0})


def test_provenance_is_kept(workspace: Workspace) -> None:
    ran = workspace.write(CHAIN).run()
    record = ran.project.store.find(str(ran.ended["base"].key))
    assert record is not None
    assert record.provenance["facts"] == {"device": "none", "note": ""}
    assert record.provenance["versions"]["numpy"] == np.__version__
    assert "pydantic" in record.provenance["versions"]
    assert record.provenance["machine"]["cores"] >= 1
    assert len(record.provenance["commit"].rstrip("+")) == 40


def test_all_who_take_a_damaged_input_wait_for_its_repair(workspace: Workspace) -> None:
    """Stages that began before it was made again, and noticed, do not count as further damage."""
    more = [f"      more{n}: {{uses: scale, in: {{numbers: base}}, with: {{factor: {n}}}}}" for n in (6, 7)]
    ran = workspace.write(CHAIN).run(stages=["base"])
    chunk = ran.ended["base"].outputs["numbers"] / "arrays.zarr/values/c/0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")
    again = workspace.write("\n".join([CHAIN.rstrip(), *more])).run()
    assert set(again.states.values()) == {"ran"}
    np.testing.assert_array_equal(again.values("more7"), [0.0, 7.0, 14.0])

"""A training that was interrupted anywhere, any number of times, makes the bits of one that was not."""

from __future__ import annotations

import functools
import math
import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.checkpoint import Checkpoints, State
from pipeline.errors import Interrupted
from pipeline.stage import Context, Services
from stages.imaging.metric_table import MetricRow
from stages.training.averaging import Averages
from stages.training.density_control import DensitySettings
from stages.training.loop import Training
from stages.training.schedules import DensitySchedule
from stages.training.session import train
from stages.training.state import set_state, state_of
from tests.stages.training.trainings import prepared

ITERATIONS = 46
SCHEDULE = DensitySchedule(start=4, stop=40, interval=6, opacity_reset_interval=15)
METHODS = ("plain", "gs_hider", "homogeneous")
HIDDEN = "homogeneous"


def fresh(method: str) -> Training:
    """A training with six refinements, two opacity resets and a point of its curves every seven iterations."""
    density = DensitySettings(gradient_threshold=1e-7, dense_fraction=0.2, largest_fraction=2, maximum_gaussians=70)
    training = prepared(method, ITERATIONS, density=density, precision="bfloat16")
    training.schedule = SCHEDULE
    training.averages = Averages(0.7, ITERATIONS)
    training.curves.every = 7
    return training


@dataclass
class Trained:
    """The result of a training."""

    state: State
    rows: list[MetricRow]
    log: list[str] = field(default_factory=list)
    progress: list[float] = field(default_factory=list)

    def __eq__(self, other: object) -> bool:
        assert isinstance(other, Trained)
        return self.bits() == other.bits()

    def bits(self) -> object:
        arrays = {name: (a.dtype.str, a.shape, a.tobytes()) for name, a in self.state.arrays.items()}
        return arrays, self.state.values, repr(self.rows)


def session(
    method: str, scratch: Path, stop_after: float = math.inf, make: Callable[[Context], Checkpoints] | None = None
) -> Trained | list[str]:
    """One session of a training; if it is stopped, its log."""
    training, log, progress = fresh(method), [], []

    def told(done: float, total: float, figures: object) -> None:
        progress.append(done)

    services = Services(told, log.append, lambda: training.iteration >= stop_after)
    context = Context({}, {}, scratch, "test", services)
    checkpoints = make(context) if make else Checkpoints(context, every=math.inf)
    try:
        rows = train(context, training, checkpoints)
    except Interrupted:
        return log
    return Trained(state_of(training), rows, log, progress)


def run_to_the_end(training: Training) -> Trained:
    rows = training.run(lambda: None)
    return Trained(state_of(training), rows)


@functools.cache
def undisturbed(method: str) -> Trained:
    return run_to_the_end(fresh(method))


def test_the_trainings_here_do_all_that_changes_a_state() -> None:
    before, after = state_of(fresh("plain")), undisturbed("plain").state
    unchanged = {name for name in before.arrays if np.array_equal(before.arrays[name], after.arrays[name])}
    assert unchanged == {"curves/stretch"}, "Gaussians were split, and density control has seen views since"
    assert len(after.arrays["gaussians/means"]) > len(before.arrays["gaussians/means"])


@settings(max_examples=8, deadline=None)
@given(method=st.sampled_from(METHODS), stops=st.lists(st.integers(0, ITERATIONS), min_size=1, max_size=4))
@example("plain", [0])
@example("plain", [1, ITERATIONS])
@example(HIDDEN, [12, 15])  # just after a refinement, and just after an opacity reset
@example("gs_hider", [11, 12, 12, 13])
@example(HIDDEN, [14, 30, 31])  # at the end of a stretch of the curves, and after a refinement together with a reset
def test_stops_anywhere_change_no_bit(tmp_path_factory: pytest.TempPathFactory, method: str, stops: list[int]) -> None:
    scratch = tmp_path_factory.mktemp("scratch")
    for stop in sorted(stops):
        log = session(method, scratch, stop_after=stop)
        assert isinstance(log, list)
    ended = session(method, scratch)
    assert isinstance(ended, Trained)
    assert ended == undisturbed(method)
    last = max(stops)
    assert ended.progress == list(range(last + 1, ITERATIONS + 1))
    assert any(f"goes on from iteration {last} of {ITERATIONS} (checkpoint of " in line for line in ended.log) == bool(
        last
    )


@pytest.mark.parametrize("method", METHODS)
def test_killed_between_two_checkpoints(method: str, tmp_path: Path) -> None:
    """Checkpoints by time, and no warning of the end; what was done since the last one is done again."""

    class Killed(BaseException):
        pass

    def killed_after(context: Context) -> Checkpoints:
        ticks = iter(range(1000))

        def clock() -> float:
            if (now := next(ticks)) == 45:
                raise Killed
            return now

        return Checkpoints(context, every=9, clock=clock)

    with pytest.raises(Killed):
        session(method, tmp_path, make=killed_after)
    ended = session(method, tmp_path)
    assert isinstance(ended, Trained)
    assert ended == undisturbed(method)
    assert 9 < ended.progress[0] < 45, "it went on from a checkpoint that was due"


@pytest.mark.parametrize("method", METHODS)
def test_a_state_before_the_first_iteration_is_one_too(method: str) -> None:
    training = fresh(method)
    set_state(training, state_of(fresh(method)))
    assert run_to_the_end(training) == undisturbed(method)


def truncate(checkpoint: Path) -> None:
    chunk = max((path for path in checkpoint.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
    chunk.write_bytes(chunk.read_bytes()[:-1])


def flip(checkpoint: Path) -> None:
    chunk = max((path for path in checkpoint.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes(content)


def tear(checkpoint: Path) -> None:
    (checkpoint / "manifest.json").unlink()


def scribble(checkpoint: Path) -> None:
    (checkpoint / "manifest.json").write_text("{}")


@pytest.mark.parametrize("damage", [truncate, flip, tear, scribble])
def test_a_damaged_checkpoint_costs_time_only(damage: Callable[[Path], None], tmp_path: Path) -> None:
    assert isinstance(session(HIDDEN, tmp_path, stop_after=20), list)
    (checkpoint,) = tmp_path.iterdir()
    damage(checkpoint)
    ended = session(HIDDEN, tmp_path)
    assert isinstance(ended, Trained)
    assert ended == undisturbed(HIDDEN)
    assert ended.progress[0] == 1
    said = [line for line in ended.log if "checkpoint-1" in line]
    assert len(said) == 1
    assert "\n" not in said[0]


@pytest.mark.parametrize("method", METHODS)
def test_a_training_draws_from_no_global_generator(method: str) -> None:
    """Checkpoints hold none of them, so a number drawn from one would differ after an interruption."""
    training = fresh(method)
    torch_before, numpy_before, python_before = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
    training.run(lambda: None)
    assert torch.equal(torch_before, torch.get_rng_state())
    assert repr(numpy_before) == repr(np.random.get_state())  # noqa: NPY002
    assert python_before == random.getstate()


def test_the_seconds_of_all_sessions_count(tmp_path: Path) -> None:
    seconds: list[float] = []

    def remembered(context: Context) -> Checkpoints:
        worked_before = context.worked_before
        context.worked_before = lambda value: (seconds.append(value), worked_before(value))[1]  # type: ignore[method-assign]
        return Checkpoints(context, every=math.inf)

    session("plain", tmp_path, stop_after=20)
    session("plain", tmp_path, stop_after=30, make=remembered)
    ended = session("plain", tmp_path, make=remembered)
    assert isinstance(ended, Trained)
    assert 0 < seconds[0] < seconds[1]
    (table,) = (line for line in ended.log if "ms an iteration" in line)
    assert f"mean of {ITERATIONS}" in table


def test_the_stopwatch_goes_on_too(tmp_path: Path) -> None:
    session("plain", tmp_path, stop_after=20)
    checkpoints = Checkpoints(Context({}, {}, tmp_path, "test", Services()))
    found = checkpoints.newest()
    assert found is not None
    checkpoints.save(State(found.state.arrays, {**found.state.values, "seconds": [["loss", "backward", 1e6]]}))
    ended = session("plain", tmp_path)
    assert isinstance(ended, Trained)
    (table,) = (line for line in ended.log if "ms an iteration" in line)
    assert re.search(r"\n  loss +(99\.\d|100\.0) % ", table)


def test_a_bound_that_limits_growth_is_told_once_in_all_sessions(tmp_path: Path) -> None:
    log = session("plain", tmp_path, stop_after=35)
    ended = session("plain", tmp_path)
    assert isinstance(log, list)
    assert isinstance(ended, Trained)
    assert [sum("maximum_gaussians" in line for line in lines) for lines in (log, ended.log)] == [1, 0]

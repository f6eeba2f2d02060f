"""Which signals ask a run to stop, and which of them ask it again."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from pipeline.run.executor import SerialExecutor, Tell
from pipeline.run.interruption import STOPPING, interruptible
from tests.pipeline.helpers import CHAIN, Workspace


@pytest.fixture(autouse=True)
def heeded() -> Iterator[None]:
    """The tests may have been started with these signals ignored, as by `nohup`."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in STOPPING}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("first", STOPPING)
def test_only_ctrl_c_asks_again(first: signal.Signals) -> None:
    """A hangup comes twice, from the shell and from the kernel, but nobody means it to stop the run at once."""
    asked: list[None] = []
    with interruptible(lambda: asked.append(None)):
        signal.raise_signal(first)
        assert len(asked) == 1
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGTERM)
        assert len(asked) == 1
        signal.raise_signal(signal.SIGINT)
        assert len(asked) == 2


class Interrupted(SerialExecutor):
    """Gets a Ctrl-C whenever it waits, and then goes on with its work, or never ends it (`stubborn`)."""

    def __init__(self, stubborn: bool) -> None:
        super().__init__()
        self.stubborn, self.times = stubborn, 0

    def wait(self, tell: Tell, seconds: float) -> tuple[str, object] | None:
        self.times += 1
        assert self.times <= 2, "it should have ended at the second"
        signal.raise_signal(signal.SIGINT)
        return None if self.stubborn else super().wait(tell, seconds)


def test_the_second_ctrl_c_ends_a_run_at_once(workspace: Workspace) -> None:
    executor = Interrupted(stubborn=True)
    with pytest.raises(KeyboardInterrupt):
        workspace.write("stages:\n  a: {uses: numbers}\n").run(executor=executor)
    assert executor.times == 2


def test_what_an_interrupted_run_did_not_get_to_stays_in_latest(workspace: Workspace) -> None:
    store = workspace.write(CHAIN).run().project.store
    before = store.latest_digests()
    ran = workspace.run("count=4", executor=Interrupted(stubborn=False))
    assert set(ran.states.values()) == {"skipped"}
    assert ran.summary.interrupted
    assert store.latest_digests() == before


class Closing(SerialExecutor):
    """Is interrupted while it ends its workers."""

    def close(self) -> None:
        super().close()
        for number in (signal.SIGHUP, signal.SIGTERM):
            assert signal.getsignal(number) is not signal.SIG_DFL, "it would be killed by the second hangup"
            signal.raise_signal(number)


def test_a_run_that_ends_its_workers_is_not_killed(workspace: Workspace) -> None:
    ran = workspace.write("stages:\n  a: {uses: numbers}\n").run(executor=Closing())
    assert ran.states == {"a": "ran"}
    assert not ran.summary.interrupted, "all was done before"

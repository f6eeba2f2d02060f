"""Which signals ask a run to stop, and which of them ask it again."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from pipeline.run.executor import SerialExecutor
from pipeline.run.interruption import STOPPING, interruptible
from tests.pipeline.helpers import Workspace


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

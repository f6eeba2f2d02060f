"""A picture's time ends when it is drawn, not when a GPU was told to draw it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from stages.hiding.rendering import Rendering
from stages.time_frames import wait_for


@pytest.mark.parametrize("is_cuda", [True, False])
def test_a_gpu_is_waited_for(monkeypatch: pytest.MonkeyPatch, is_cuda: bool) -> None:
    waited: list[Any] = []
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    device = torch.device("cuda", 0) if is_cuda else torch.device("cpu")
    feature_map = SimpleNamespace(is_cuda=is_cuda, device=device)
    wait_for(cast(Rendering, SimpleNamespace(feature_map=feature_map)))
    assert waited == ([device] if is_cuda else [])

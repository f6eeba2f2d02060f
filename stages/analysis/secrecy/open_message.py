"""A message that lies open in the container: with 3DGS+SH, whoever has the file renders it."""

from __future__ import annotations

from stages.hiding.method import Method, build_method
from stages.scene.gaussians import Gaussians

MESSAGE_HARMONICS = "message_sh_base"
"""[N, L, 3]: one set of colours for each message, in the published file."""


def open_reader(public: Method, gaussians: Gaussians) -> Method | None:
    """The method that shows the messages from public attributes alone; None where there are none such.

    Its messages are numbered: their names, alone, are the owner's.
    """
    if MESSAGE_HARMONICS not in gaussians.parameters:
        return None
    names = [f"message {number}" for number in range(gaussians[MESSAGE_HARMONICS].shape[1])]
    return build_method(public.name, {**public.settings, "messages": names})

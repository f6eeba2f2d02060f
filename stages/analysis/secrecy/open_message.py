"""A message that the container holds openly: with 3DGS+SH, anyone who has the file can render it."""

from __future__ import annotations

from stages.hiding.method import Method, build_method
from stages.scene.gaussians import Gaussians

MESSAGE_HARMONICS = "message_sh_base"
"""The published parameter with the messages' colours, [N, L, 3]: one colour for each message."""


def open_reader(public: Method, gaussians: Gaussians) -> Method | None:
    """A method that renders the messages from public attributes alone; None if there are no such attributes.

    Its messages are numbered, since only their names are secret.
    """
    if MESSAGE_HARMONICS not in gaussians.parameters:
        return None
    names = [f"message {number}" for number in range(gaussians[MESSAGE_HARMONICS].shape[1])]
    return build_method(public.name, {**public.settings, "messages": names})

"""A test of whether the message decoder decodes or has memorised the message: what it shows for other features.

A decoder with 121,795 weights could memorise pictures, and would then show them whatever its input. So it is given the
container's geometry with other features: those of another container, the same ones for all Gaussians, or its own with
channels set to zero. (The camera-ready GS-Hider paper has such a test, without a floor to compare with.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import torch

from stages.analysis.fidelity import covered_psnrs
from stages.analysis.probes import RawFeatures, run_name
from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.imaging.metric_table import MetricRow
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.quantities import QUANTITIES
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene


@torch.no_grad()
def probe_rows(
    gaussians: Gaussians,
    method: Method,
    name: str,
    scene: Scene,
    messages: Mapping[str, MessageViews],
    features: Mapping[str, RawFeatures],
    after_each: Callable[[], None],
) -> Iterator[MetricRow]:
    """PSNR over each message's covered pixels, and that of the best single colour, on test views for each probe.

    `features` are by probe, `name` is the method's; the rows' method is their `run_name`.
    """
    cameras = single_cameras(scene.cameras.select(scene.test_names))
    for probe, raw in features.items():
        probed, run = gaussians.with_parameters({FEATURES: raw}), run_name(name, probe)
        for view, row, camera in zip(scene.test_names, scene.rows(scene.test_names), cameras, strict=True):
            pictures = method.render(probed, camera, wanted=tuple(messages)).pictures
            for title, message in messages.items():
                coverage = torch.from_numpy(message.coverage[row])
                figures = covered_psnrs(pictures[title], picture_to_tensor(message.pictures[row]), coverage)
                for quantity, value in figures.items():
                    yield MetricRow(quantity, value, QUANTITIES[quantity].unit, view, "test", title, method=run)
            after_each()

"""All readings of one container without its secret, with their measurements and pictures of the test views."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from stages.analysis.comparisons import Comparison, Role
from stages.analysis.measurements import Measurement
from stages.analysis.secrecy.apart import TellsShares
from stages.analysis.secrecy.blind import blind_readings, stretched
from stages.analysis.secrecy.conditions import (
    BLIND,
    COVER_ITSELF,
    LINEAR,
    LOSS,
    NOTHING_HIDDEN,
    OPEN,
    OWNER,
    PAINTED,
    SURROGATE,
    VIEWS_SEEN,
)
from stages.analysis.secrecy.feature_map import feature_map_correlations
from stages.analysis.secrecy.linear_surrogate import linear_surrogate
from stages.analysis.secrecy.measuring import picture_readings
from stages.analysis.secrecy.observing import Observed, observe
from stages.analysis.secrecy.open_message import open_reader
from stages.analysis.secrecy.painting import STEPS, painted_surrogate
from stages.analysis.secrecy.readers import attackers_reader, read
from stages.analysis.secrecy.surrogate import SurrogateSettings, seen_views, train_surrogate
from stages.analysis.secrecy.wrong_decoder import wrong_readings
from stages.hiding.method import Method, move_networks
from stages.hiding.networks import MESSAGE_DECODER
from stages.imaging.pictures import tensor_to_picture
from stages.scene.cameras import single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.message_views import MessageViews
from stages.scene.scene import Scene

Readings = Sequence[Float[Tensor, "L H W 3"]]

PROBES_SEED = 0
"""Seed of the random probes of the scene decoder; its choice does not matter."""

CPU = torch.device("cpu")

LAST_STEPS = 100
"""The number of last steps over which a surrogate's loss is averaged."""


@dataclass(frozen=True)
class Trained:
    """The readings of the test views by the surrogates of one seed and share.

    `painted` is None for a method that does not reveal the cover's share of a Gaussian. `loss` is the network's mean
    loss over its last steps.
    """

    network: Readings
    linear: Readings
    painted: Readings | None
    loss: float


@dataclass(frozen=True)
class SecrecySettings:
    """Settings of the readings; see the parameters of the stage `probe_secrecy`."""

    wrong_decoders: int
    start_seed: int | None
    shares: tuple[float, ...]
    seeds: tuple[int, ...]
    surrogates: SurrogateSettings


@dataclass
class Probe:
    """A container to read without its secret, and the rows and pictures found so far.

    `public` is the container's method without the secret, `owner` with it. `gaussians` are the published ones,
    `unsealed` those that the owner renders, the same if there is no seal. `clean` are the Gaussians and the method of
    the control, a container that hides nothing, if there is one. All are on the CPU; surrogates train on `device`.
    """

    gaussians: Gaussians
    unsealed: Gaussians
    public: Method
    owner: Method
    scene: Scene
    messages: Mapping[str, MessageViews]
    clean: tuple[Gaussians, Method] | None
    settings: SecrecySettings
    device: torch.device = CPU
    rows: list[Measurement] = field(default_factory=list)
    pictures: list[Comparison] = field(default_factory=list)

    def run(self, progress: Callable[[int, int], None]) -> tuple[list[Measurement], list[Comparison]]:
        """Measurements and pictures of all readings. `progress` receives the amounts of work done and in total."""
        opened = open_reader(self.public, self.gaussians)
        decoded = MESSAGE_DECODER in self.owner.networks
        tick = _Counter(progress, self._amount(decoded)).tick
        views = self._observed(opened or self.public, self.scene.test_names)
        self._add_pictures(OWNER, self._rendered(self.unsealed, self.owner, tuple(self.messages)), views)
        if opened is not None:
            self._add_pictures(OPEN, self._rendered(self.gaussians, opened, opened.messages), views)
        # This is also what the scene decoder shows if used as the message decoder.
        self._add_pictures(COVER_ITSELF, self._of_each_message([seen.cover for seen in views]), views)
        self._feature_maps(views)
        self._blind(opened or self.public, views)
        if self.clean is not None:
            self._control(*self.clean)
        if decoded:
            self._wrong(views, tick)
            self._surrogates(views, tick)
        return self.rows, self.pictures

    def _amount(self, decoded: bool) -> int:
        settings = self.settings
        trainings = len(settings.seeds) * sum(share > 0 for share in settings.shares)
        painting = STEPS if isinstance(self.public, TellsShares) else 0
        return 2 * settings.wrong_decoders + 1 + trainings * (settings.surrogates.steps + painting) if decoded else 1

    def _observed(self, method: Method, names: Sequence[str]) -> list[Observed]:
        return observe(self.gaussians, method, self.scene, self.messages, names)

    @torch.no_grad()
    def _rendered(self, gaussians: Gaussians, method: Method, names: Sequence[str]) -> Readings:
        cameras = single_cameras(self.scene.cameras.select(self.scene.test_names))
        shown = [method.render(gaussians, camera, wanted=names).pictures for camera in cameras]
        return [torch.stack([pictures[name] for name in names]) for pictures in shown]

    def _feature_maps(self, views: Sequence[Observed]) -> None:
        for found in feature_map_correlations(views):
            figures = {
                "correlation_cover": found.cover,
                "correlation": found.own,
                "correlation_others": found.others,
                "edges_cover": found.edges_cover,
                "edges": found.edges_own,
                "edges_others": found.edges_others,
            }
            self._add(figures, found.line, views[found.view].view, found.message)

    def _blind(self, public: Method, views: Sequence[Observed]) -> None:
        readings = {
            name: stretched(maps) for name, maps in blind_readings(self.gaussians, public, views, PROBES_SEED).items()
        }
        for name, maps in readings.items():
            self._show(name, "feature_map", [seen.cover for seen in views], maps)
            self._add_readings(BLIND.format(name), self._of_each_message(maps), views, 0.0)

    def _control(self, gaussians: Gaussians, method: Method) -> None:
        views = observe(gaussians, method, self.scene, self.messages, self.scene.test_names)
        for found in feature_map_correlations(views):
            figures = {"correlation_clean": found.own, "edges_clean": found.edges_own}
            self._add(figures, found.line, views[found.view].view, found.message)
        for name, maps in blind_readings(gaussians, method, views, PROBES_SEED).items():
            condition = NOTHING_HIDDEN.format(BLIND.format(name))
            self._add_readings(condition, self._of_each_message(stretched(maps)), views, 0.0)

    def _of_each_message(self, maps: Sequence[Float[Tensor, "H W C"]]) -> Readings:
        """The same reading, repeated for each message."""
        return [each.expand(len(self.messages), *each.shape) for each in maps]

    def _wrong(self, views: Sequence[Observed], tick: Callable[[], None]) -> None:
        settings, shown = self.settings, set[str]()
        for wrong in wrong_readings(self.public, views, settings.wrong_decoders, settings.start_seed, tick):
            add = self._add_readings if wrong.condition in shown else self._add_pictures
            add(wrong.condition, wrong.readings, views, None, wrong.seed)
            shown.add(wrong.condition)

    def _surrogates(self, views: Sequence[Observed], tick: Callable[[], None]) -> None:
        for seed in self.settings.seeds:
            add = self._add_pictures if seed == self.settings.seeds[0] else self._add_readings
            done: dict[int, Trained] = {}
            for share in (each for each in self.settings.shares if each > 0):
                names = seen_views(self.scene.train_names, share, seed)
                if len(names) not in done:  # with few views, several shares come to the same number
                    done[len(names)] = self._trained(names, views, seed, tick)
                trained = done[len(names)]
                add(SURROGATE, trained.network, views, share, seed)
                add(LINEAR, trained.linear, views, share, seed)
                if trained.painted is not None:
                    add(PAINTED, trained.painted, views, share, seed)
                self.rows += [
                    Measurement(quantity, value, SURROGATE, share, seed, method=self.public.name)
                    for quantity, value in ((VIEWS_SEEN, float(len(names))), (LOSS, trained.loss))
                ]

    def _trained(self, names: Sequence[str], views: Sequence[Observed], seed: int, tick: Callable[[], None]) -> Trained:
        seen = self._observed(self.public, names)
        reader = attackers_reader(self.public, len(self.messages), seed)
        move_networks(reader, self.device)
        losses = train_surrogate(reader, seen, self.settings.surrogates, seed, tick)
        with torch.no_grad():
            network = [read(reader, each.to(self.device)).cpu() for each in views]
        painted = (
            painted_surrogate(self.gaussians, self.public, seen, views, seed, tick)
            if isinstance(self.public, TellsShares)
            else None
        )
        return Trained(network, linear_surrogate(seen, views), painted, float(np.mean(losses[-LAST_STEPS:])))

    def _add(
        self,
        figures: Mapping[str, float],
        condition: str,
        view: str,
        message: int,
        severity: float | None = None,
        seed: int | None = None,
    ) -> None:
        title = list(self.messages)[message]
        self.rows += [
            Measurement(name, value, condition, severity, seed, view, "test", title, self.public.name)
            for name, value in figures.items()
        ]

    def _add_pictures(
        self,
        condition: str,
        readings: Readings,
        views: Sequence[Observed],
        severity: float | None = None,
        seed: int | None = None,
    ) -> None:
        self._add_readings(condition, readings, views, severity, seed)
        for message, title in enumerate(self.messages):
            name = f"{title}: {condition}" + (f", {severity:.0%}" if severity else "")
            truths = [seen.truths[message] for seen in views]
            self._show(name, "message", truths, [reading[message] for reading in readings])

    def _add_readings(
        self,
        condition: str,
        readings: Readings,
        views: Sequence[Observed],
        severity: float | None = None,
        seed: int | None = None,
    ) -> None:
        for view, message, figures in picture_readings(readings, views):
            self._add(figures, condition, views[view].view, message, severity, seed)

    def _show(self, title: str, role: Role, truths: Sequence[Tensor], readings: Sequence[Tensor]) -> None:
        names = self.scene.test_names
        truth, rendered = (np.stack([tensor_to_picture(each) for each in group]) for group in (truths, readings))
        splits = ("test",) * len(names)
        self.pictures.append(Comparison(title, role, self.public.name, names, splits, truth, rendered))


class _Counter:
    """Reports the number of steps done after each of `total` steps."""

    def __init__(self, progress: Callable[[int, int], None], total: int):
        self.progress, self.total, self.done = progress, total, 0

    def tick(self) -> None:
        self.done += 1
        self.progress(min(self.done, self.total), self.total)

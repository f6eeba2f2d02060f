"""The report: the owner's page shows everything, the public page nothing that a message has touched."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from pipeline.stage import LineageRecord, Services
from stages.analysis.comparisons import Comparison, write_comparisons
from stages.analysis.page import gallery
from stages.analysis.page.material import public_lineage, public_material
from stages.analysis.videos import Video, write_videos
from stages.imaging.metric_table import MetricRow, write_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.psnr import psnr
from stages.report import INPUTS, ReportParameters, report
from tests.running import run_stage

PLANTED = "Zebraquartz"
"""The name of the message, in everything private."""
FORBIDDEN = (PLANTED, "message", "hidden", "hide", "secret", "private", "owner", "stegan", "cover", "decode", "feature")
"""What no byte of the public page may spell, in any case."""
VIEWS = tuple(f"view{number:02d}.png" for number in range(10))
SPLITS = tuple("test" if number % 8 == 0 else "train" for number in range(10))
COMMAND = "python -m pipeline run workflows/hide_all.yaml --vars my.yaml --set cover=FOLDER"
VOID_TAGS = {"meta", "img", "br", "link", "input", "line", "path", "rect", "polyline"}


def pictures(seed: int, height: int = 12, width: int = 16) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (len(VIEWS), height, width, 3), dtype=np.uint8)


COVER = Comparison("cover", "cover", "gs_hider", VIEWS, SPLITS, pictures(1), pictures(2))
PLAIN = replace(COVER, method="plain", rendered=pictures(3))
FEATURES = replace(COVER, title="feature map", role="feature_map", truth=pictures(4), rendered=pictures(4))
MESSAGE = replace(COVER, title=PLANTED, role="message", truth=pictures(5), rendered=pictures(6))

COVER_VIDEO = Video("cover", "cover", "gs_hider", ("cover",), 1, 64, 48, b"webm of the cover")
PLAIN_VIDEO = replace(COVER_VIDEO, method="plain", webm=b"webm of 3DGS")
MESSAGE_VIDEO = replace(COVER_VIDEO, title=PLANTED, role="message", panels=(PLANTED,), webm=b"webm of the message")
FEATURES_VIDEO = replace(COVER_VIDEO, title="feature map", role="feature_map", webm=b"webm of features")
TOGETHER = replace(
    COVER_VIDEO,
    title="side by side",
    role="side_by_side",
    panels=("cover", PLANTED, "feature map"),
    columns=3,
    width=192,
    webm=b"webm of everything",
)
VIDEOS = [COVER_VIDEO, MESSAGE_VIDEO, FEATURES_VIDEO, TOGETHER, PLAIN_VIDEO]

PUBLIC_ROWS = [
    MetricRow("psnr", 31.25, "dB", VIEWS[0], "test", method="gs_hider"),
    MetricRow("psnr", 32.5, "dB", VIEWS[0], "test", method="plain"),
    MetricRow("ssim", 0.912, "", VIEWS[0], "test", method="gs_hider"),
    MetricRow("container_bytes", 4_560_000, "bytes", method="gs_hider"),
]
PRIVATE_ROWS = [
    MetricRow("psnr", 17.8391, "dB", VIEWS[0], "test", PLANTED, method="gs_hider"),
    MetricRow("psnr_covered", 18.7654, "dB", VIEWS[0], "test", PLANTED, method="gs_hider"),
    MetricRow("psnr_constant", 11.2233, "dB", VIEWS[0], "test", PLANTED, method="gs_hider"),
    MetricRow("legal", 1, "", VIEWS[0], "test", PLANTED, method="gs_hider"),
    MetricRow("legal", 0, "", VIEWS[8], "test", PLANTED, method="gs_hider"),
    MetricRow("residual_correlation", 0.0877, "", VIEWS[0], "test", PLANTED, method="plain"),
]
PRIVATE_FIGURES = ("17.84", "18.77", "11.22", "0.088", "17.8391", "54,321", "0.654")


def metrics(path: Path, rows: list[MetricRow], private: bool) -> Artifact:
    with create(path, "metrics", private) as writer:
        write_rows(writer, rows)
    return load(path)


def comparisons(path: Path, listed: list[Comparison], private: bool) -> Artifact:
    with create(path, "comparisons", private) as writer:
        write_comparisons(writer, listed)
    return load(path)


def videos(path: Path, listed: list[Video], private: bool) -> Artifact:
    with create(path, "videos", private) as writer:
        write_videos(writer, listed)
    return load(path)


def record(name: str, uses: str, /, *inputs: str, private: bool = False, **parameters: str | float) -> LineageRecord:
    changed = f"2026-11-25 although code changed: stages.{PLANTED}"
    facts = {"device": "PoCL on a test", "host": "machine-of-ours", "accepted": changed}
    return LineageRecord(name, uses, 12.5, inputs, facts, {"torch": "9.8.7"}, parameters, private)


LINEAGE = (
    record("cover_photos", "synthesize", scene="courtyard"),
    record("cover", "sfm", "cover_photos", width=192),
    record(f"photos[{PLANTED}]", "synthesize", scene=PLANTED),  # not declared private
    record(f"views[{PLANTED}]", "render_hidden", f"photos[{PLANTED}]", "cover", private=True, name=PLANTED),
    record("hiding", "hide_scenes", "cover", f"views[{PLANTED}]", private=True, lambda_message=0.654),
    record("scores", "evaluate", "hiding", "cover", f"views[{PLANTED}]", private=True),
    record(f"timings[cover,{PLANTED}]", "time_frames", "hiding", "cover", method="gs_hider"),
)


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, tuple[Artifact, ...]]:
    curve = [MetricRow("loss", 0.5 / step, "", split="train", iteration=step) for step in (10, 20, 30)]
    secret_curve = [
        MetricRow("psnr", 17.8391, "dB", split="train", message=PLANTED, iteration=10),
        MetricRow("gaussians", 54321, iteration=10),
    ]
    return {
        "scores": (metrics(tmp_path / "scores", PUBLIC_ROWS[:1] + PRIVATE_ROWS + PUBLIC_ROWS[1:], True),),
        # An artifact that claims to be public but is not: its rows are checked one by one.
        "public_scores": (metrics(tmp_path / "public_scores", PUBLIC_ROWS + PRIVATE_ROWS, False),),
        "curves": (
            metrics(tmp_path / "plain_curves", curve, False),
            metrics(tmp_path / "curves", curve + secret_curve, True),
        ),
        "timings": (metrics(tmp_path / "timings", [MetricRow("seconds_per_frame", 0.0417, "s")], False),),
        "pictures": (comparisons(tmp_path / "pictures", [COVER, MESSAGE, FEATURES, PLAIN], True),),
        "public_pictures": (comparisons(tmp_path / "public_pictures", [COVER, MESSAGE, FEATURES, PLAIN], False),),
        "videos": (videos(tmp_path / "videos", VIDEOS, True),),
        "public_videos": (videos(tmp_path / "public_videos", VIDEOS, False),),
    }


def pages(inputs: dict[str, tuple[Artifact, ...]], folder: Path, views: int = 6) -> dict[str, Artifact]:
    services = Services(lineage=lambda: LINEAGE, command=COMMAND)
    return run_stage(report, ReportParameters(views=views), inputs, folder, services=services, workflow_name="hide_all")


def text_of(page: Artifact) -> str:
    return page.file("report.html").read_text(encoding="utf-8")


def embedded_pictures(text: str) -> list[np.ndarray]:
    found = re.findall(r'src="data:image/\w+;base64,([^"]+)"', text)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))) for data in found]


def embedded_videos(text: str) -> set[bytes]:
    return {base64.b64decode(data) for data in re.findall(r'src="data:video/webm;base64,([^"]+)"', text)}


def shows(text: str, picture: np.ndarray) -> bool:
    return any(np.array_equal(each, picture) for each in embedded_pictures(text))


def test_nothing_private_reaches_the_public_page(inputs: dict, tmp_path: Path) -> None:
    public = pages(inputs, tmp_path / "made")["public"]
    for path in (path for path in public.path.rglob("*") if path.is_file()):
        data = re.sub(rb"base64,[^\"]+", b"", path.read_bytes()).lower()
        words = (PLANTED,) if path.name == "manifest.json" else FORBIDDEN  # a manifest says "private": false
        for planted in (*words, *PRIVATE_FIGURES, "gs-hider", "gs_hider", "machine-of-ours", "hide_all"):
            assert planted.lower().encode() not in data, f"{planted} in {path.name}"
    text = text_of(public)
    for private in (*MESSAGE.truth, *MESSAGE.rendered, *FEATURES.rendered):
        assert not shows(text, private)
    assert embedded_videos(text) == {COVER_VIDEO.webm, PLAIN_VIDEO.webm}
    assert not public.private
    assert not public.attributes


def test_the_public_page_shows_the_scene(inputs: dict, tmp_path: Path) -> None:
    text = text_of(pages(inputs, tmp_path / "made")["public"])
    for expected in (
        "31.25",
        "pictures of 16 x 12 pixels",
        "32.50",
        "0.912",
        "4.56",
        "41.7",
        "This scene",
        "3DGS",
        "synthesize",
        "9.8.7",
        "192",
    ):
        assert expected in text, expected
    assert "None of it is public." not in text
    assert shows(text, COVER.truth[0])
    assert shows(text, COVER.rendered[0])
    assert shows(text, PLAIN.rendered[0])


def test_parameters_that_are_texts_are_not_on_the_public_page(inputs: dict, tmp_path: Path) -> None:
    """They may be names of folders on the owner's disk."""
    made = pages(inputs, tmp_path / "made")
    assert "courtyard" in text_of(made["owner"])
    assert "courtyard" not in text_of(made["public"])


def test_the_public_page_says_how_what_it_shows_was_trained(inputs: dict) -> None:
    """Private stages alone use the training, but its curve is public and on the page."""
    [curve, _] = inputs["curves"]
    trained = replace(
        record("plain", "train_scene", "cover", iterations=2000, ssim_weight_cover=0.2), outputs=(curve.digest,)
    )
    used = record("scores", "evaluate", "plain", private=True)
    lineage = (*LINEAGE[:2], trained, used)
    given = {name: inputs.get(name, ()) for name in INPUTS}
    shown = public_material(given, lineage).lineage
    assert [each.uses for each in shown] == ["synthesize", "sfm", "train_scene"]
    assert shown[-1].parameters == {"iterations": 2000}, "a name of the others speaks of a cover"
    assert [each.uses for each in public_lineage(lineage)] == []


def test_visitors_are_not_told_what_to_install(inputs: dict, tmp_path: Path) -> None:
    made = pages(inputs, tmp_path / "made")
    assert "pip install" in text_of(made["owner"])
    assert "install" not in text_of(made["public"])


def test_an_artifact_that_is_private_is_not_read_for_the_public_page(inputs: dict, tmp_path: Path) -> None:
    only_private = {name: tuple(each for each in given if each.private) for name, given in inputs.items()}
    made = pages(only_private, tmp_path / "made")
    text = text_of(made["public"])
    assert "31.25" not in text
    assert not embedded_pictures(text)
    assert not embedded_videos(text)
    assert "Moving camera" not in text
    assert "None of it is public." in text
    assert "31.25" in text_of(made["owner"])


def test_the_owner_sees_everything(inputs: dict, tmp_path: Path) -> None:
    owner = pages(inputs, tmp_path / "made")["owner"]
    text = text_of(owner)
    for expected in (
        *(
            PLANTED,
            "One message is hidden",
            "17.84",
            "18.77",
            "11.22",
            "1 of 2",
            "0.088",
            "31.25",
            "41.7",
            "pictures of 16 x 12 pixels",
        ),
        *("GS-Hider", "3DGS", f"views[{PLANTED}]", "hiding", "lambda_message", "0.654", "12.5 s", "PoCL on a test"),
        *("54,321", "machine-of-ours", COMMAND, "LPIPS was not measured"),
    ):
        assert expected in text, expected
    for each in (COVER, PLAIN, MESSAGE, FEATURES):
        assert shows(text, each.rendered[0]), each.title
        assert shows(text, each.rendered[8]), each.title
    difference = np.abs(COVER.rendered[0].astype(int) - COVER.truth[0])
    assert shows(text, np.minimum(difference * 8, 255).astype(np.uint8))
    assert owner.private


def test_a_hidden_image_is_told_of_at_its_view(inputs: dict, tmp_path: Path) -> None:
    """Elsewhere the decoder shows something arbitrary, so nothing is said of test views."""
    rows = [
        *PUBLIC_ROWS,
        MetricRow("psnr", 30.0, "dB", "hiding.png", "train", None, method="gs_hider"),
        MetricRow("psnr", 43.21, "dB", "hiding.png", "train", PLANTED, method="gs_hider"),
        MetricRow("hides_image", 1.0, "", "hiding.png", "train", PLANTED, method="gs_hider"),
    ]
    given = {**inputs, "scores": (metrics(tmp_path / "image", rows, True),)}
    top = top_of(text_of(pages(given, tmp_path / "made")["owner"]))
    assert f"the cover reaches 31.25 dB, {PLANTED} 43.21 dB in the view that hides it." in top
    assert f'<span class="label">{PLANTED}, in its view</span> <strong>43.21 dB</strong>' in top


def test_scores_of_several_containers_are_not_taken_for_one(inputs: dict, tmp_path: Path) -> None:
    """3DGS of the cover, which many are compared with, is no container, and the same scores twice are one."""
    [scores] = inputs["scores"]
    other = metrics(tmp_path / "other", [replace(row, value=row.value + 1) for row in PUBLIC_ROWS], True)
    plain = metrics(tmp_path / "plain", [replace(PUBLIC_ROWS[1], value=30.0)], True)
    pages({**inputs, "scores": (scores, plain, scores)}, tmp_path / "made")
    with pytest.raises(UserError, match=r"2 of `scores` are of 'gs_hider'.*Use `tabulate`"):
        pages({**inputs, "scores": (scores, other)}, tmp_path / "refused")


def top_of(text: str) -> str:
    return text[text.index("<header>") : text.index("</header>")]


def test_the_owner_sees_what_moves_side_by_side(inputs: dict, tmp_path: Path) -> None:
    """A video that is part of a side-by-side video is not shown separately."""
    text = text_of(pages(inputs, tmp_path / "made")["owner"])
    assert embedded_videos(text) == {TOGETHER.webm, PLAIN_VIDEO.webm}
    films = text[text.index("<h2>Moving camera") : text.index("<h2>Cover")]
    assert re.findall(r"<span>([^<]+)</span>", films) == [
        *("cover · GS-Hider", f"{PLANTED} · GS-Hider", "feature map · GS-Hider", "cover · 3DGS"),
    ]
    for tag in re.findall(r"<video[^>]*>", films):
        for attribute in ("autoplay", "muted", "loop", "controls", "playsinline"):
            assert re.search(rf"\s{attribute}[\s>]", tag), attribute


def test_test_views_come_first_and_the_rest_is_filled_up(inputs: dict, tmp_path: Path) -> None:
    made = pages(inputs, tmp_path / "a", 4)
    expected = [("view00.png", "test"), ("view08.png", "test"), ("view01.png", "train"), ("view09.png", "train")]
    assert headings(text_of(made["owner"]))[:4] == expected
    assert headings(text_of(made["public"])) == [(f"View {n}", split) for n, (_, split) in enumerate(expected, start=1)]
    assert headings(text_of(pages(inputs, tmp_path / "b", 1)["public"])) == [("View 1", "test")]


def headings(text: str) -> list[tuple[str, str]]:
    """The heading of each view and its split."""
    return re.findall(r"<h3>([^<]+) <span class=\"tag\">(\w+)", text)


def test_names_of_photos_are_not_on_the_public_page(inputs: dict, tmp_path: Path) -> None:
    assert "view00.png" not in text_of(pages(inputs, tmp_path / "made")["public"])


class Reader(HTMLParser):
    """Checks that tags are closed in order, and collects all that a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        assert tag not in {"script", "link", "iframe", "object"}
        self.fetched += [
            str(value) for name, value in attributes if name in {"src", "href", "srcset", "data", "xlink:href"}
        ]
        if tag not in VOID_TAGS:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID_TAGS:
            assert self.open.pop() == tag


@pytest.mark.parametrize("name", ["owner", "public"])
def test_a_page_is_whole_and_fetches_nothing(inputs: dict, tmp_path: Path, name: str) -> None:
    text = text_of(pages(inputs, tmp_path / "made")[name])
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    assert text.startswith("<!DOCTYPE html>")
    assert reader.fetched
    assert all(address.startswith(("data:image/", "data:video/")) for address in reader.fetched)
    style = text[text.index("<style>") : text.index("</style>")]
    assert not re.search(r"url\(|@import|https?:", style)
    assert "http" not in re.sub(r"base64,[^\"]+", "", text)
    assert "&amp;gt;" not in text  # nothing is escaped twice
    assert "--paper: " in style


def test_names_are_text_and_never_markup(inputs: dict, tmp_path: Path) -> None:
    rows = [replace(row, message="<script>alert(1)</script>") for row in PRIVATE_ROWS]
    named = {"scores": (metrics(tmp_path / "odd", rows, True),)}
    text = text_of(pages(named, tmp_path / "made")["owner"])
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text


def test_many_pictures_become_jpeg(inputs: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "data:image/png" in text_of(pages(inputs, tmp_path / "few")["owner"])
    monkeypatch.setattr(gallery, "LOSSLESS_PIXELS", 1000)
    text = text_of(pages(inputs, tmp_path / "many")["owner"])
    assert "data:image/jpeg" in text
    assert "data:image/png" not in text


def test_large_pictures_are_shrunk_for_the_page_and_measured_whole(inputs: dict, tmp_path: Path) -> None:
    """Unshrunk, full-size photos would make a page of tens of megabytes."""
    truth = pictures(7, 1000, 1600)[:1]
    rendered = truth.copy()
    rendered[:, ::2] = 0  # shrinking makes the pictures more alike
    large = replace(COVER, names=VIEWS[:1], splits=SPLITS[:1], truth=truth, rendered=rendered)
    given = {
        "pictures": (comparisons(tmp_path / "large", [large], True),),
        "public_pictures": (comparisons(tmp_path / "public", [large], False),),
    }
    made = pages(given, tmp_path / "made", 1)
    text = text_of(made["owner"])
    assert {picture.shape for picture in embedded_pictures(text)} == {(500, 800, 3)}
    assert "Shown at most 800 pixels long" in text
    assert f"{psnr(picture_to_tensor(rendered[0]), picture_to_tensor(truth[0])):.2f} dB" in text
    assert "`show --pictures` writes them" in text
    assert "Shown at most 800 pixels long. Figures are for full-size pictures.<" in text_of(made["public"])
    assert "Shown at most" not in text_of(pages(inputs, tmp_path / "small", 1)["owner"])


def test_the_same_inputs_give_the_same_bytes(inputs: dict, tmp_path: Path) -> None:
    once, again = (pages(inputs, tmp_path / name) for name in ("once", "again"))
    assert {name: page.digest for name, page in once.items()} == {name: page.digest for name, page in again.items()}

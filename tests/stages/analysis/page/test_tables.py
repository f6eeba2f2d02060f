from __future__ import annotations

import math

from stages.analysis.page.material import Material
from stages.analysis.page.tables import Table, tables_of
from stages.imaging.metric_table import MetricRow


def material(*rows: MetricRow) -> Material:
    return Material(rows, (), (), ())


def row(quantity: str, value: float, view: str = "a", method: str = "ours", message: str | None = None) -> MetricRow:
    return MetricRow(
        quantity, value, view=view, split="train" if view == "z" else "test", message=message, method=method
    )


def cells(table: Table, line: str) -> list[str]:
    return [f"*{cell.text}*" if cell.best else cell.text for cell in dict(table.lines)[line]]


def test_nothing_was_measured() -> None:
    assert tables_of(material()) == ()
    assert tables_of(material(row("psnr", math.nan))) == ()


def test_means_by_method_and_split_without_empty_columns() -> None:
    [table] = tables_of(
        material(
            row("psnr", 20),
            row("psnr", 30, "b"),
            row("psnr", 40, "z"),
            row("lpips_vgg", math.nan),
            row("psnr", 26, method="other"),
            MetricRow("gaussians", 1234, method="other"),
        )
    )
    assert table.caption == "Scene"
    assert table.groups == (("Test views", 1), ("Training views", 1), ("Scene", 1))
    assert table.headings == ("PSNR (dB)", "PSNR (dB)", "Gaussians")
    assert cells(table, "ours") == ["25.00", "40.00", "–"]
    assert cells(table, "other") == ["*26.00*", "–", "1,234"]
    assert table.starts == (0, 1, 2)


def test_lower_is_better_where_it_is_and_equal_as_written_is_equal() -> None:
    [table] = tables_of(
        material(
            *(row("lpips_vgg", 0.2), row("lpips_vgg", 0.3, method="other")),
            *(row("ssim", 0.90001), row("ssim", 0.90002, method="other")),
        )
    )
    assert cells(table, "ours") == ["0.900", "*0.200*"]
    assert cells(table, "other") == ["0.900", "0.300"]


def test_legal_views_stand_apart_for_each_message() -> None:
    cover, messages = tables_of(
        material(
            row("psnr", 25),
            *(row("psnr", 20, message="reef"), row("psnr", 10, "b", message="reef")),
            *(row("legal", 1, message="reef"), row("legal", 0, "b", message="reef")),
            *(row("psnr", 15, message="library"), row("legal", 1, message="library")),
        )
    )
    assert cover.caption == "Cover"
    assert messages.groups == (("Whole pictures", 1), ("Legal test views", 2))
    assert cells(messages, "reef · ours") == ["15.00", "1 of 2", "20.00"]
    assert cells(messages, "library · ours") == ["15.00", "1 of 1", "15.00"]


def test_messages_are_not_rivals_but_methods_are() -> None:
    _, messages = tables_of(
        material(
            row("psnr", 25),
            row("psnr", 21, message="reef"),
            row("psnr", 22, method="other", message="reef"),
            row("psnr", 29, message="library"),
        )
    )
    assert cells(messages, "reef · other") == ["*22.00*"]
    assert cells(messages, "library · ours") == ["29.00"]


def test_a_control_without_messages_of_its_own_stands_only_in_the_table_of_traces() -> None:
    tables = tables_of(
        material(
            row("psnr", 20, message="reef"),
            *(
                row("residual_correlation", 0.05, message="reef"),
                row("residual_correlation_others", 0.06, message="reef"),
            ),
            row("residual_correlation", 0.04, method="plain", message="reef"),
        )
    )
    lines = {table.caption: [name for name, _ in table.lines] for table in tables}
    assert lines == {
        "Messages on test views": ["reef · ours"],
        "Traces of the messages in the cover, test views": ["reef · ours", "reef · plain"],
    }

"""Pages as HTML: a template of its own for each kind of page, in the frame that all have in common."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

RESOURCES = ("templates/*",)
TEMPLATES = Path(__file__).parent / "templates"


def fill(template: str, page: object, *folders: Path) -> str:
    """The page as HTML, complete in itself: no script, and nothing that is fetched from anywhere.

    The template is looked for in `folders`, then among those that all pages share. Texts of `page` never become markup.
    """
    environment = Environment(
        loader=FileSystemLoader([*folders, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(page=page)

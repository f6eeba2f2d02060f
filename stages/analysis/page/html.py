"""Pages as HTML: a template of its own for each kind of page, in the frame that all have in common."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from jinja2 import DictLoader, Environment, StrictUndefined


def templates_beside(module: str) -> Mapping[str, str]:
    """The templates of the module at this path, by file name.

    To be read when the module is loaded: a page that is written hours later is by the same templates, whatever was
    edited since.
    """
    folder = Path(module).parent / "templates"
    return {file.name: file.read_text(encoding="utf-8") for file in sorted(folder.iterdir()) if file.is_file()}


RESOURCES = ("templates/*",)
TEMPLATES = templates_beside(__file__)


def fill(template: str, page: object, own: Mapping[str, str] = MappingProxyType({})) -> str:
    """The page as HTML, complete in itself: no script, and nothing that is fetched from anywhere.

    The template is looked for in `own`, then among those that all pages share. Texts of `page` never become markup.
    """
    environment = Environment(
        loader=DictLoader({**TEMPLATES, **own}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(page=page)

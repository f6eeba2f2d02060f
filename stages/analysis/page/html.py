"""Pages as HTML: each kind of page has its own template, within a common frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from jinja2 import DictLoader, Environment, StrictUndefined


def templates_beside(module: str) -> Mapping[str, str]:
    """The templates in the folder `templates` beside the module at this path, by file name.

    Modules call this when loaded, so that a page written hours later uses the same templates, even if edited since.
    """
    folder = Path(module).parent / "templates"
    return {file.name: file.read_text(encoding="utf-8") for file in sorted(folder.iterdir()) if file.is_file()}


RESOURCES = ("templates/*",)
TEMPLATES = templates_beside(__file__)


def fill(template: str, page: object, own: Mapping[str, str] = MappingProxyType({})) -> str:
    """The page as self-contained HTML, which has no script and fetches nothing.

    The template is looked up in `own`, then among the shared ones. All texts of `page` are escaped.
    """
    environment = Environment(
        loader=DictLoader({**TEMPLATES, **own}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(page=page)

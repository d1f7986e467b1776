"""Pages for browsers: templates filled in, in one file each.

What flows in: the name of a template, and values. What flows out: HTML. Rules: a page loads
nothing, is complete without its script, and allows no other script or style than its own, whatever
a device says about itself; every value is escaped.
"""

from base64 import b64encode
from functools import cache
from hashlib import sha256
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ._text import file_text

__all__ = ["data_url", "page"]


def page(template: str, **values: object) -> bytes:
    """Return the page that the template makes of these values."""
    text = _environment().get_template(template).render(values)
    return file_text(text).encode()


def data_url(svg: bytes) -> str:
    """Return an URL that is the picture itself."""
    return f"data:image/svg+xml;base64,{b64encode(svg).decode()}"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    sources = {
        name: _source(file) for name, file in (("style", "style.css"), ("script", "filter.js"))
    }
    # These two are files of the package, so nothing in them needs escaping.
    environment.globals.update({name: Markup(text) for name, text in sources.items()})
    environment.globals["hashes"] = {name: _hash(text) for name, text in sources.items()}
    return environment


def _source(file: str) -> str:
    return files(__package__).joinpath("templates", file).read_text("utf-8").strip()


def _hash(text: str) -> str:
    return f"sha256-{b64encode(sha256(text.encode()).digest()).decode()}"

"""Builds one page with the extensions of docs/_ext."""

from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.docutils import docutils_namespace, patch_docutils

EXTENSIONS = Path(__file__).parents[1] / "_ext"
CONF = f"""
import sys
sys.path.insert(0, {str(EXTENSIONS)!r})
extensions = [
    "myst_parser", "c_api", "kill_matrix", "packet_figure", "program_help", "requirement_ids",
    "transport_tables", "usb_checks",
]
myst_enable_extensions = ["colon_fence"]
nitpicky = True
nitpick_ignore_regex = [("c:identifier", ".*")]
smartquotes = False
"""


def build(folder, page, builder="html"):
    """Build one page; return its text and the warnings."""
    app = built(folder, page, builder)
    [output] = folder.glob("out/index.*")
    return output.read_text(), app.warnings.read_text()


def built(folder, page, builder="html"):
    """Build one page; return the application, which has a file of its warnings."""
    source = folder / "source"
    source.mkdir()
    (source / "conf.py").write_text(CONF)
    (source / "index.md").write_text(page)
    warnings = folder / "warnings.txt"
    with warnings.open("w") as stream, patch_docutils(), docutils_namespace():
        app = Sphinx(
            source, source, folder / "out", folder / "trees", builder, status=None, warning=stream
        )
        app.build()
    app.warnings = warnings
    return app

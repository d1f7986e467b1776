"""Configuration of Sphinx. Warnings are errors in the build that `make docs` runs."""

import gc
import sys
from importlib import metadata
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

# Sphinx keeps nearly all that it makes: looking for garbage costs an eighth of the build.
gc.set_threshold(50_000, 20, 100)

project = "J2A"
author = "the authors of J2A"
copyright = "the authors of J2A"
version = release = metadata.version("j2a")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "c_api",
    "docstrings",
    "included_pages",
    "kill_matrix",
    "narrow_tables",
    "packet_figure",
    "program_help",
    "requirement_ids",
    "requirement_pages",
    "transport_tables",
    "usb_checks",
    "worked_out_once",
]
exclude_patterns = ["_build", "_ext", "tests", "examples"]

# Docstrings mark code with single backticks; what it names is linked, see _ext/docstrings.py.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "fully-qualified"
python_use_unqualified_type_names = True
autodoc_typehints_description_target = "documented_params"
autodoc_class_signature = "mixed"
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_preprocess_types = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

highlight_language = "text"
nitpicky = True
# The documentation is built without a network, so there are no links to Python's own.
_ELSEWHERE = "argparse|asyncio|collections|concurrent|construct|enum|pathlib|threading|types|typing"
nitpick_ignore_regex = [
    (r"c:identifier", r"u?int\d+_t|bool"),
    (r"py:.*", rf"({_ELSEWHERE})\..*"),
    (r"py:class", r".*\._\w+|Kernel"),  # private: type variables of decorators, files of the system
    (r"py:class", r".*\.Piece"),  # what FaultInjector deals in
    (r"py:class", r"Path"),  # of pathlib, as it stands in lists of arguments
    (r"py:exc", r"Judged"),  # raised inside of the suite, never out of it
]

html_theme = "furo"
html_title = "J2A"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["j2a.css"]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0b5d7a", "color-brand-content": "#0b5d7a"},
    "dark_css_variables": {"color-brand-primary": "#6cc5e0", "color-brand-content": "#6cc5e0"},
}

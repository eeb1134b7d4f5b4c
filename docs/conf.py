"""Settings of Sphinx: `make docs` builds the pages from the Markdown of the whole repository, without a network."""

import re
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "merlfit"
copyright = "the authors of merlfit, BSD 3-clause"
release = metadata.version("merlfit")

# the source folder is the repository: links between pages are the same here and on a code host
root_doc = "docs/index"
include_patterns = ["docs/**", "results/**.md", "CONTRIBUTING.md", "CHANGELOG.md"]
exclude_patterns = ["docs/_build", "docs/extensions", "docs/redirect"]
html_extra_path = ["redirect"]  # index.html of the built folder

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "mathml",
    "command_line",
    "schema_tables",
]
myst_enable_extensions = ["dollarmath", "attrs_inline"]
myst_fence_as_directive = ["math"]  # as code hosts write it
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_output_stderr = "remove"  # that programs are compiled
nb_execution_timeout = 600
suppress_warnings = ["myst.header"]  # sections of a page may begin at any level

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
napoleon_use_ivar = True
smartquotes = False  # of two hyphens, one dash would be made
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!merlfit\b).*"),
    ("py:.*", r"merlfit\.(fitting|model|merl_io)\..*"),
]  # others' docs

html_theme = "furo"
html_title = f"merlfit {release}"
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["merlfit.css"]
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"
highlight_language = "none"
linkcheck_timeout = 30

ARRAY_LIKE = re.compile(r"(~?[\w.]*Array \| ~?[\w.]*ndarray( \| [~\w.]+)*)(?=[,)\]=]| =| \||$)")


def short_signature(*said: Any) -> tuple[str, str | None] | None:  # noqa: ANN401 - what Sphinx says of a thing
    """Types as the source has them: JAX spells out what may be an array in nine words."""
    *_, given, returns = said
    if given is None:
        return None
    given = ARRAY_LIKE.sub("ArrayLike", given)
    return re.sub(r"~?typing\.Unpack\[~?[\w.]*Replaced\]", "Any", given), returns


def copy_example(app: Sphinx, failed: Exception | None) -> None:
    """The example of a report, to which pages link as it is: Sphinx would take its index out of its folder."""
    if failed is None and app.builder.name == "html":
        there = Path(app.outdir) / "docs" / "report" / "example"
        shutil.copytree(HERE / "report" / "example", there, dirs_exist_ok=True)


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("build-finished", copy_example)
    app.connect("autodoc-process-signature", short_signature)

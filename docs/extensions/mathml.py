"""Equations as MathML, made when the pages are built: no script, no network, and a screen reader can read them."""

import re
from html import escape
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

NAME = "<mi>(?:cos|sin|tan|arccos|ln|exp|Re)</mi>"
FUNCTION = re.compile(f"<msup>{NAME}.*?</msup>|(?<!<msup>){NAME}")
THIN = '<mspace width="0.12em" />'


def inline(page: Any, node: nodes.Element) -> None:  # noqa: ANN401 - Sphinx' own writer
    """An equation within a line."""
    page.body.append(_converted(node.astext(), "inline"))
    raise nodes.SkipNode


def block(page: Any, node: nodes.Element) -> None:  # noqa: ANN401
    """An equation on its own."""
    page.body.append(f'<div class="math">{_converted(node.astext(), "block")}</div>\n')
    raise nodes.SkipNode


def _converted(tex: str, display: str) -> str:
    """MathML with the TeX as its title, which can be copied."""
    made = FUNCTION.sub(rf"{THIN}\g<0>{THIN}", convert(tex, display=display))
    return made.replace("<math ", f'<math title="{escape(tex.strip())}" ', 1)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

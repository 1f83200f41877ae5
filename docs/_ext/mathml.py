"""Equations as MathML, written when the site is built: browsers show it without a script and without a network.

A laboratory's computer is often connected to nothing. An equation that cannot be converted is a warning, and warnings are errors.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number

logger = logging.getLogger(__name__)


def _inline(page: Any, node: nodes.math) -> None:
    page.body.append(_markup(node, "inline"))
    raise nodes.SkipNode


def _block(page: Any, node: nodes.math_block) -> None:
    page.body.append(page.starttag(node, "div", CLASS="math-block", tabindex="0"))
    if node["number"]:
        page.body.append(f'<span class="eqno">({get_node_equation_number(page, node)})</span>')
    page.body.append(f"{_markup(node, 'block')}</div>\n")
    raise nodes.SkipNode


def _markup(node: nodes.Element, display: str) -> str:
    text = node.astext()
    try:
        return str(convert(text, display=display))
    except Exception as error:  # noqa: BLE001  whatever the converter raises concerns this equation
        logger.warning("an equation is not converted (%s): %s", error, text, location=node)
        return f"<code>{nodes.Text(text)}</code>"


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

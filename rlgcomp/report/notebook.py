"""Display of results in a notebook: a heading, a table, and the remarks."""

from __future__ import annotations

import abc
import html
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


class ShownAsTable(abc.ABC):
    """A result that a notebook shows as a table, with a heading above and the remarks, strings or messages, below."""

    @abc.abstractmethod
    def to_frame(self) -> pd.DataFrame:
        """The result as a table."""

    def heading(self) -> str:
        """The line above the table: the first line of the printed result."""
        return repr(self).partition("\n")[0]

    def shown(self) -> pd.DataFrame:
        """The displayed table; by default all of :meth:`to_frame`."""
        return self.to_frame()

    def _repr_html_(self) -> str:
        return table_html(self.heading(), self.shown(), getattr(self, "remarks", ()))


def table_html(heading: str, table: pd.DataFrame, remarks: Iterable[object]) -> str:
    """A heading, a table and remarks as HTML, names and texts escaped.

    Parameters
    ----------
    heading : str
    table : pandas.DataFrame
        Without its index; no table where it is empty.
    remarks : iterable of object
        Shown as texts.
    """
    rows = "" if table.empty else table.to_html(index=False, border=0, float_format="{:.4g}".format, na_rep="", max_rows=60)
    listed = "".join(f"<li>{html.escape(str(remark))}</li>" for remark in remarks)
    return f"<p>{html.escape(heading)}</p>{rows}{listed and f'<ul>{listed}</ul>'}"

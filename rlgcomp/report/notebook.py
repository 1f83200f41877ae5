"""Display of results in a notebook: a heading, a table, and the remarks."""

from __future__ import annotations

import abc
import html
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
        table = self.shown()
        rows = "" if table.empty else table.to_html(index=False, border=0, float_format="{:.4g}".format, na_rep="", max_rows=60)
        remarks = "".join(f"<li>{html.escape(str(remark))}</li>" for remark in getattr(self, "remarks", ()))
        return f"<p>{html.escape(self.heading())}</p>{rows}{remarks and f'<ul>{remarks}</ul>'}"

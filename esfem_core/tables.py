"""Tables for people."""

import html
from collections.abc import Iterable, Sequence
from typing import Any

__all__ = ["Html", "html_table", "text_table"]


class Html:
    """A piece of HTML that a notebook shows.

    Parameters
    ----------
    text : str
        The HTML.
    alternative : str
        What to show where HTML cannot be shown.
    """

    def __init__(self, text: str, alternative: str) -> None:
        self.text = text
        self.alternative = alternative

    def __repr__(self) -> str:
        return self.alternative

    def _repr_html_(self) -> str:
        return self.text


def html_table(header: Iterable[object], rows: Iterable[Iterable[object]], kind: str = "") -> Html:
    """Make a table that scrolls where the page is too narrow for it.

    Parameters
    ----------
    header : iterable
        Heads of the columns.
    rows : iterable of iterables
        Cells, written with ``str`` and escaped; an :class:`Html` stands as it is.
    kind : str
        Further CSS classes.

    Returns
    -------
    Html

    Raises
    ------
    ValueError
        If a row has not one cell for each column.

    Examples
    --------
    >>> html_table(["p", "order"], [[1, "0.99"]])
    p order
    1 0.99
    """
    heads, lines = list(header), [list(row) for row in rows]
    _check_cells(heads, lines)
    head = "".join(f'<th scope="col">{_html(cell)}</th>' for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{_html(c)}</td>" for c in r) + "</tr>" for r in lines)
    css = html.escape(f"esfem-table {kind}".strip())
    return Html(
        f'<div class="{css}"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>",
        "\n".join(" ".join(map(str, line)) for line in [heads, *lines]),
    )


def text_table(header: Sequence[str], rows: Iterable[Sequence[str]], least: int = 0) -> str:
    """Columns beside each other, set to the right, none narrower than `least` letters.

    Raises
    ------
    ValueError
        If a row has not one cell for each column.

    Examples
    --------
    >>> print(text_table(["p", "order"], [["1", "0.99"]]))
    p  order
    1   0.99
    """
    lines = [list(line) for line in (header, *rows)]
    _check_cells(lines[0], lines[1:])
    widths = [max(least, *map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in lines
    )


def _check_cells(heads: list[Any], rows: list[list[Any]]) -> None:
    for i, row in enumerate(rows):
        if len(row) != len(heads):
            raise ValueError(
                f"rows[{i}] must have {len(heads)} cells, as header has, got {len(row)}"
            )


def _html(cell: object) -> str:
    return cell.text if isinstance(cell, Html) else html.escape(str(cell), quote=False)

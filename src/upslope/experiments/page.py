"""HTML reports: one file with its pictures embedded."""

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path


def page(title: str, parts: Iterable[str], *, is_quick: bool) -> str:
    """A whole page.

    Args:
        title: plain text.
        parts: pieces of HTML.
        is_quick: whether the page says that these are results of the quick form.
    """
    quick = "<p class='quick'>This is the quick form: too small to say anything about the paper.</p>"
    body = "\n".join([quick, *parts] if is_quick else parts)
    return _PAGE.format(title=html.escape(title), body=body)


def bullets(sentences: Iterable[str]) -> str:
    """A list of plain sentences."""
    return "<ul>\n" + "\n".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences) + "\n</ul>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of plain cells; the first cell of each row is aligned left."""
    cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    body = "\n".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>\n{body}</table>"


def picture(path: Path, what: str) -> str:
    """An embedded PNG file; ``what`` is its alternative text."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{html.escape(what)}" src="data:image/png;base64,{data}">'


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
 body {{ font: 16px/1.5 Georgia, serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
 h1, h2 {{ font-weight: normal; }} h2 {{ margin-top: 2rem; }} img {{ width: 100%; }}
 table {{ border-collapse: collapse; font: 14px/1.4 sans-serif; }} .quick {{ color: #b2182b; font-weight: bold; }}
 th, td {{ padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }}
 th:first-child, td:first-child {{ text-align: left; }} footer {{ margin-top: 2rem; color: #777; font-size: 14px; }}
</style></head><body>
<h1>{title}</h1>
{body}
</body></html>
"""

"""Pages that the lab writes: one HTML file that needs nothing else, to look at, print and send.

Every text is escaped here; only what :func:`document` is given as its body is taken as HTML.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Final, Literal

from flora_common.outputs import beginning

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2420; background: #fff; max-width: 62rem; margin: 2rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
.lead { color: #55605a; margin: 0 0 1.5rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .8rem; margin: 1.2rem 0; }
.figures div { background: #f2f5f3; border-radius: .5rem; padding: .7rem .9rem; }
.figures b { display: block; font-size: 1.5rem; line-height: 1.2; } .figures span { color: #55605a; font-size: .85rem; }
img, svg { max-width: 100%; height: auto; display: block; }
figcaption { color: #55605a; font-size: .9rem; margin: .3rem 0 0; } figure { margin: 0; }
.figures.threes { grid-template-columns: repeat(3, 1fr); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; } td, th { padding: .25rem 1.2rem .25rem 0; text-align: left; vertical-align: top; }
th { font-weight: 500; color: #55605a; } td { overflow-wrap: anywhere; font-variant-numeric: tabular-nums; }
.wide td { overflow-wrap: normal; } .wide table { font-size: .9rem; } .wide td, .wide th { padding-right: .8rem; }
"""


_BEGINNING: Final = '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>'


def is_document(path: Path) -> bool:
    """Whether a file begins as the pages of :func:`document` do."""
    return beginning(path, len(_BEGINNING)) == _BEGINNING.encode()


def document(title: str, body: Sequence[str]) -> str:
    """The whole page.

    Args:
        title: text.
        body: pieces of HTML.
    """
    return (
        f"{_BEGINNING}{escape(title)}</title>"
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
        + "\n".join(body)
        + "</body></html>\n"
    )


def heading(title: str, lead: str) -> str:
    """The page's heading, and a sentence under it."""
    return f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>'


def section(title: str) -> str:
    """The heading of a section."""
    return f"<h2>{escape(title)}</h2>"


def paragraph(text: str) -> str:
    """A paragraph of text."""
    return f"<p>{escape(text)}</p>"


def tiles(figures: Sequence[tuple[str, str]], *, threes: bool = False) -> str:
    """Large figures with what they are: (figure, words); as many in a row as there is room for, or three."""
    inner = "".join(f"<div><b>{escape(a)}</b><span>{escape(b)}</span></div>" for a, b in figures)
    return f'<div class="figures{" threes" if threes else ""}">{inner}</div>'


def pairs(rows: Sequence[tuple[str, str]]) -> str:
    """A table of (name, value)."""
    return "<table>" + "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows) + "</table>"


def table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with a name over each column; one that is too wide for the page is moved under it."""
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    inner = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>{inner}</table></div>'


def spaced(piece: str) -> str:
    """A piece with room above and below it."""
    return f'<div style="margin:1.4rem 0">{piece}</div>'


def picture(data: bytes, kind: Literal["png", "jpeg", "gif"], *, alt: str, caption: str = "") -> str:
    """A picture inside the page.

    Args:
        data: bytes of the picture's file.
        kind: of that file.
        alt: what it shows, for those who do not see it.
        caption: how to read it.
    """
    encoded = base64.b64encode(data).decode()
    under = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img alt="{escape(alt)}" src="data:image/{kind};base64,{encoded}">\n{under}</figure>'

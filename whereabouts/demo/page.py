"""The demo's report as one HTML page beside its pictures."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #22303c; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.9rem; margin-bottom: .2rem; } h2 { margin-top: 2.4rem; } p.lead { color: #5b6b78; margin-top: 0; }
table { border-collapse: collapse; margin: .6rem 0 1.2rem; font-size: .93rem; }
th, td { text-align: left; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e3e8eb; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
img { max-width: 100%; } .met { color: #1b7f5a; } .missed { color: #c0392b; } small { color: #5b6b78; }
code { background: #f2f4f5; padding: 0 .25rem; border-radius: 3px; }
"""


@dataclass(frozen=True)
class Row:
    """A figure of the summary; met is None where nothing was asked for."""

    name: str
    value: str
    wanted: str = ""
    met: bool | None = None


@dataclass
class Page:
    """Collects the parts of a page in order."""

    title: str
    lead: str
    _parts: list[str] = field(default_factory=list)

    def heading(self, text: str) -> None:
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def picture(self, name: str, caption: str) -> None:
        """A picture of the page's folder."""
        said = html.escape(caption)
        self._parts.append(f'<p><img src="{html.escape(name)}" alt="{said}"><br><small>{said}</small></p>')

    def summary(self, rows: Iterable[Row]) -> None:
        """Figures with what was wanted of them."""
        lines = ["<table><tr><th></th><th>measured</th><th>wanted</th><th></th></tr>"]
        for row in rows:
            mark = "" if row.met is None else _mark(row.met)
            cells = "".join(f"<td>{html.escape(text)}</td>" for text in (row.name, row.value, row.wanted))
            lines.append(f"<tr>{cells}<td>{mark}</td></tr>")
        self._parts.append("\n".join([*lines, "</table>"]))

    def table(self, head: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = False) -> None:
        """A table; with `numbers` all but the first column stand right."""

        def line(cells: Sequence[str], tag: str) -> str:
            kind = ' class="number"' if numbers else ""
            done = [f"<{tag}{kind if k else ''}>{html.escape(cell)}</{tag}>" for k, cell in enumerate(cells)]
            return f"<tr>{''.join(done)}</tr>"

        body = [line(row, "td") for row in rows]
        self._parts.append("\n".join(["<table>", line(head, "th"), *body, "</table>"]))

    def write(self, path: Path) -> Path:
        """Write the page; returns its path."""
        title, lead = html.escape(self.title), html.escape(self.lead)
        text = (
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
            f'<style>{STYLE}</style></head>\n<body><h1>{title}</h1><p class="lead">{lead}</p>\n'
        )
        path.write_text(text + "\n".join(self._parts) + "\n</body></html>\n", encoding="utf-8")
        return path


def _mark(met: bool) -> str:
    return '<span class="met">✓ met</span>' if met else '<span class="missed">✗ missed</span>'

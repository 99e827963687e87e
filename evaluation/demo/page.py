"""The demo's report as one HTML page beside its pictures."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

from evaluation.demo.screen import Screen

_SCROLL = ('<div class="scroll">',)


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
    screen: Screen | None = None
    _parts: list[str] = field(default_factory=list)

    def files(self, given: Iterable[tuple[Path, str]]) -> None:
        """Links to files of the page's folder, those that are there, with what to do with each."""
        items = [
            f'<li><a href="{html.escape(path.name)}">{html.escape(path.name)}</a>: {_coded(said)}</li>'
            for path, said in given
            if path.exists()
        ]
        self._parts.append(f'<ul class="files">{"".join(items)}</ul>')

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
        self._parts.append("\n".join([*_SCROLL, *lines, "</table></div>"]))

    def table(self, head: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = False) -> None:
        """A table; with `numbers` all but the first column stand right."""

        def line(cells: Sequence[str], tag: str) -> str:
            kind = ' class="number"' if numbers else ""
            done = [f"<{tag}{kind if k else ''}>{html.escape(cell)}</{tag}>" for k, cell in enumerate(cells)]
            return f"<tr>{''.join(done)}</tr>"

        body = [line(row, "td") for row in rows]
        self._parts.append("\n".join([*_SCROLL, "<table>", line(head, "th"), *body, "</table></div>"]))

    def write(self, path: Path) -> Path:
        """Write the page; returns its path."""
        title, lead = html.escape(self.title), html.escape(self.lead)
        style = (files("evaluation.demo") / "style.html").read_text(encoding="utf-8")
        text = (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
            f"<title>{title}</title>{style}</head>\n"
            f'<body><h1>{title}</h1><p class="lead">{lead}</p>\n'
            f"{self.screen.html() if self.screen else ''}\n"
        )
        path.write_text(text + "\n".join(self._parts) + "\n</body></html>\n", encoding="utf-8")
        return path


def _coded(text: str) -> str:
    """Plain text in which what stands in backquotes is code."""
    pieces = text.split("`")
    return "".join(
        f"<code>{html.escape(p)}</code>" if k % 2 else html.escape(p) for k, p in enumerate(pieces)
    )


def _mark(met: bool) -> str:
    return '<span class="met">✓ met</span>' if met else '<span class="missed">✗ missed</span>'

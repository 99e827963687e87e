"""Writes every page that holds figures, and those about nodes and messages: `make docs`, `python -m evaluation.pages`.

A figure stands in a page between marks, and is written anew from `results/`:

    <!-- figure EXPERIMENT:KEY -->0.31 m<!-- end -->          `EXPERIMENT:KEY spread` with the spread
    <!-- results EXPERIMENT:TABLE -->...<!-- end -->          a whole table
    <!-- headlines -->...<!-- end -->                         the table of README.md
    <!-- rooms -->...<!-- end -->                             every folder of sources, by its docstring

A figure whose sources, models, recordings or pictures have changed since is marked.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

from estimation.errors import InputError
from evaluation import commands, documentation, markdown
from evaluation.datasets import data_directory
from evaluation.digest import PACKAGES, ROOT
from evaluation.headlines import HEADLINES
from evaluation.results import Result, read_all
from evaluation.running import experiments

BEFORE = "before the last change"
SPREAD = (
    "What draws at random is repeated over {seeds}: the mean, and in brackets the smallest and the largest. "
    "↓ and ↑ say which direction is better. “The text” is the thesis or paper that a part follows."
)
JUDGED = """\
The column "judged on" says what the data had to do with any choice:

* **left out**: it took part in no choice and in no training.
* **model left out**: what is trained was trained without it. Parameters set by hand were chosen with it in view.
* **tuned on**: it took part in training or in a choice, or somebody looked at it meanwhile.
* **simulated**: it was drawn at random, by rules that were known to those who tuned."""
OVERVIEW = """\
Each experiment writes a file, `results/NAME.json`, with every figure, its unit, its spread over the seeds, and whether
the data that judges it took part in any choice. These pages are written from those files.
`whereabouts experiment all --out results/` measures everything anew, `--resume` goes on after an interrupt, and
`whereabouts experiment compare OLD NEW` says which figures left their spread."""
# A mark goes on to its end, whatever stands between; one that begins in code is none.
MARK = re.compile(
    r"```.*?```|<!-- (figure|results|headlines|rooms)\b ?([^>]*?) ?-->.*?<!-- end -->|`[^`\n]*`", re.DOTALL
)


class Book:
    """Results, and which of them are from before the last change."""

    def __init__(self, results: Mapping[str, Result], data: Path | None = None) -> None:
        self.results = results
        self._data = data

    @cached_property
    def stale(self) -> frozenset[str]:
        """Experiments whose figures are marked."""
        return frozenset(name for name, result in self.results.items() if result.stale(self._data))

    def result(self, name: str) -> Result:
        """The results of an experiment."""
        if name not in self.results:
            raise InputError(
                f"there is no results/{name}.json: run `whereabouts experiment {name} --out results/`"
            )
        return self.results[name]

    def figure(self, reference: str, spread: bool = False) -> str:
        """What stands for `EXPERIMENT:KEY`; a hyphen where the figure is not there.

        `EXPERIMENT:KEY#printed` is the reference's figure beside it.
        """
        name, _, key = reference.partition(":")
        key, _, printed = key.partition("#")
        known = self.result(name).figures.get(key)
        if known is None:
            return markdown.ABSENT
        if printed:
            return markdown.with_unit({**known, "value": known["printed"]})
        text = markdown.with_unit(known, spread)
        return f"{text} ({BEFORE})" if name in self.stale else text

    def table(self, reference: str) -> str:
        """A table `EXPERIMENT:TABLE` with its note."""
        name, _, key = reference.partition(":")
        result = self.result(name)
        table = result.table(key)
        parts = [markdown.table(table, result.figures)]
        notes = [table["note"]] if table["note"] else []
        if name in self.stale:
            notes.append(f"Measured {BEFORE}.")
        return "\n\n".join([*parts, *(f"*{note}*" for note in notes)])

    def command(self, reference: str) -> str:
        """What measured `EXPERIMENT:KEY`, with `--quick` where the run was one."""
        command = str(self.result(reference.partition(":")[0]).content["command"])
        return command.removesuffix(" --out results/")

    def headlines(self) -> str:
        """The table of README.md."""
        rows = [
            [line.what, self.figure(line.ours, True), line.peer(self.figure), f"`{self.command(line.ours)}`"]
            for line in HEADLINES
        ]
        return markdown.pipes(["", "here (spread)", "beside it", "command"], rows)


def rooms(root: Path = ROOT) -> str:
    """A table of the folders that hold the product's sources, with the first sentence of each one's docstring."""
    rows = []
    for path in sorted(file for name in PACKAGES for file in (root / name).rglob("__init__.py")):
        told = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        folder = path.parent.relative_to(root).as_posix()
        rows.append([f"`{folder}/`", re.split(r"(?<=\.)\s", told)[0]])
    return markdown.pipes(["folder", "what is in it"], rows)


def filled(text: str, book: Book) -> str:
    """A page with every mark filled anew; what stands in code is left alone."""

    def fill(match: re.Match[str]) -> str:
        kind, reference = match[1], match[2]
        if kind is None:
            return match[0]
        if kind == "headlines":
            return f"<!-- headlines -->\n{book.headlines()}\n<!-- end -->"
        if kind == "rooms":
            return f"<!-- rooms -->\n\n{rooms()}\n\n<!-- end -->"
        if kind == "results":
            return f"<!-- results {reference} -->\n\n{book.table(reference)}\n\n<!-- end -->"
        key, _, how = reference.partition(" ")
        return f"<!-- figure {reference} -->{book.figure(key, how == 'spread')}<!-- end -->"

    return MARK.sub(fill, text)


def results_page(name: str, summary: str, book: Book) -> str:
    """Everything that one experiment has found."""
    result = book.result(name)
    content = result.content
    length = "Quick run, with fewer repetitions of the same protocol," if content["quick"] else "Whole run"
    spread = SPREAD.format(seeds="five seeds, long parts over fewer" if content["quick"] else "five seeds")
    parts = [
        "<!-- Written by `make docs` from the file of results. -->",
        f"# {name}",
        summary,
        f"```\n{content['command']}\n```",
        f"{length} of {content['finished']}; {content['seconds']:.0f} s on {content['processor']}. {spread}",
    ]
    if name in book.stale:
        parts.append(f"**These figures are from {BEFORE} of what they measure.**")
    for table in result.tables:
        parts += [f"## {table['title']}", markdown.table(table, result.figures)]
        parts += [table["note"]] if table["note"] else []
    if content["notes"]:
        parts.append("\n".join(["## Notes", "", *(f"* {note}" for note in content["notes"])]))
    parts += [f"![{Path(file).stem}](../../results/{file})" for file in content["pictures"]]
    return "\n\n".join(parts) + "\n"


def overview(summaries: Mapping[str, str], book: Book) -> str:
    """The page that lists all experiments."""
    rows = [
        [
            f"[{name}](results/{name}.md)", summary, "quick" if book.result(name).content["quick"] else "whole",
            str(len(book.result(name).figures)),
        ]
        for name, summary in summaries.items()
        if name in book.results
    ]  # fmt: skip
    missing = [name for name in summaries if name not in book.results]
    parts = [
        "<!-- Written by `make docs`. -->",
        "# Results",
        OVERVIEW,
        JUDGED,
        markdown.pipes(["experiment", "what it shows", "run", "figures"], rows),
    ]
    if missing:
        parts.append("Not measured yet: " + ", ".join(missing) + ".")
    return "\n\n".join(parts) + "\n"


def pages(root: Path = ROOT) -> dict[Path, str]:
    """All written files of a checkout and what they should hold."""
    book = Book(read_all(root / "results"), data_directory())
    summaries = {name: (module.__doc__ or "").splitlines()[0] for name, module in experiments().items()}
    written = dict(documentation.pages(root))
    written[root / "docs/commands.md"] = commands.page()
    written[root / "docs/results.md"] = overview(summaries, book)
    for name, summary in summaries.items():
        if name in book.results:
            written[root / "docs/results" / f"{name}.md"] = results_page(name, summary, book)
    for path in [root / "README.md", *sorted((root / "docs").glob("*.md"))]:
        if path not in written:
            written[path] = filled(path.read_text(encoding="utf-8"), book)
    return written


def main() -> None:
    """Write them all."""
    for path, text in pages().items():
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(f"written: {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()

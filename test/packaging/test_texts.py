"""docs/texts.md: every file and name in it exists, and every numbered equation of the texts stands in it."""

import importlib
import re

from evaluation.digest import ROOT

PAGE = (ROOT / "docs/texts.md").read_text(encoding="utf-8")
CODE = re.findall(r"`([^`\n]+)`", PAGE)
TABLES = {
    part.splitlines()[0].strip(): part for part in re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
}  # fmt: skip
# Chapter or paper: its section here, the prefix of its numbers, and how many there are.
NUMBERED = {
    "LC, background": [("2.", 17), ("3.", 25), ("4.", 13), ("5.", 13)],
    "LC, Paper A: loop closure": [("", 47)],
    "LC, Paper B: extended targets": [("", 18)],
    "CRF": [("", 6)],
    "WM, chapter 2: anchoring": [("2.", 11)],
    "WM, chapter 3: maintenance": [("3.", 14)],
    "WM, chapter 4: where people go": [("4.", 18)],
    "WM, chapter 5: search": [("5.", 5)],
    "WM, chapter 6: converted measurements": [("6.", 21)],
}


def numbers(cell: str, prefix: str) -> set[int]:
    """Numbers of equations named in the first cell of a row: (4.1), (4.2) to (4.5)."""
    one = rf"\({re.escape(prefix)}(\d+)\)"
    found = {int(n) for n in re.findall(one, cell)}
    for low, high in re.findall(rf"{one} to {one}", cell):
        found |= set(range(int(low), int(high) + 1))
    return found


def test_every_equation_stands_in_a_row_with_a_file_that_exists():
    for section, chapters in NUMBERED.items():
        rows = [
            line.split("|")[1:-1]
            for line in TABLES[section].splitlines()
            if re.match(r"\| (\(|section|Algorithm)", line)
        ]
        for prefix, count in chapters:
            named = set().union(*(numbers(row[0], prefix) for row in rows))
            assert named == set(range(1, count + 1)), f"{section} {prefix}"
        for row in rows:
            files = re.findall(r"`([^`]+\.py)`", row[2])
            assert files, row
            assert all((ROOT / file).is_file() for file in files), row


def test_files_and_folders_are_there():
    folder = ""
    for text in CODE:
        if text.endswith((".py", ".md")):
            assert (ROOT / text).exists(), text
        elif text.startswith("results/"):
            folder = text.rpartition("/")[0]
            # What an experiment draws is there once it was run; its folder always is.
            assert (ROOT / folder).is_dir(), text


def test_names_exist():
    for module, names in {
        "tracking": ("PhdConfig",),
        "loop_closure": ("AdaBoost", "Slam", "pair_features"),
        "loop_closure.graph.esdf": ("EsdfGraph",),
        "registration": ("align", "align_globally"),
        "evaluation.maintenance.maintenance_printed": ("PrintedRule",),
        "evaluation.conversion.switching_printed": ("PrintedSwitchingFilter",),
    }.items():
        for name in names:
            assert re.search(rf"`[^`]*\b{name}\b[^`]*`", PAGE), name
            assert hasattr(importlib.import_module(module), name), name


def test_the_page_says_when_a_file_says_which_equation():
    """A file named for one numbered equation of the world-model thesis names a number of that chapter itself."""
    for chapter in (3, 4, 6):
        title = next(name for name in TABLES if name.startswith(f"WM, chapter {chapter}"))
        files = set(re.findall(r"`([^`]+_printed\.py)`", TABLES[title]))
        assert files
        for file in files:
            assert re.search(rf"\({chapter}\.\d+\)", (ROOT / file).read_text(encoding="utf-8")), file

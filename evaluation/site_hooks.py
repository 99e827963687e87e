"""Hooks of MkDocs: what pages need from outside of docs/ becomes part of the site (`make site`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evaluation.digest import ROOT

PICTURES = "figures"
DIAGRAMS = "assets/mermaid.min.js"


def on_files(files: Any, config: Any) -> Any:
    """Add CONTRIBUTING.md, the pictures of results/, and Mermaid."""
    from mkdocs.structure.files import File

    outside = {"contributing.md": ROOT / "CONTRIBUTING.md"}
    for path in sorted((ROOT / "results").rglob("*.png")):
        outside[f"{PICTURES}/{path.relative_to(ROOT / 'results')}"] = path
    if mermaid := _mermaid():
        outside[DIAGRAMS] = mermaid
    for name, path in outside.items():
        files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links as they are in the site; the sources have them as they are in the repository."""
    if page.file.src_uri == "contributing.md":
        return markdown.replace("](docs/", "](")
    return markdown.replace("](../CONTRIBUTING.md", "](contributing.md").replace(
        "](../../results/", f"](../{PICTURES}/"
    )


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Pages with diagrams load the site's own copy of Mermaid, if there is one; the theme then takes no other."""
    if 'class="mermaid"' not in output or not _mermaid():
        return output
    source = "../" * page.file.url.count("/") + DIAGRAMS
    script = f'<script src="{source}"></script><script>mermaid.initialize({{startOnLoad: false}})</script>'
    return output.replace("</head>", f"{script}</head>")


def _mermaid() -> Path | None:
    """The library that draws diagrams, if `make site` has fetched it."""
    return max((ROOT / ".venv").glob("mermaid-*/mermaid.min.js"), default=None)

"""Hooks of MkDocs: what pages link to outside of docs/ becomes part of the site (`make site`)."""

from __future__ import annotations

from typing import Any

from evaluation.digest import ROOT

PICTURES = "figures"


def on_files(files: Any, config: Any) -> Any:
    """Add CONTRIBUTING.md and the pictures of results/."""
    from mkdocs.structure.files import File

    outside = {"contributing.md": ROOT / "CONTRIBUTING.md"}
    for path in sorted((ROOT / "results").rglob("*.png")):
        outside[f"{PICTURES}/{path.relative_to(ROOT / 'results')}"] = path
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

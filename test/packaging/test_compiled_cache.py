"""What is compiled anew after an edit: what depends on it, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from whereabouts.compiled_cache import dependents, digests, forget_stale, is_compiled, keep_note

SOURCES = {
    "estimation/__init__.py": "",
    "estimation/kernel.py": "VALUE = 1\n",
    "estimation/other.py": "",
    "registration/__init__.py": "from registration.user import compute\n",
    "registration/user.py": "from estimation import kernel\n",
    "loop_closure/__init__.py": "",
    "loop_closure/far.py": "def late():\n    from registration import compute\n",
    "tracking/__init__.py": "",
    "tracking/apart.py": "import estimation.other\n",
    "world_model/__init__.py": "",
}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        cache = path.parent / "__pycache__"
        cache.mkdir(exist_ok=True)
        for end in ("f-1.py311.nbi", "f-1.py311.1.nbc", "cpython-311.pyc"):
            (cache / f"{path.stem}.{end}").touch()
    return tmp_path


def compiled(root: Path) -> set[str]:
    return {
        f"{path.parent.parent.name}/{path.name.partition('.')[0]}.py"
        for path in root.rglob("__pycache__/*.nbi")
    }


def test_without_a_note_everything_is_forgotten_but_what_python_itself_checks(tree: Path) -> None:
    assert forget_stale(tree) == len(SOURCES)
    assert compiled(tree) == set()
    assert list(tree.rglob("*.nbc")) == []
    assert len(list(tree.rglob("*.pyc"))) == len(SOURCES)


def test_nothing_is_forgotten_where_nothing_changed(tree: Path) -> None:
    assert not is_compiled(tree)
    keep_note(tree)
    assert is_compiled(tree)
    assert forget_stale(tree) == 0
    assert compiled(tree) == set(SOURCES)


def test_an_edit_reaches_all_that_import_it_through_packages_and_functions(tree: Path) -> None:
    keep_note(tree)
    (tree / "estimation/kernel.py").write_text("VALUE = 2\n", encoding="utf-8")
    forget_stale(tree)
    gone = {"estimation/kernel.py", "registration/user.py", "registration/__init__.py", "loop_closure/far.py"}
    assert compiled(tree) == set(SOURCES) - gone


def test_a_file_that_is_gone_takes_its_importers_with_it(tree: Path) -> None:
    keep_note(tree)
    (tree / "estimation/other.py").unlink()
    forget_stale(tree)
    assert compiled(tree) == set(SOURCES) - {"estimation/other.py", "tracking/apart.py"}


def test_a_damaged_note_is_no_note(tree: Path) -> None:
    keep_note(tree)
    (tree / "estimation/__pycache__/compiled-from.json").write_text("{", encoding="utf-8")
    assert forget_stale(tree) == len(SOURCES)


def test_imports_of_the_real_tree_are_found_as_python_finds_them() -> None:
    """Against Python itself: what is loaded with a module is what it depends on."""
    import estimation.learning.gradient_boosting

    root, name = Path(__file__).resolve().parents[2], estimation.learning.gradient_boosting.__name__
    script = f"import sys, {name}; print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('estimation.')))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=root
    )
    loaded = {Path(file).relative_to(root).as_posix() for file in done.stdout.split()}
    own = Path(estimation.learning.gradient_boosting.__file__).relative_to(root).as_posix()
    # All of one package: to read the whole tree for each file would take long.
    files = [file for file in digests(root) if file.startswith("estimation/")]
    kernels = [file for file in loaded if not file.endswith("__init__.py")]
    assert len(kernels) > 3
    assert [file for file in kernels if own not in dependents(root, files, [file])] == []

"""Figures are files: what is written, when it is marked, what a comparison says."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from typer.testing import CliRunner

import evaluation.experiments
from estimation.errors import InputError
from evaluation import digest, markdown, results, running
from evaluation.compare import compare
from evaluation.headlines import HEADLINES, Headline
from evaluation.pages import BEFORE, Book, filled, results_page
from evaluation.report import SEEDS, Figure, Part, Printed, Report, RunOptions, Table, slug
from whereabouts.cli.main import app


def tables(options: RunOptions, report: Report) -> None:
    rng = np.random.default_rng([options.seed, 7])
    rows = [["ours", rng.normal(0.3, 0.01), 12.0, 0.4], ["theirs", rng.normal(0.6, 0.01), 24.0, None]]
    columns = ["method", "error, m ↓", "right, % ↑", "text: error"]
    report.tables.append(
        Table(
            "Errors of two methods",
            columns,
            rows,
            "Over 20 m.",
            "errors",
            {"text: error": "Table II"},
            "left out",
            50,
        )
    )
    picture = options.out / "errors.png"
    picture.write_bytes(b"drawn with seed %d" % options.seed)
    report.pictures.append(picture)


def fixed(_: RunOptions, report: Report) -> None:
    report.figures["speed"] = Figure(20.0, "1/s", "higher")


@pytest.fixture
def experiment(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """An experiment of two parts that stands beside the real ones."""
    module = ModuleType("evaluation.experiments.sample")
    module.PARTS = {"errors": Part(tables), "speed": Part(fixed, random=False)}  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(evaluation.experiments, "sample", module, raising=False)
    monkeypatch.setattr(running, "experiments", lambda: {"sample": module})
    return module


@pytest.fixture
def run(experiment: ModuleType, tmp_path: Path) -> Callable[..., results.Result]:
    def call(**options: object) -> results.Result:
        return running.run(replace(running.Run("sample", tmp_path), **options))  # type: ignore[arg-type]

    return call


def test_every_number_is_a_figure_with_its_unit_spread_and_reference(
    run: Callable[..., results.Result],
) -> None:
    result = run()
    figure = result.figures["errors/ours/error-m"]
    drawn = [float(np.random.default_rng([seed, 7]).normal(0.3, 0.01)) for seed in range(SEEDS)]
    assert figure["values"] == pytest.approx(drawn, rel=1e-5)
    assert figure["value"] == pytest.approx(np.mean(drawn), rel=1e-5)
    assert (figure["low"], figure["high"]) == pytest.approx((min(drawn), max(drawn)), rel=1e-5)
    assert (figure["unit"], figure["better"], figure["data"], figure["samples"]) == (
        "m",
        "lower",
        "left out",
        50,
    )
    assert (figure["printed"], figure["where"]) == (0.4, "Table II")
    assert "printed" not in result.figures["errors/theirs/error-m"]
    assert result.figures["speed"] == {"value": 20, "unit": "1/s", "better": "higher"}
    assert result.table("errors")["rows"][0][3] == {"printed": 0.4, "where": "Table II"}
    for name in ("commit", "versions", "processor", "seconds", "seeds", "command"):
        assert name in result.content
    with pytest.raises(InputError, match="no table is called nothing; there are: errors"):
        result.table("nothing")


def test_same_seed_same_figures(run: Callable[..., results.Result]) -> None:
    assert run().figures == run().figures
    assert run(seed=3).figures != run().figures


def test_pictures_are_of_the_first_seed(run: Callable[..., results.Result], tmp_path: Path) -> None:
    result = run()
    assert list(result.content["pictures"]) == ["sample/errors.png"]
    assert (tmp_path / "sample/errors.png").read_bytes() == b"drawn with seed 0"


def test_an_interrupted_run_goes_on_where_it_was(
    run: Callable[..., results.Result], experiment: ModuleType, tmp_path: Path
) -> None:
    calls: list[int] = []

    def counted(options: RunOptions, report: Report) -> None:
        calls.append(options.seed)
        if len(calls) == 4:
            raise KeyboardInterrupt
        tables(options, report)

    experiment.PARTS["errors"] = Part(counted)  # type: ignore[attr-defined]
    with pytest.raises(KeyboardInterrupt):
        run()
    assert not (tmp_path / "sample.json").exists()
    result = run(resume=True)
    assert calls == [0, 1, 2, 3, 3, 4]
    assert len(result.figures["errors/ours/error-m"]["values"]) == SEEDS
    assert not (tmp_path / running.UNFINISHED).exists()
    run(resume=False)
    assert calls[6:] == [0, 1, 2, 3, 4]


def test_several_workers_begin_with_the_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what a run of the same length took, in the output or as committed; first what nothing is known of."""
    out, committed = tmp_path / "out", tmp_path / "committed"
    known = (out, "a", True, 20.0), (committed, "a", True, 900.0), (committed, "b", True, 70.0)
    for folder, name, quick, seconds in (*known, (out, "c", False, 5.0), (committed, "d", False, 600.0)):
        folder.mkdir(exist_ok=True)
        content = {"schema": results.SCHEMA, "experiment": name, "quick": quick, "seconds": seconds}
        empty = {"figures": {}, "tables": [], "pictures": {}, "digest": "", "recordings": {}}
        (folder / f"{name}.json").write_text(json.dumps(content | empty))
    (out / "d.json").write_text("cut off")
    monkeypatch.setattr(results, "FOLDER", committed)

    class InProcessPool(ThreadPoolExecutor):
        def __init__(self, workers: int, mp_context: object, initializer: object) -> None:
            super().__init__(1)

    begun: list[str] = []
    monkeypatch.setattr(running, "ProcessPoolExecutor", InProcessPool)
    monkeypatch.setattr(running, "run", lambda asked: begun.append(asked.name))
    asked = [running.Run(name, out, quick=True) for name in "abcd"]
    assert len(list(running.run_each(asked, 2))) == 4
    assert begun == ["c", "d", "b", "a"]
    begun.clear()
    list(running.run_each([replace(each, quick=False) for each in asked], 2))
    assert begun == ["a", "b", "d", "c"]


def test_absent_recordings_are_said(
    experiment: ModuleType, run: Callable[..., results.Result], tmp_path: Path
) -> None:
    experiment.PARTS["errors"] = Part(tables, needs=("carmen/*.bz2",))  # type: ignore[attr-defined]
    result = run()
    assert "errors/ours/error-m" not in result.figures
    assert result.content["notes"] == ["left out, for want of recordings: carmen/*.bz2"]


def test_rows_of_one_name_and_units_keep_figures_apart() -> None:
    columns = ["", "time, ms", "time, s"]
    report = Report("x", [Table("T", columns, [["a", 1.0, 2.0], ["a", 3.0, 4.0]], name="t")])
    assert {key: figure.value for key, figure in report.every_figure().items()} == {
        "t/a/time-ms": 1.0, "t/a/time-s": 2.0, "t/a-2/time-ms": 3.0, "t/a-2/time-s": 4.0,
    }  # fmt: skip
    report.tables[0].rows.append(["short", 1.0])
    with pytest.raises(ValueError, match="'short' has 2 cells, 3 expected"):
        report.every_figure()


def test_rows_may_be_quantities() -> None:
    table = Table(
        "T", ["", "wanted", "ours"], [["kept, % ↑", 95, 99.0]], name="t", printed={"wanted": "issue"}
    )
    figure = Report("x", [table]).every_figure()["t/kept/ours"]
    assert figure == Figure(99.0, "%", "higher", printed=Printed(95, "issue"))


# Digests.


def tree(root: Path) -> Path:
    """A small project: `world_model` takes `walk` from one module and `other` from another."""
    files = {
        "evaluation/__init__.py": "",
        "evaluation/experiments/__init__.py": "",
        "evaluation/experiments/tried.py": "from world_model import walk\n\ndef part():\n    return walk()\n",
        "world_model/__init__.py": "from world_model.steps import walk\nfrom world_model.aside import other\n",
        "world_model/steps.py": '"""Steps."""\n\nLENGTH = 0.7  # m\n\ndef walk():\n'
        '    """Walks."""\n    return LENGTH\n',
        "world_model/aside.py": "def other():\n    return 1\n",
        "world_model/models/steps.json": "[1]",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


@pytest.mark.parametrize(
    ("file", "old", "new", "counts"),
    [
        ("world_model/steps.py", "0.7", "0.8", True),
        ("world_model/steps.py", "# m", "# metres", False),
        ("world_model/steps.py", '"""Walks."""', '"""Walks on."""', False),
        ("world_model/steps.py", "\n\ndef", "\n\n\n\ndef", False),
        ("world_model/aside.py", "1", "2", False),
        ("world_model/models/steps.json", "1", "2", True),
        ("evaluation/experiments/tried.py", "walk()\n", "walk() + 1\n", True),
    ],
)
def test_digest_changes_with_what_a_figure_is_made_of(
    tmp_path: Path, file: str, old: str, new: str, counts: bool
) -> None:
    root, module = tree(tmp_path), "evaluation.experiments.tried"
    before = digest.source_digest(module, root)
    text = (root / file).read_text()
    assert old in text
    (root / file).write_text(text.replace(old, new))
    assert (digest.source_digest(module, root) != before) == counts


def test_sources_follow_the_imports() -> None:
    """What an experiment is made of, and nothing of packages that it does not use."""
    listed = {
        path.relative_to(digest.ROOT).as_posix()
        for path in digest.sources("evaluation.experiments.registration")
    }
    assert {
        "registration/placement/align.py",
        "registration/placement/refine.py",
        "evaluation/experiments/registration.py",
    } <= listed
    assert not any(name.startswith(("tracking/", "world_model/")) for name in listed)
    assert "evaluation/report.py" not in listed


# Pages.


def test_pages_follow_the_files(run: Callable[..., results.Result], monkeypatch: pytest.MonkeyPatch) -> None:
    result = run()
    monkeypatch.setattr(results, "source_digest", lambda module: result.content["digest"])
    book = Book({"sample": result})
    page = (
        "It is <!-- figure sample:speed -->?<!-- end --> fast, `<!-- figure sample:speed -->?<!-- end -->` in code.\n"
        "<!-- results sample:errors -->\nold\n<!-- end -->\n"
    )
    text = filled(page, book)
    assert "It is <!-- figure sample:speed -->20 1/s<!-- end --> fast, `<!-- figure sample:speed -->?" in text
    assert "| method | error, m ↓ | right, % ↑ | text: error |" in text
    assert filled(text, book) == text
    error = markdown.with_spread(result.figures["errors/ours/error-m"])
    assert " to " in error
    assert f"| ours | {error} | 12 | 0.4 |" in text
    # A figure that is deleted is gone from the page.
    content = json.loads(json.dumps(result.content))
    del content["figures"]["errors/ours/error-m"], content["figures"]["speed"]
    without = filled(page, Book({"sample": results.Result(result.path, content)}))
    assert error not in without
    assert "It is <!-- figure sample:speed -->-<!-- end --> fast" in without
    with pytest.raises(InputError, match="whereabouts experiment other --out"):
        filled("<!-- figure other:speed --><!-- end -->", book)


def test_figures_of_changed_sources_are_marked(
    run: Callable[..., results.Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    result = run()
    monkeypatch.setattr(results, "source_digest", lambda module: result.content["digest"])
    assert not result.stale()
    assert BEFORE not in results_page("sample", "Tries.", Book({"sample": result}))
    (tmp_path / "sample/errors.png").write_bytes(b"drawn anew")
    assert result.stale() == ["sample/errors.png"]
    monkeypatch.setattr(results, "source_digest", lambda module: "another")
    assert result.stale() == ["sources", "sample/errors.png"]
    book = Book({"sample": result})
    assert book.figure("sample:speed") == f"20 1/s ({BEFORE})"
    assert BEFORE in book.table("sample:errors")
    assert BEFORE in results_page("sample", "Tries.", book)


def test_headlines_stand_beside_a_peers_figure(
    run: Callable[..., results.Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run()
    monkeypatch.setattr(results, "source_digest", lambda module: result.content["digest"])
    ours, theirs_key = "sample:errors/ours/error-m", "sample:errors/theirs/error-m"
    line = Headline("Error", ours, "theirs, right {sample:errors/theirs/right-percent}", theirs_key)
    monkeypatch.setattr("evaluation.pages.HEADLINES", (line,))
    text = filled("<!-- headlines --><!-- end -->", Book({"sample": result}))
    # What was written before goes, though it holds code.
    assert filled(text.replace("Error", "Old"), Book({"sample": result})) == text
    theirs = markdown.with_unit(result.figures["errors/theirs/error-m"])
    assert f"{theirs} (theirs, right 24%) | `whereabouts experiment sample` |" in text
    assert Book({"sample": result}).figure(f"{ours}#printed") == "0.4 m"


def test_files_that_are_no_results_are_refused(tmp_path: Path) -> None:
    for content in ("", "{}", "[]", '{"schema": 99}', "\x00\xff"):
        path = tmp_path / "broken.json"
        path.write_text(content)
        with pytest.raises(InputError, match=r"broken\.json"):
            results.read(path)


# Comparing.


def changed(result: results.Result, key: str, **values: object) -> dict[str, results.Result]:
    content = json.loads(json.dumps(result.content))
    content["figures"][key] |= values
    return {"sample": results.Result(result.path, content)}


def test_compare_tells_what_left_its_spread(run: Callable[..., results.Result]) -> None:
    result = run()
    old = {"sample": result}
    key = "errors/ours/error-m"
    values = result.figures[key]["values"]
    assert compare(old, old) == []
    for shift, verdict in ((1e-4, None), (0.1, "worse"), (-0.1, "better")):
        moved = [value + shift for value in values]
        new = changed(result, key, values=moved, value=sum(moved) / len(moved))
        assert [change.verdict for change in compare(old, new)] == ([verdict] if verdict else [])
    (change,) = compare(old, changed(result, "speed", value=15.0))
    assert (change.verdict, change.old, change.new, change.unit) == ("worse", 20, 15.0, "1/s")
    (change,) = compare(old, changed(result, "errors/ours/right-percent", value=None))
    assert change.verdict == "gone"


def test_compare_as_it_is_typed(run: Callable[..., results.Result], tmp_path: Path) -> None:
    """Exit status 1 where a figure is worse, and only there."""
    result = run(out=tmp_path / "old")
    for name, value, status, said in (
        ("same", 20.0, 0, "0 worse, 0 better"),
        ("worse", 15.0, 1, "1 worse, 0 better"),
        ("better", 25.0, 0, "0 worse, 1 better"),
    ):
        content = changed(result, "speed", value=value)["sample"].content
        path = tmp_path / name / "sample.json"
        path.parent.mkdir()
        path.write_text(json.dumps(content))
        answer = CliRunner().invoke(app, ["experiment", "compare", str(tmp_path / "old"), str(path.parent)])
        assert answer.exit_code == status
        assert said in answer.output


@pytest.mark.usefixtures("experiment")
def test_all_with_resume_leaves_out_what_is_done(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def typed(*more: str) -> str:
        command = ["experiment", "all", "--jobs", "1", "--out", str(tmp_path), *more]
        return CliRunner().invoke(app, command).output

    done = "sample: done before"
    first = typed("--quick", "--resume")
    assert done not in first
    assert "sample: 1 of 1, 0 s" in first
    assert done in typed("--quick", "--resume")
    assert done not in typed("--quick")
    assert done not in typed("--resume")
    for module in (results, running):
        monkeypatch.setattr(module, "source_digest", lambda _: "of other sources")
    assert done not in typed("--resume")


def test_headlines_refer_to_figures_that_exist() -> None:
    known = results.read_all()
    for line in HEADLINES:
        for reference in (line.ours, line.theirs, *re.findall(r"\{(.*?)\}", line.beside)):
            name, _, key = reference.partition(":")
            key, _, printed = key.partition("#")
            assert key in known[name].figures, reference
            assert not printed or "printed" in known[name].figures[key]


def test_pictures_are_those_that_the_experiments_drew() -> None:
    for name, result in results.read_all().items():
        assert set(result.stale()) <= {"sources"}, f"results/{name}: run the experiment again"


def test_keys_keep_greek_units() -> None:
    assert slug("step, µs") == slug("step, μs") == "step-us"

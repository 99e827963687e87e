"""Which files a service may name: those in the state directory, and below the folders that the operator allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimation.errors import InputError
from whereabouts.system.state_files import StateFiles, default_state_dir, keep_foreign


def test_a_name_is_a_file_in_the_state_directory(tmp_path: Path) -> None:
    files = StateFiles(str(tmp_path / "state"))
    assert files.named("home.npz") == tmp_path / "state" / "home.npz"
    assert not (tmp_path / "state").exists()
    assert files.named("maps/home.npz", making=True) == tmp_path / "state" / "maps" / "home.npz"
    assert (tmp_path / "state").is_dir()


def test_what_a_parameter_names_is_trusted() -> None:
    files = StateFiles()
    assert files.named("", "/srv/world.sqlite") == Path("/srv/world.sqlite")
    assert files.named("/srv/world.sqlite", "/srv/world.sqlite") == Path("/srv/world.sqlite")
    with pytest.raises(InputError, match="neither the request nor a parameter"):
        files.named("")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("../x", "is outside"),
        ("a/../../x", "is outside"),
        (".", "is outside"),
        ("link/x", "is outside"),
        ("/etc/passwd", "allowed_folders"),
        ("{allowed}/../x", "allowed_folders"),
        ("{allowed}/link/x", "allowed_folders"),
        ("{allowed}", "allowed_folders"),
        ("x\n", "control characters"),
        ("x\0", "control characters"),
        ("x" * 300, "255"),
    ],
)
def test_nothing_else_may_be_named(tmp_path: Path, name: str, reason: str) -> None:
    state, allowed = tmp_path / "state", tmp_path / "allowed"
    for folder in (state, allowed):
        folder.mkdir()
        (folder / "link").symlink_to("/etc")
    files = StateFiles(str(state), [str(allowed)])
    assert files.named(f"{allowed}/y") == allowed / "y"
    with pytest.raises(InputError, match=reason):
        files.named(name.format(allowed=allowed))


def test_the_default_follows_the_xdg_rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    assert default_state_dir() == tmp_path / ".local" / "state" / "whereabouts"
    monkeypatch.setenv("XDG_STATE_HOME", "/var/state")
    assert default_state_dir() == Path("/var/state/whereabouts")
    monkeypatch.setenv("XDG_STATE_HOME", "not/absolute")
    assert default_state_dir() == tmp_path / ".local" / "state" / "whereabouts"


def test_what_is_foreign_is_kept(tmp_path: Path) -> None:
    mine, other, link = tmp_path / "mine", tmp_path / "other", tmp_path / "link"
    mine.write_text("mine")
    other.write_text("other")
    link.symlink_to(mine)

    def is_mine(path: Path) -> bool:
        return path.read_text() == "mine"

    keep_foreign(mine, is_mine, "mine")
    keep_foreign(tmp_path / "none", is_mine, "mine")
    for path in (other, link, tmp_path):
        with pytest.raises(InputError, match="not overwritten"):
            keep_foreign(path, is_mine, "mine")

"""The ten figures of README.md: what was measured, a peer's figure beside it, and the command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Headline:
    """One line.

    what : in words. ours : `EXPERIMENT:KEY`. beside : whose figure stands beside it; theirs : `EXPERIMENT:KEY` where it
        was measured in the same run, else the figure as it was published.
    """

    what: str
    ours: str
    beside: str
    theirs: str

    @property
    def command(self) -> str:
        """What measures it."""
        return f"whereabouts experiment {self.ours.partition(':')[0]}"

    def peer(self, figure: Callable[..., str]) -> str:
        """The figure beside ours, with its name."""
        text = figure(self.theirs) if ":" in self.theirs else self.theirs
        return f"{text} ({self.beside})" if self.beside else text


HEADLINES: tuple[Headline, ...] = ()

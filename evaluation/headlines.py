"""The ten figures of README.md: what was measured, a peer's figure beside it, and the command."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Headline:
    """One line.

    what : in words. ours : `EXPERIMENT:KEY`. theirs : the figure beside it, likewise; `EXPERIMENT:KEY#printed` for the
    one that the reference prints. beside : whose it is, in words that may hold `{EXPERIMENT:KEY}`.
    """

    what: str
    ours: str
    beside: str
    theirs: str

    def peer(self, figure: Callable[..., str]) -> str:
        """The figure beside ours, with its name."""
        words = re.sub(r"\{(.*?)\}", lambda match: figure(match[1]), self.beside)
        return f"{figure(self.theirs)} ({words})"


HEADLINES: tuple[Headline, ...] = (
    Headline(
        "Odometry with wheels that stall and jump, in the offices of csail: error of the path",
        "odometry:logs/mit-csail.clf.bz2-ours-wheels/ate-m",
        "plain point-to-line matcher",
        "odometry:logs/mit-csail.clf.bz2-point-to-line-wheels/ate-m",
    ),
    Headline(
        "The same building: revisits that are closed",
        "slam:logs/mit-csail.clf.bz2-smoothed/revisits-closed-percent",
        "proximity search with small_gicp. Over 0.5 m or 10° off the reference: "
        "{slam:logs/mit-csail.clf.bz2-smoothed/false-closures} of "
        "{slam:logs/mit-csail.clf.bz2-smoothed/closures} closures here, "
        "{slam:logs/mit-csail.clf.bz2-proximity-search-small-gicp-gtsam/false-closures} of "
        "{slam:logs/mit-csail.clf.bz2-proximity-search-small-gicp-gtsam/closures} there",
        "slam:logs/mit-csail.clf.bz2-proximity-search-small-gicp-gtsam/revisits-closed-percent",
    ),
    Headline(
        "The same building: places within 1 m recognised at 1 % false alarms",
        "loops:unseen/best-2d-1-m/d-at-1-percent-fa-percent",
        "the reference's method",
        "loops:unseen/plain-2d-1-m/d-at-1-percent-fa-percent",
    ),
    Headline(
        "Two scans up to 0.6 m and 35° apart, registered without a guess",
        "registration:pairs-361-beams-360deg/robust/hard-success-percent",
        "small_gicp",
        "registration:pairs-361-beams-360deg/small-gicp-extruded/hard-success-percent",
    ),
    Headline(
        "Moving beams in a crowd, half-circle scanner: F1",
        "crf:moving/crowd-361-beams-180deg/f1",
        "free-space violation alone",
        "crf:moving/crowd-361-beams-180deg/f1-of-free-space-violation",
    ),
    Headline(
        "A person followed outdoors by a moving robot",
        "people:following/tracked-of-the-labelled-scans/ours",
        "published for the recording",
        "people:following/tracked-of-the-labelled-scans/ours#printed",
    ),
    Headline(
        "Crossing targets of many returns: OSPA, 60 m at most",
        "peers:targets/cross-spawn-stone-soup/ours-ospa-m",
        "Stone Soup",
        "peers:targets/cross-spawn-stone-soup/peer-ospa-m",
    ),
    Headline(
        "Objects in the world model, in a scene of 100 with 20 in view at a time",
        "anchoring:scenes/100-objects-20-in-view/objects-at-the-end",
        "WIRE",
        "anchoring:scenes/100-objects-20-in-view/objects-at-the-end#printed",
    ),
    Headline(
        "Distance driven to keep ten objects verified (threshold 9 nat), relative to a fixed path",
        "maintenance:thresholds/9/distance-of-the-fixed-path-s-times",
        "the reference; entropy is below the fixed path's in both",
        "maintenance:thresholds/9/distance-of-the-fixed-path-s-times#printed",
    ),
    Headline(
        "A round of 200 clouds outdoors, loop closed: error of the path",
        "peers:round/clouds-to-map-kiss-slam/ours-ate-m",
        "KISS-SLAM, whose long local maps close no loop here",
        "peers:round/clouds-to-map-kiss-slam/peer-ate-m",
    ),
)

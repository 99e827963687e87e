# ruff: noqa: E501  (sentences of pages)
"""Writes what the documentation says about parameters and interfaces: `python -m whereabouts.documentation`, `make docs`.

The tables of README.md, a page for each node in docs/nodes/, docs/interfaces.md with every message, service and action, and
docs/results.md with every experiment.
"""

from __future__ import annotations

import re
from pathlib import Path

from whereabouts.cli.experiment import experiments
from whereabouts.interfaces import COMMON, NODE_INTERFACES, interfaces_of, markdown_table
from whereabouts.node_names import NODES
from whereabouts.parameters.description import markdown_table as parameter_table
from whereabouts.parameters.readme import model_of, with_tables

SUMMARIES = {
    "scan_registration": "Follows the robot by planar scans or clouds: odometry with covariance, tf, points of the static world, and which beams of a scan move.",
    "loop_closure": "Recognises places, closes loops, keeps a consistent map, and localises in a saved one.",
    "target_tracker": "Finds people in planar scans, counts and follows them through crossings and while hidden.",
    "motion_predictor": "Learns where people go, and predicts the paths of those who are there.",
    "world_model": "Which objects exist and where they are, over many hypotheses; remembers, and answers questions.",
    "verifier": "Looks into a region, in scans or clouds, and says whether the object is there.",
    "world_maintenance": "Decides which object to look at again, sends the robot there and has it verified.",
    "object_search": "Finds an object over what is usually found together with it.",
}  # fmt: skip
READING = {
    "scan_registration": [("what moves between scans", "crf.md")],
    "loop_closure": [("closing loops", "loop_closure.md"), ("the shipped models", "loop_closure_models.md")],
    "target_tracker": [("people in planar scans", "people.md")],
    "motion_predictor": [("motion prediction", "motion_prediction.md")],
    "world_model": [("the world model", "world_model.md"), ("the node, its store and its questions", "world_model_node.md")],
    "verifier": [("maintenance and search", "maintenance_and_search.md")],
    "world_maintenance": [("maintenance and search", "maintenance_and_search.md")],
    "object_search": [("maintenance and search", "maintenance_and_search.md")],
}  # fmt: skip

RESULTS_READING = {
    "anchoring": [("the world model", "world_model.md#measured")],
    "conversion": [("`bench/bench_estimation.txt`", "../bench/bench_estimation.txt")],
    "crf": [("how it works and its limits", "crf.md")],
    "intentions": [("motion prediction", "motion_prediction.md#measured")],
    "loops": [("models of places", "loop_closure_models.md#how-good-they-are")],
    "maintenance": [("maintenance and search", "maintenance_and_search.md")],
    "odometry": [("`bench/bench_registration.txt`", "../bench/bench_registration.txt")],
    "people": [("people in planar scans", "people.md")],
    "phd": [("filters of extended targets", "tracking.md")],
    "registration": [("`bench/bench_registration.txt`", "../bench/bench_registration.txt")],
    "search": [("maintenance and search", "maintenance_and_search.md#search-where-to-look-for-what-is-lost")],
    "slam": [("closing loops", "loop_closure.md")],
}


def node_page(node: str) -> str:
    """The page of a node."""
    own = {
        item.type.rpartition("/")[2]
        for item in interfaces_of(node)
        if item.type.startswith("whereabouts_msgs/")
    }
    fields = ", ".join(f"[{name}](../interfaces.md#{name.lower()})" for name in sorted(own))
    reading = ", ".join(f"[{title}](../{page})" for title, page in READING[node])
    return f"""<!-- Written by `make docs`. -->

# {node}

{SUMMARIES[node]} How it works: {reading}.

```
ros2 launch whereabouts {node}.launch.py       # on a ROS 2 machine; --show-args lists the arguments
whereabouts run {node}                         # without ROS's launch
whereabouts run {node} --bag BAG --lock-step   # on a recording
```

## Topics, services, actions

{markdown_table(interfaces_of(node))}

Fields, units and frames: {fields}. Every input takes ROS's QoS overrides, such as
`qos_overrides./scan.subscription.reliability`.

## Parameters

`config/{node}.yaml` states the defaults; † can only be set at the start. A value that is not allowed is refused with the
parameter's name and its range.

{parameter_table(model_of(node))}
"""


def interfaces_page(sources: Path) -> str:
    """All fields of whereabouts_msgs. sources : its folder."""
    parts = [
        "<!-- Written by `make docs`. -->",
        "# Messages, services and actions",
        "Of the package `whereabouts_msgs`, as in its files. Metres, radians, seconds; frames as in the headers.",
    ]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        parts.append(f"## {title}")
        for path in sorted((sources / kind).iterdir()):
            users = [
                f"[{node}](nodes/{node}.md)"
                for node in NODES
                if any(item.type == f"whereabouts_msgs/{path.stem}" for item in NODE_INTERFACES[node])
            ]
            used = f"\n\nUsed by {', '.join(users)}." if users else ""
            text = path.read_text(encoding="utf-8").strip()
            parts.append(f"### {path.stem}{used}\n\n```\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def with_interfaces(text: str) -> str:
    """The page with each `<!-- interfaces: NODE -->` section filled anew; `all` is what every node has."""

    def fill(match: re.Match[str]) -> str:
        items = COMMON if match[1] == "all" else NODE_INTERFACES[match[1]]
        return f"<!-- interfaces: {match[1]} -->\n{markdown_table(items)}\n<!-- end -->"

    return re.sub(r"<!-- interfaces: (\w+) -->\n.*?<!-- end -->", fill, text, flags=re.DOTALL)


def results_page(readme: str) -> str:
    """Every experiment with its command and its tables, taken from what README.md has measured.

    readme : the text of README.md; a paragraph that opens in bold belongs to the experiments whose commands it names.
    """
    measured = readme.partition("## Measured")[2].partition("\n## ")[0]
    blocks = re.split(r"\n(?=\*\*[A-Z])", re.sub(r"<!-- (measured|end) -->\n", "", measured))[1:]
    blocks = [block.strip().replace("](docs/", "](") for block in blocks]
    used: set[int] = set()
    parts = [
        "<!-- Written by `make docs` from the section Measured of README.md. -->",
        "# Results",
        "Every experiment, what it shows, its command, and its figures beside the reference's. Tables are shortened: the "
        "command prints all of them and draws the pictures, and `--json FILE` writes every figure. Where `--quick` "
        "stands, the figures below were measured with fewer repetitions of the same protocol. Experiments on recordings "
        "take the folder of recordings from `WHEREABOUTS_DATA`. `whereabouts experiment all --jobs 4`, or `--dask "
        "ADDRESS`, runs everything.",
    ]
    for name, module in experiments().items():
        own = [k for k, block in enumerate(blocks) if _names(block, name)]
        quick = any(re.search(rf"experiment [\w|]*\b{name}\b[\w|]* --quick", blocks[k]) for k in own)
        command = f"whereabouts experiment {name}{' --quick' if quick else ''}"
        parts.append(f"## {name}\n\n{(module.__doc__ or '').splitlines()[0]}\n\n```\n{command}\n```")
        for k in own:
            parts.append(f"See [above](#{_first(blocks, k)})." if k in used else blocks[k])
        used |= set(own)
        parts.append(
            "More: " + ", ".join(f"[{title}]({page})" for title, page in RESULTS_READING[name]) + "."
        )
    rest = [block for k, block in enumerate(blocks) if k not in used]
    return "\n\n".join([*parts, "## Beyond the experiments", *rest]) + "\n"


def _names(block: str, experiment: str) -> bool:
    """Whether a paragraph names an experiment's command, also as one of several, `experiment a|b`."""
    return re.search(rf"whereabouts experiment (\w+\|)*{experiment}\b", block) is not None


def _first(blocks: list[str], k: int) -> str:
    """The experiment under which a paragraph stands."""
    return next(name for name in experiments() if _names(blocks[k], name))


def pages(root: Path) -> dict[Path, str]:
    """All written files of a checkout and what they should hold."""
    readme = root / "README.md"
    written = {readme: with_interfaces(with_tables(readme.read_text(encoding="utf-8")))}
    written |= {root / "docs/nodes" / f"{node}.md": node_page(node) for node in NODES}
    return {**written, root / "docs/interfaces.md": interfaces_page(root / "whereabouts_msgs")}


def main() -> None:
    """Write them all; the results last, as they follow from README.md."""
    root = Path(__file__).resolve().parents[1]
    for path, text in pages(root).items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    readme = (root / "README.md").read_text(encoding="utf-8")
    (root / "docs/results.md").write_text(results_page(readme), encoding="utf-8")


if __name__ == "__main__":
    main()

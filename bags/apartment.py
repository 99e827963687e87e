"""Makes `bags/apartment.mcap`, the run of `make demo`: a robot's morning in a simulated apartment.

`python bags/apartment.py [OUT.mcap]`. `whereabouts.simulation.apartment_day` says what happens in it.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from whereabouts.simulation.home.apartment_bag import record


def main() -> None:
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("apartment.mcap")
    record(target)
    print(f"wrote {target}, {target.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

"""Settings of `registration.odometry.follower`."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.settings import check_settings, setting


@dataclass(frozen=True)
class OdometryConfig:
    """Settings of `Odometry`; each field's metadata has its unit, meaning and allowed range."""

    scan_method: str = setting(
        "local_map", "", "how planar scans are registered", choices=("local_map", "kiss_icp")
    )
    max_range: float = setting(80.0, "m", "points farther away are not used", 0.5, 1000.0)
    map_radius: float = setting(30.0, "m", "radius of the local map around the sensor", 1.0, 500.0)
    map_memory: float = setting(
        100.0, "m", "the local map forgets what was not seen again during this travel", 1.0, 1e6
    )
    key_distance: float = setting(0.15, "m", "travel after which a scan is added to the map", 0.0, 10.0)
    key_turn: float = setting(0.1, "rad", "turn after which a scan is added to the map", 0.0, 3.2)
    doubt: float = setting(0.3, "m", "how far a predicted scan may be off the map", 0.02, 2.0)
    tolerance: float = setting(
        0.08, "m", "largest deviation of a point from a line it belongs to", 0.005, 0.5
    )
    patience: int = setting(
        8, "", "a new local map begins after this many scans in a row that match nothing", 1, 10000
    )
    learn_offset: bool = setting(True, "", "learn and correct the scanner's constant range offset")
    scan_voxel_size: float = setting(0.2, "m", "KISS-ICP's voxel edge for planar scans", 0.01, 10.0)
    cloud_voxel_size: float = setting(0.8, "m", "KISS-ICP's voxel edge for clouds", 0.01, 10.0)
    cloud_noise: float = setting(0.05, "m", "standard deviation of a cloud point", 0.001, 1.0)
    static_distance: float = setting(
        0.2, "m", "a cloud point this close to the last cloud is static", 0.01, 5.0
    )

    def __post_init__(self) -> None:
        check_settings(self)

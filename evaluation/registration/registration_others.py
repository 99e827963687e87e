"""Other libraries on pairs of scans, behind the signature of `align`. None where a library is not installed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from registration import Registration, Scan

Aligner = Callable[[Scan, Scan], Registration]
HEIGHTS = (-0.2, -0.1, 0.0, 0.1, 0.2)  # metres, a scan is drawn up to for methods that need volume


def extruded_gicp() -> Aligner | None:
    """small_gicp on scans drawn up to walls, 1 m correspondences, 2 cm voxels."""
    try:
        import small_gicp
    except ImportError:
        return None

    def run(source: Scan, target: Scan) -> Registration:
        found = small_gicp.align(
            extruded(target), extruded(source), registration_type="GICP", downsampling_resolution=0.02
        )
        return _planar(found.T_target_source, found.converged)

    return run


def kiss_icp() -> Aligner | None:
    """KISS-ICP: the target is its first frame, the source its second."""
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.config.config import DataConfig, MappingConfig
        from kiss_icp.kiss_icp import KissICP
    except ImportError:
        return None

    def run(source: Scan, target: Scan) -> Registration:
        config = KISSConfig(
            data=DataConfig(max_range=30.0, min_range=0.0, deskew=False),
            mapping=MappingConfig(voxel_size=0.1),
        )
        engine = KissICP(config)
        for scan in (target, source):
            engine.register_frame(_lifted(scan), np.empty(0))
        return _planar(engine.last_pose, True)

    return run


def open3d_point_to_plane() -> Aligner | None:
    """Open3D's point-to-plane ICP on extruded scans."""
    try:
        import open3d
    except ImportError:
        return None
    registration = open3d.pipelines.registration

    def cloud(scan: Scan) -> object:
        points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(extruded(scan)))
        points.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=0.5, max_nn=20))
        return points

    def run(source: Scan, target: Scan) -> Registration:
        estimation = registration.TransformationEstimationPointToPlane()
        found = registration.registration_icp(cloud(source), cloud(target), 1.0, np.eye(4), estimation)
        return _planar(found.transformation, True)

    return run


def _lifted(scan: Scan) -> np.ndarray:
    points = scan.points()
    return np.column_stack((points, np.zeros(len(points))))


def extruded(scan: Scan) -> np.ndarray:
    """Points (N, 3) of a scan drawn up to walls: GICP needs volume."""
    flat = _lifted(scan)
    return np.concatenate([flat + np.array([0.0, 0.0, height]) for height in HEIGHTS])


def _planar(transform: np.ndarray, converged: bool) -> Registration:
    pose = np.array([transform[0, 3], transform[1, 3], np.arctan2(transform[1, 0], transform[0, 0])])
    return Registration(pose, np.full((3, 3), np.nan), float("nan"), converged)

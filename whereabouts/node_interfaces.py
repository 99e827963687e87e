# ruff: noqa: E501  (a table: one line for each interface)
"""Topics, services and actions of every node, by name, type and meaning.

The tables of README.md and docs/nodes/ are made of this, and a test holds it against what the running nodes really have.
Names are relative, but for those that begin with a slash; `~/` stands for the node's own name. Latched topics are kept for those who come late.
"""

from __future__ import annotations

from typing import NamedTuple


class Interface(NamedTuple):
    """way : in, out, service, action (served) or calls (an action), with ", optional" or ", latched" after it.

    when : the parameter without which it is not there, or that names it; "" for always.
    """

    way: str
    name: str
    type: str
    meaning: str
    when: str = ""

    @property
    def kind(self) -> str:
        """The way without what follows it."""
        return self.way.partition(",")[0]


_I = Interface


def _tf(meaning: str) -> tuple[Interface, Interface]:
    return _I("in", "tf", _TF, meaning), _I("in, latched", "tf_static", _TF, "the same")


_TF = "tf2_msgs/TFMessage"
_MARKERS = "visualization_msgs/MarkerArray"
_GRID = "nav_msgs/OccupancyGrid"
_POSE = "geometry_msgs/PoseWithCovarianceStamped"

# Absolute, as with all of ROS: one place for the health of everything on the graph, in whatever namespace it runs.
DIAGNOSTICS = "/diagnostics"

COMMON = (
    _I("out", DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray", "rates, latencies, drops by reason, losses, health"),
    _I("out", "~/processed", "whereabouts_msgs/Processed", "each input message that has been processed, except those on demand", "report_processed"),
    _I("out", "~/connections", "whereabouts_msgs/Connections", "which nodes it is connected to", "report_processed"),
    _I("in", "~/turn", "whereabouts_msgs/Connections", "in a lock-step replay: it is the node's turn to take in so many messages of each input", "report_processed"),
    _I("service", "~/reset", "whereabouts_msgs/Reset", "start anew; what is stored stays"),
)  # fmt: skip

NODE_INTERFACES: dict[str, tuple[Interface, ...]] = {
    "scan_registration": (
        _I("in", "scan", "sensor_msgs/LaserScan", "any mounting that tf knows, also upside down or tilted; scans of further sensors are joined to those of the first", "scan_topics"),
        _I("in", "points", "sensor_msgs/PointCloud2", "instead of scans", "cloud_topics"),
        _I("in, optional", "wheel_odom", "nav_msgs/Odometry", "initial guess", "wheel_topic"),
        *_tf("how the sensor is mounted"),
        _I("out", "odometry", "nav_msgs/Odometry", "pose and twist with covariance, one per scan, at the scan's stamp"),
        _I("out", "tf", _TF, "`odom` → `base_link`, unless somebody else places that frame"),
        _I("out", "static_points", "sensor_msgs/PointCloud2", "the scan without what moves, in `base_link`"),
        _I("out", "segments", "whereabouts_msgs/ScanSegments", "for a single level scanner: label and probability per beam, motion with covariance per moving segment", "segment_scans"),
    ),
    "loop_closure": (
        _I("in", "scan", "sensor_msgs/LaserScan", "scans that show the places", "scan_topic"),
        _I("in", "points", "sensor_msgs/PointCloud2", "instead of scans", "cloud_topic"),
        *_tf("`odom` → `base_link` at the scan's stamp, and how the sensor is mounted"),
        _I("in, optional", "odometry", "nav_msgs/Odometry", "where the robot was at a scan, and how sure that is, also where the base publishes the transform; see `odometry_source`"),
        _I("in, optional", "initialpose", _POSE, "where the robot is in a saved map"),
        _I("in, optional", "clicked_point", "geometry_msgs/PointStamped", "RViz's Publish Point: which closure `~/remove_closure` takes out"),
        _I("out", "loop_closures", "whereabouts_msgs/LoopClosure", "each accepted closure with relative pose and covariance"),
        _I("out, latched", "trajectory", "nav_msgs/Path", "corrected poses of the kept scans"),
        _I("out", "tf", _TF, "`map` → `odom`, with each scan and every `tf_period`"),
        _I("out, latched", "map", _GRID, "for nav2, of at most 25 million cells; of parts far apart only the one around the robot"),
        _I("out", "map_updates", "map_msgs/OccupancyGridUpdate", "the box of `map` that has changed, while there is a subscriber"),
        _I("out, latched", "map_points", "sensor_msgs/PointCloud2", "the map as points"),
        _I("out, latched", "~/markers", _MARKERS, "path and closures"),
        _I("service", "~/save_map", "whereabouts_msgs/SaveMap", "write map_saver's `.pgm` and `.yaml`, and the graph (`.npz`); a file is never half written"),
        _I("service", "~/load_map", "whereabouts_msgs/LoadMap", "read a map and find the robot in it; then extend it, or localise only"),
        _I("service", "~/pause", "std_srvs/SetBool", "true: leave scans out of the map, transforms go on; false: go on with it"),
        _I("service", "~/remove_closure", "std_srvs/Trigger", "take out the closure next to the clicked point, or the newest one, with all of the same revisit"),
        _I("service", "~/dynamic_map", "nav_msgs/GetMap", "the map now; empty where there is none yet"),
        _I("service", "map_server/map", "nav_msgs/GetMap", "the same, by nav2's name", "nav2_services"),
        _I("service", "map_server/load_map", "nav2_msgs/LoadMap", "as `~/load_map`, `localization_only` as the parameter says; by nav2's name", "nav2_services"),
        _I("service", "reinitialize_global_localization", "std_srvs/Empty", "look for the robot in the whole map anew; by amcl's name", "nav2_services"),
        _I("service", "map_saver/save_map", "nav2_msgs/SaveMap", "as `~/save_map`, by nav2's name; `.pgm`, trinary", "nav2_services"),
    ),
    "target_tracker": (
        _I("in", "scan", "sensor_msgs/LaserScan", "a level scanner; `odom_frame` → scanner must be in tf at the stamp", "scan_topic"),
        *_tf("where the scanner is"),
        _I("in, optional", "odometry", "nav_msgs/Odometry", "how uncertain the robot's pose is, if its frame is `odom_frame`"),
        _I("in, optional", "robot_pose", _POSE, "the same by localisation, if its frame is `odom_frame`; preferred"),
        _I("out", "targets", "whereabouts_msgs/TargetArray", "people in `odom_frame`, one message per scan. The class is a distribution over person and other. Covariances include that of the robot's pose"),
        _I("out", "~/markers", _MARKERS, "number, extent, velocity, trail; pale while hidden"),
        _I("service", "~/reset", "whereabouts_msgs/Reset", "forget everybody and the surroundings"),
    ),
    "motion_predictor": (
        _I("in", "targets", "whereabouts_msgs/TargetArray", "tracked people, in any frame that tf connects with `map_frame`"),
        *_tf("where that frame is"),
        _I("in, latched", "map", _GRID, "optional: walls that paths respect"),
        _I("out", "predicted_paths", "whereabouts_msgs/PredictedPathArray", "per person goals, probabilities, path and alternatives"),
        _I("out", "predicted_occupancy", "sensor_msgs/PointCloud2", "where people will be, in `base_frame`, for an obstacle layer of a nav2 costmap"),
        _I("out, latched", "people_mask", _GRID, "how probable it is, percent, that somebody will be at a cell of `map`; unknown where nobody will: the mask of a costmap filter", "publish_mask"),
        _I("out, latched", "people_filter_info", "nav2_msgs/CostmapFilterInfo", "makes a KeepoutFilter take `people_mask`", "publish_mask"),
        _I("out", "~/markers", _MARKERS, "paths, goals and their probabilities"),
        _I("service", "~/save", "whereabouts_msgs/SaveState", "write what was learned to one file"),
        _I("service", "~/load", "whereabouts_msgs/LoadState", "read it; another version, map or method is refused"),
        _I("service", "~/reset", "whereabouts_msgs/Reset", "as after a restart: back to the file of `model_path`, or to nothing learned"),
    ),
    "world_model": (
        _I("in", "evidence", "whereabouts_msgs/WorldEvidence", "detections of one observation, with the field of view; verifications by `object_id`"),
        _I("in", "detections", "vision_msgs/Detection3DArray", "detections of any detector; with `camera_info` what is missing counts, too, as far as it was in view", "detections_topic"),
        _I("in", "detections_2d", "vision_msgs/Detection2DArray", "boxes in the image of `camera_info`, in its frame; needs `depth` or `depth_from_scan`", "detections_2d_topic"),
        _I("in, optional", "camera_info", "sensor_msgs/CameraInfo", "what the camera can see; plumb_bob, rational_polynomial or straightened", "camera_info_topic"),
        _I("in, optional", "depth", "sensor_msgs/Image", "16UC1 (mm) or 32FC1 (m), registered to the image of `camera_info`: where boxes are, and what is hidden; a CompressedImage where the topic ends in `/compressedDepth`", "depth_topic"),
        _I("in, optional", "scan", "sensor_msgs/LaserScan", "instead of depth images, with `depth_from_scan`", "scan_topic"),
        _I("in", "targets", "whereabouts_msgs/TargetArray", "people; then people in other evidence are ignored"),
        _I("in, optional", "predicted_paths", "whereabouts_msgs/PredictedPathArray", "where targets will be while they are hidden"),
        _I("in, optional", "robot_pose", _POSE, "how uncertain the robot's pose in the map is"),
        *_tf("at the stamp of the evidence; covariances are turned, the robot's is added"),
        _I("out, latched", "world_state", "whereabouts_msgs/WorldState", "the most probable world, with predicates and places"),
        _I("out", "world_hypotheses", "whereabouts_msgs/WorldHypotheses", "all hypotheses, the most probable first"),
        _I("out", "objects", "vision_msgs/Detection3DArray", "what exists and is not lost"),
        _I("out", "~/markers", _MARKERS, "an ellipsoid and a sentence per object"),
        _I("service", "~/query", "whereabouts_msgs/QueryWorld", "by class, predicates, region, id and time, answered with probabilities"),
        _I("service", "~/forget", "whereabouts_msgs/ForgetObject", "remove objects from the world"),
        _I("service", "~/relabel", "whereabouts_msgs/RelabelObject", "correct a class or an id"),
        _I("service", "~/save", "whereabouts_msgs/SaveState", "complete copy of the store"),
        _I("service", "~/reset", "whereabouts_msgs/Reset", "begin a new run with an empty world; the stored history stays"),
    ),
    "verifier": (
        _I("in", "scan", "sensor_msgs/LaserScan", "where objects are searched", "scan_topic"),
        _I("in", "points", "sensor_msgs/PointCloud2", "instead of scans", "cloud_topic"),
        *_tf("where the sensor is"),
        _I("in, latched", "map", _GRID, "optional: what belongs to the building"),
        _I("action", "verify_object", "whereabouts_msgs/VerifyObject", "check a region: found, occluded or not found"),
    ),
    "world_maintenance": (
        _I("in, latched", "world_state", "whereabouts_msgs/WorldState", "the most probable world"),
        _I("in, latched", "base_available", "std_msgs/Bool", "false while another component moves the base; then only objects in view are verified"),
        _I("in, latched", "map", _GRID, "optional: paths avoid what is occupied"),
        *_tf("`map` → `base_link`"),
        _I("out", "verification_tasks", "whereabouts_msgs/VerificationTask", "object, 95 % region, sensor, expected gain, and why"),
        _I("out, latched", "maintenance_goal", "geometry_msgs/PoseStamped", "where the robot should stand"),
        _I("out", "evidence", "whereabouts_msgs/WorldEvidence", "what the verifier measured, or that the object is not there"),
        _I("service", "~/trigger", "whereabouts_msgs/TriggerVerification", "check an object first, for instance before it is grasped"),
        _I("calls", "verify_object", "whereabouts_msgs/VerifyObject", "once the robot is at the goal"),
        _I("calls", "navigate_to_pose", "nav2_msgs/NavigateToPose", "nav2's, to drive to the goal", "navigate"),
        _I("calls", "find_object", "whereabouts_msgs/FindObject", "to find lost objects", "search_for_lost"),
    ),
    "object_search": (
        _I("in, latched", "world_state", "whereabouts_msgs/WorldState", "what is in view, and what is known"),
        _I("in, latched", "map", _GRID, "optional: the middle of the room, and unseen floor"),
        *_tf("`map` → `base_link`"),
        _I("in, latched", "base_available", "std_msgs/Bool", "false while another component moves the base; a search on behalf of maintenance waits then"),
        _I("out, latched", "search_goal", "geometry_msgs/PoseStamped", "where to go next"),
        _I("out, latched", "base_available", "std_msgs/Bool", "false while it searches, so that maintenance does not move the base"),
        _I("out", "search_markers", _MARKERS, "the goal with its reason"),
        _I("calls", "navigate_to_pose", "nav2_msgs/NavigateToPose", "nav2's, to drive to the goals", "navigate"),
        _I("action", "find_object", "whereabouts_msgs/FindObject", "find an object by class, predicates or id; each goal comes with its reason in words"),
    ),
}  # fmt: skip


def interfaces_of(node: str) -> tuple[Interface, ...]:
    """A node's own and those of all nodes; its own word about one goes before the common one."""
    own = NODE_INTERFACES[node]
    said = {(item.kind, item.name) for item in own}
    return (*own, *(item for item in COMMON if (item.kind, item.name) not in said))

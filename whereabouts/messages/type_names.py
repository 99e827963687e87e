"""What the types of messages that sensors, cameras and detectors send are called in a bag and in the graph."""

SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
ODOMETRY, TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
IMU = "sensor_msgs/msg/Imu"
IMAGE, CAMERA_INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
BOXES, DETECTIONS = "vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"
EVIDENCE, TARGETS = "whereabouts_msgs/msg/WorldEvidence", "whereabouts_msgs/msg/TargetArray"
OBSERVED = (SCAN, CLOUD, ODOMETRY, TF, IMU, IMAGE, COMPRESSED, CAMERA_INFO, BOXES, DETECTIONS)
"""What `whereabouts doctor` and `setup` look at."""

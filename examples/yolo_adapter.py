"""Detections of yolo_ros (yolo_msgs/DetectionArray) as vision_msgs/Detection2DArray, for the node world_model."""

from contextlib import suppress

import rclpy
from rclpy.node import Node
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose
from yolo_msgs.msg import DetectionArray


class YoloAdapter(Node):
    def __init__(self):
        super().__init__("yolo_adapter")
        self.output = self.create_publisher(Detection2DArray, "detections_2d", 10)
        self.create_subscription(DetectionArray, "detections_in", self.pass_on, 10)

    def pass_on(self, message):
        # Stamp and frame of the image; empty where nothing was found.
        result = Detection2DArray(header=message.header)
        for found in message.detections:
            item = Detection2D(header=message.header, id=found.id)
            item.bbox.center.position.x = found.bbox.center.position.x
            item.bbox.center.position.y = found.bbox.center.position.y
            item.bbox.size_x, item.bbox.size_y = found.bbox.size.x, found.bbox.size.y
            named = ObjectHypothesisWithPose()
            named.hypothesis.class_id, named.hypothesis.score = found.class_name, found.score
            item.results = [named]
            result.detections.append(item)
        self.output.publish(result)


rclpy.init()
with suppress(KeyboardInterrupt):
    rclpy.spin(YoloAdapter())

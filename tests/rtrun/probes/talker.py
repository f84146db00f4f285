"""A program on rclpy: `talker COUNT` publishes at 1 kHz once there is a listener, which takes forever.

A `listener` does nothing else, a `relay` publishes what it takes on another topic.
"""

import sys
import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node(sys.argv[1])
if sys.argv[1] == "talker":
    publisher, count = node.create_publisher(String, "chatter", 1000), int(sys.argv[2])
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    sent = []

    def publish() -> None:
        """One message."""
        publisher.publish(String(data=str(len(sent))))
        sent.append(None)

    node.create_timer(0.001, publish)
    while len(sent) < count:
        rclpy.spin_once(node)
    time.sleep(0.5)
else:
    again = node.create_publisher(String, "again", 1000)
    take = again.publish if sys.argv[1] == "relay" else lambda message: None
    node.create_subscription(String, "chatter", take, 1000)
    rclpy.spin(node)

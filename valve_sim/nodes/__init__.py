"""The ROS 2 nodes. Modules named `*_shell` and few others import rclpy; the rest is tested without ROS."""

"""The ROS 2 nodes. Modules named `*_shell` and few others import rclpy; the rest is tested without ROS."""

import os

# Before NumPy is loaded: the matrices of a fit are small, and threads that wait for each other take many times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

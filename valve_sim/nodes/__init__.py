"""The ROS 2 nodes: one class each beside a core without ROS, made by the tables of their topics and parameters.

`valve`, `monitor`, `identification` and `profile` are the classes. They and what they are wired with import rclpy
(`wiring`, `receiving`, `spinning`, `node_clock`, `messages`, `obeyed_topics`, `monitor_inputs`); the rest is tested
without ROS.
"""

import os

# Before NumPy is loaded: the matrices of a fit are small, and threads that wait for each other take many times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

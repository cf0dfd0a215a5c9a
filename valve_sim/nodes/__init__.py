"""The ROS 2 nodes: one class each beside a core without ROS, made by the tables of their topics and parameters.

`valve`, `monitor`, `identification` and `profile` are the classes. They and what they are wired with import rclpy
(`wiring`, `receiving`, `spinning`, `node_clock`, `messages`, `obeying`, `monitor_inputs`); the rest is tested without
ROS.
"""

"""What a filling station has beside its valves: an OPC UA server, coils of a PLC, and an archive.

Modules named `*_node`, and `hearing`, import rclpy; the rest is tested without ROS. OPC UA and Modbus are extras, whose
libraries are imported where they run and nowhere else.
"""

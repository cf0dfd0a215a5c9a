"""What a filling station has beside its valves: a dispenser that opens them in turn, an OPC UA server, coils and contacts
of a PLC, and an archive.

Modules named `*_node` and `*_shell` import rclpy; the rest is tested without ROS. OPC UA and Modbus are extras, whose
libraries are imported where they run and nowhere else.
"""

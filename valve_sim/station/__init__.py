"""What a station of valves needs beside its nodes: an OPC UA server, and coils and contacts of a PLC.

Modules named `*_shell` import rclpy; the rest is tested without ROS. Each part is an extra, whose libraries are
imported where it runs and nowhere else.
"""

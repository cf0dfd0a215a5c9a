"""One valve: `ros2 launch valve_sim valve.launch.py params_file:=my.yaml namespace:=tank_1`."""

from launch import LaunchDescription
from valve_sim.nodes.launching import USE_SIM_TIME, one_node


def generate_launch_description() -> LaunchDescription:
    """The valve and its arguments."""
    return one_node("valve", "the valve", USE_SIM_TIME)

"""Opens and closes a valve once a second. Its last command is 0 V.

    python3 docs/examples/commander.py --ros-args -r coil_voltage:=/tank_1/valve/coil_voltage

It repeats each command ten times a second, so that the valve's command_timeout closes the valve if this process dies.
"""

import signal

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

VOLTS = 9.0
OPEN, PERIOD = 2, 10
"""Tenths of a second."""


class Commander(Node):
    """Publishes std_msgs/Float64, V, reliable."""

    def __init__(self) -> None:
        super().__init__("commander")
        self._voltage = self.create_publisher(Float64, "coil_voltage", 10)
        self._tenths = 0
        self.create_timer(0.1, self._step)

    def _step(self) -> None:
        self._voltage.publish(Float64(data=VOLTS if self._tenths % PERIOD < OPEN else 0.0))
        self._tenths += 1

    def close(self) -> None:
        """Command 0 V, and wait until the valve has it."""
        self._voltage.publish(Float64(data=0.0))
        self._voltage.wait_for_all_acked(Duration(seconds=1))


if __name__ == "__main__":
    # rclpy's own handlers would shut ROS down before 0 V is sent.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: signals.append(number))
    commander = Commander()
    while not signals:
        rclpy.spin_once(commander, timeout_sec=0.1)
    commander.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C comes a second time, from ros2 launch
    rclpy.try_shutdown()

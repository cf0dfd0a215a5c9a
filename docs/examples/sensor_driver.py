"""Publishes a laser's distances as the positions that monitor_node and recorders hear: stamped, in metres, + opens.

    python3 docs/examples/sensor_driver.py --ros-args -r measured:=/tank_1/valve/measured/joint_states

/lab/laser (sensor_msgs/Range) is 12.5 mm where the valve is closed, and less as it opens.
"""

import signal

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, Range

CLOSED = 12.5e-3


class SensorDriver(Node):
    """Subscribes to distances and publishes positions."""

    def __init__(self) -> None:
        super().__init__("sensor_driver")
        self._positions = self.create_publisher(JointState, "measured", qos_profile_sensor_data)
        self.create_subscription(Range, "/lab/laser", self._convert, qos_profile_sensor_data)

    def _convert(self, reading: Range) -> None:
        # The stamp is the time at which the sensor sampled; the time of arrival scatters by milliseconds.
        message = JointState(header=reading.header, name=["pilot_plunger"], position=[CLOSED - reading.range])
        self._positions.publish(message)


if __name__ == "__main__":
    # Ctrl-C in a terminal comes a second time, from ros2 launch; rclpy's own handlers would end with exit code -2 then.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: signals.append(number))
    executor = SingleThreadedExecutor()
    executor.add_node(SensorDriver())
    while not signals:
        executor.spin_once(timeout_sec=0.1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rclpy.try_shutdown()

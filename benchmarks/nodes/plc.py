"""How long from a PLC's write to the open valve that it reads: `python -m benchmarks.nodes.plc --strokes 100`.

Starts valve_node and plc_node as processes, and polls as a PLC does: at 100 Hz, and without pause. Of the time, 9.2 ms
are the valve's own (config/valve.yaml at 9 V). Needs ROS 2 and the extra modbus.
"""

from __future__ import annotations

import time

import numpy as np
from pymodbus.client import ModbusTcpClient

from benchmarks.common import parser
from benchmarks.nodes.driver import program, running

PORT = 15020
HOLD = 0.05
"""s open, and closed."""


def stroke_times(client: ModbusTcpClient, strokes: int, period: float) -> tuple[list[float], list[float]]:
    """For each stroke, s from the write to the first reading that is open; and s of each cycle of write and read."""
    taken, cycles, beat = [], [], 0
    for _ in range(strokes):
        for command in (0, 1):
            begin = due = time.perf_counter()
            reached = None
            while time.perf_counter() - begin < HOLD or (command and reached is None):
                beat = beat % 60000 + 1
                start = time.perf_counter()
                client.write_registers(0, [beat, command])
                status = client.read_holding_registers(10, count=8).registers
                cycles.append(time.perf_counter() - start)
                if command and reached is None and status[3]:
                    reached = time.perf_counter() - begin
                due += period
                time.sleep(max(0.0, due - time.perf_counter()))
            if reached is not None:
                taken.append(reached)
    return taken, cycles


def main() -> None:
    """Measure, and print."""
    known = parser("nodes.plc", __doc__)
    known.add_argument("--strokes", type=int, default=100)
    given = known.parse_args()
    nodes = {
        "valve": program("valve_node"),
        "plc": program("plc_node", f"port:={PORT}", "address:=127.0.0.1", package="station"),
    }
    with running(nodes, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_DOMAIN_ID="77"):
        client = ModbusTcpClient("127.0.0.1", port=PORT, timeout=5.0)
        beat = 0
        while True:  # until the valve is heard and a 1 counts
            if client.connect():
                beat += 1
                client.write_registers(0, [beat, 0])
                answer = client.read_holding_registers(11, count=1)
                if not answer.isError() and answer.registers[0] & 0b11000 == 0b10000:
                    break
            time.sleep(0.1)
        for name, period in (("at 100 Hz", 0.01), ("without pause", 0.0)):
            taken, cycles = stroke_times(client, given.strokes, period)
            low, middle, high = 1e3 * np.percentile(taken, [5, 50, 95])
            cycle, late = 1e3 * np.percentile(cycles, [50, 99])
            print(
                f"polled {name}: write to is_open {middle:.1f} ms ({low:.1f} to {high:.1f}, 90 %), "
                f"a cycle of write and read {cycle:.2f} ms (p99 {late:.2f})",
                flush=True,
            )
        client.close()


if __name__ == "__main__":
    main()

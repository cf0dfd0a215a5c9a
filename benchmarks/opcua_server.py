"""What the OPC UA server costs, and whether it grows: `python -m benchmarks.opcua_server`.

A server in a process of its own is written to and subscribed to by a client of asyncua; its memory is that of /proc.
"""

from __future__ import annotations

import asyncio
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common import parser, resident
from valve_sim.station.figures import Report, utc
from valve_sim.station.opcua_server import ServedValve, StationServer
from valve_sim.station.tables import OpcUaSettings

PORT = 48499
RATE = 135.0


def used() -> float:
    """Time of this process on the cores, s."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


async def serve(folder: Path, writes: int) -> None:
    """Serve one valve: many writes, then a steady rate of them until the parent has done its part."""
    settings = OpcUaSettings(folder=str(folder), address="127.0.0.1", port=PORT, anonymous_read=True)
    server = StationServer(settings, [ServedValve("/valve")])
    await server.start()
    for part in range(5):
        begin = time.perf_counter()
        for number in range(writes // 5):
            await server.put(Report("/valve", utc(time.time()), {"Live.CoilCurrent": float(number)}))
            if not number % 100:
                await asyncio.sleep(0)
        spent = 1e6 * (time.perf_counter() - begin) / (writes // 5)
        print(f"{(part + 1) * writes // 5:8d} writes: {resident():6.1f} MB, {spent:.0f} µs each", flush=True)
    begin, before = time.perf_counter(), used()
    for number in range(round(20 * RATE)):
        await server.put(Report("/valve", utc(time.time()), {"Live.CoilCurrent": float(number)}))
        await asyncio.sleep(max(0.0, begin + (number + 1) / RATE - time.perf_counter()))
    share = (used() - before) / (time.perf_counter() - begin)
    print(f"at {RATE:g} writes a second: {100 * share:.1f} % of a core", flush=True)
    begin, before = time.perf_counter(), used()
    for number in range(100):
        values = {name: float(number) for name in ("Stroke.T1", "Stroke.T2", "Stroke.ClosingTime", "Stroke.Residual")}
        await server.put(Report("/valve", utc(time.time()), {**values, "Stroke.Number": number}))
    spent = 1e3 * (time.perf_counter() - begin) / 100
    print(f"a stroke of 5 figures into the history: {spent:.1f} ms", flush=True)
    print("subscribe", flush=True)
    while await asyncio.to_thread(sys.stdin.readline):
        print(f"{resident():6.1f} MB", flush=True)
    await server.stop()


async def subscribe(subscriptions: int, process: subprocess.Popen[str]) -> None:
    """Make subscriptions and drop them."""
    from asyncua import Client, ua

    class Nothing:
        def datachange_notification(self, node: object, value: object, data: object) -> None: ...

    client = Client(f"opc.tcp://127.0.0.1:{PORT}/valve_sim/")
    await client.connect()
    node = client.get_node(ua.NodeId("valve.Stroke.T1", await client.get_namespace_index("urn:valve_sim:station")))
    assert process.stdin is not None and process.stdout is not None
    for part in range(5):
        for _ in range(subscriptions // 5):
            subscription = await client.create_subscription(1000, Nothing())
            await subscription.subscribe_data_change(node)
            await subscription.delete()
        process.stdin.write("\n")
        process.stdin.flush()
        memory = (await asyncio.to_thread(process.stdout.readline)).strip()
        print(f"{(part + 1) * subscriptions // 5:8d} subscriptions: {memory}", flush=True)
    await client.disconnect()


def main() -> None:
    """Run both, and print what was measured."""
    known = parser("opcua_server", __doc__)
    known.add_argument("--writes", type=int, default=1_000_000)
    known.add_argument("--subscriptions", type=int, default=10_000)
    known.add_argument("--serve", type=Path)
    given = known.parse_args()
    if given.serve is not None:
        asyncio.run(serve(given.serve, given.writes))
        return
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.opcua_server", "--serve", folder, "--writes", str(given.writes)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None and process.stdin is not None
            for line in iter(process.stdout.readline, "subscribe\n"):
                print(line, end="", flush=True)
            asyncio.run(subscribe(given.subscriptions, process))
            process.stdin.close()


if __name__ == "__main__":
    main()

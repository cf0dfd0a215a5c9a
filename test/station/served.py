"""An OPC UA server of two valves in a process of its own, which shows what it is told on its standard input.

`python served.py FOLDER PORT [anonymous]`: each line in is {"valve", "time", "values"}, each line out that it is done.
"""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

from valve_sim.station.figures import Report, utc
from valve_sim.station.opcua_server import ServedValve, StationServer
from valve_sim.station.tables import OpcUaSettings

VALVES = (ServedValve("/tank_1/valve", "SN-0007"), ServedValve("/tank_2/valve"))


async def recommission(valve: str) -> tuple[bool, str]:
    return True, f"{valve}: the next strokes are the baseline"


async def serve(folder: Path, port: int, allows_anonymous: bool) -> None:
    settings = OpcUaSettings(folder=str(folder), address="127.0.0.1", port=port, anonymous_read=allows_anonymous)
    server = StationServer(settings, VALVES, recommission=recommission)
    await server.start()
    print("ready", flush=True)
    while line := await asyncio.to_thread(sys.stdin.readline):
        told = json.loads(line)
        await server.put(Report(told["valve"], utc(told["time"]), told["values"]))
        print("done", flush=True)
    await server.stop()


if __name__ == "__main__":
    asyncio.run(serve(Path(sys.argv[1]), int(sys.argv[2]), "anonymous" in sys.argv))

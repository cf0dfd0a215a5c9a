"""Published measurements as tables: `python docs/examples/own_plants/make_csv.py DATA FOLDER`.

DATA holds what others have measured, in folders as their sites offer it; what is missing is left out:

    emps/DATA_EMPS.mat      a servo axis: https://www.nonlinearbenchmark.org (Janot, Gautier, Brunot 2019)
    maglev/force_NN.mat     a magnet and a ball: https://github.com/Bocchio01/062020-Lab-Mechatronics (MIT licence)
    hk1d/knob.npz           a haptic knob: https://github.com/Fadi-AlMasalmah/hk1d_ros2-1 (Apache-2.0)
    kicker/empty.npz        the coil of a robot's kicker: https://github.com/RoboJackets/robocup-firmware (Apache-2.0)
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat


def write(path: Path, **columns: object) -> None:
    """A table with these columns."""
    table = np.column_stack([np.ravel(np.asarray(own)) for own in columns.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.10g")


def make(data: Path, folder: Path) -> list[Path]:
    """The tables of what is there."""
    folder.mkdir(parents=True, exist_ok=True)
    if (data / "emps" / "DATA_EMPS.mat").exists():
        found = loadmat(data / "emps" / "DATA_EMPS.mat")
        write(folder / "emps.csv", t=found["t"], qm=found["qm"], vir=found["vir"])
    for path in sorted((data / "maglev").glob("force_*.mat")):
        rows = loadmat(path)["measurements"]
        rows[1, 0] = rows[1, 1]  # the first sample of some is the end of the sensor's range
        jump = int(np.argmin(np.diff(rows[1]))) + 1
        write(folder / f"{path.stem}.csv", t=rows[0] - rows[0, jump], distance=rows[1], current=rows[3], duty=rows[5])
    if (data / "hk1d" / "knob.npz").exists():
        knob = np.load(data / "hk1d" / "knob.npz")
        write(
            folder / "knob.csv", t=knob["timestamps"], position=knob["joint_position"], effort=knob["joint_effort"],
            external=knob["external_effort"],
        )  # fmt: skip
    if (data / "kicker" / "empty.npz").exists():
        for name, (current, voltage) in np.load(data / "kicker" / "empty.npz").items():
            write(folder / f"{name}.csv", t=np.arange(len(current)) / 200e3, current=current, voltage=voltage)
    return sorted(folder.glob("*.csv"))


if __name__ == "__main__":
    print(*make(Path(sys.argv[1]), Path(sys.argv[2])), sep="\n")

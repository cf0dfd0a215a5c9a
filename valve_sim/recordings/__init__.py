"""Recordings in and out: one valve's commands and measured samples as arrays with units and a clock."""

from valve_sim.files.channels import Signal
from valve_sim.recordings.events import SensorEvent, StrokeEvents, events_from_sensors
from valve_sim.recordings.left_out import LeftOut, find_left_out
from valve_sim.recordings.reading import list_valves, read_trace
from valve_sim.recordings.strokes import StrokePart, command_strokes, find_stroke_parts, stroke_numbers, stroke_starts
from valve_sim.recordings.summary import Gap, Rate, TraceSummary, describe
from valve_sim.recordings.trace import DriveErrors, Trace, TraceError
from valve_sim.recordings.trouble import another_valve, doubtful_units, left_out_finding, refuse_doubtful_units
from valve_sim.recordings.writing import CSV_COLUMNS, BagRecorder, write_bag, write_bags, write_csv

__all__ = [
    "CSV_COLUMNS",
    "BagRecorder",
    "DriveErrors",
    "Gap",
    "LeftOut",
    "Rate",
    "SensorEvent",
    "Signal",
    "StrokeEvents",
    "StrokePart",
    "Trace",
    "TraceError",
    "TraceSummary",
    "another_valve",
    "command_strokes",
    "describe",
    "doubtful_units",
    "events_from_sensors",
    "find_left_out",
    "find_stroke_parts",
    "left_out_finding",
    "list_valves",
    "read_trace",
    "refuse_doubtful_units",
    "stroke_numbers",
    "stroke_starts",
    "write_bag",
    "write_bags",
    "write_csv",
]

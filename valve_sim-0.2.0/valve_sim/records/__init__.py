"""What lasts of a valve: the record of its calibration, and the archive of its strokes, findings and alarms."""

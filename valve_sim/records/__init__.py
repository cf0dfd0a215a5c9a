"""What lasts of a valve: the archive of its strokes, findings and alarms, and the story that they tell."""

"""Tests of the room of recordings."""

"""Fits, diagnoses and monitoring of machines from recordings. Its rooms, and why: docs/architecture.md."""

"""Plants are composed: each holds a valve, none writes over another's members."""

from __future__ import annotations

import ast
from pathlib import Path

import valve_sim


def test_no_plant_inherits_from_another() -> None:
    """A plant that inherits overwrites what its parent relies on; one that holds another cannot."""
    classes = [
        node
        for path in Path(valve_sim.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    bases = {node.name: {getattr(base, "id", "") for base in node.bases} for node in classes}
    # A protocol says what a plant has; what it answers for those that have it not, they may well answer themselves.
    plants = {
        node.name
        for node in classes
        if any(getattr(item, "name", "") == "predict" for item in node.body) and "Protocol" not in bases[node.name]
    }
    assert {"ValvePlant", "OwnPlant", "EventPlant", "CommissionedPlant"} <= plants
    assert [name for name, own in bases.items() if plants & own] == []

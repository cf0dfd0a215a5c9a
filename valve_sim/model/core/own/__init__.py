"""Machines of a user's own: their equations as text, and what the engine makes of them.

`grammar` reads expressions, `units` checks their units, `equations` describes the machine to the engine (`hybrid`), and
`simulation` runs it: at once, with derivatives, or live.
"""

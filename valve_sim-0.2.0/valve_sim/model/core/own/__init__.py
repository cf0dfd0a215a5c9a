"""A machine of a user's own: its equations as text, and the integrator that is derived from them.

`grammar` reads expressions, `units` checks their units, `system` turns them into graphs of the `tracer`, `kernels`
turns the graphs into the steps of the integrator, `driver` is the integrator, and `simulation` runs it on arrays.
"""

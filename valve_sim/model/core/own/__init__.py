"""A machine of a user's own: its equations as text, and the integrator that is derived from them.

`grammar` reads expressions, `units` checks that they fit, `system` makes graphs of the `tracer` of them, `kernels` the
steps of the integrator, `driver` is the integrator, and `simulation` runs it on arrays.
"""

"""The engine of hybrid machines: a machine is data, and all that integrates it is derived from that.

`description` is a machine as data: states with flows, regions of modes, transitions. `system` derives its groups of
modes, switches and sliding, `kernels` their Taylor series, step sizes, guards and resets as machine code, with the
tangents of all of it. `driver` is the integrator, which calls them, `layout` says where everything stands, and
`compiled` runs machines on arrays. Nothing in here knows of any machine in particular.
"""

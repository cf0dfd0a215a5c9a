"""The core: the valve's equations written once, everything else derived from them.

Begin with `equations`; `valve_sim.model.effects` has a file for each effect. `tracer` turns them into graphs, `series`
and `kernels` turn the graphs into the steps of the integrator, `driver` is the integrator, and `lowering` and `machine`
compile it all. What uses it is in `valve_sim.model`: `simulation.simulate` and `simulation.run_numbers`, `runs.Run`
with or without derivatives, in pieces if need be, and `live.Live`. Machines of files have an engine of their own,
`hybrid`, made of the same tracer, series and compiler; `own.simulation.Machine` runs them whole, with derivatives, and
live.
"""

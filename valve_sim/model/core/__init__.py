"""The core: the valve's equations written once, everything else derived from them.

`equations` is the page to begin with; `valve_sim.model.effects` has a file for each effect. `tracer` makes graphs of
these, `series` and `kernels` make the steps of the integrator of the graphs, `driver` is the integrator, `lowering` and
`machine` compile it all. The ways in are `simulation.simulate` and `simulation.run_numbers`, `runs.Run` with or without
derivatives, in pieces if need be, and `stepper.Live`.
"""

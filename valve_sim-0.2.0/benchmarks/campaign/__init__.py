"""How often is the verdict of `diagnose` right? `python -m benchmarks.campaign --seeds 10`.

Blind recordings of the independent plants of test/plants (no line of their code is the package's): one, two or no
catalogued effects, disturbances that no catalogue holds, a plant of another form, a single opening. Where they are
asked for: recordings with the errors that laboratories make, recordings that are hard on a search, the coil's current
alone, and the pressure of an outlet alone. `diagnose` gets the traces and the declared valve and nothing else. What it
answers is compared with the truth, in a confusion table and in figures with targets. Every case is determined by its
family and seed. Needs no ROS.
"""

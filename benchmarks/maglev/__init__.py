"""A real electromagnet through the same diagnosis: `python -m benchmarks.maglev [FOLDER] [--predict FILE ...]`.

A ball jumps to a magnet whose voltage rises slowly, and the current dips while it moves. The declared model is a
resistance and a constant inductance. What it leaves is traced by `diagnose_plant`, and errors are printed before and
after, of the records that were fitted and of records that were left out. Then the inductance that other records of the
same magnet show says at which force the ball ought to lift off its support.

The records are of a magnetic levitation rig (INTECO MLS2EM), measured and published under the MIT licence by the owners
of github.com/Bocchio01/062020-Lab-Mechatronics. They are not part of this repository.
"""

"""Does a monitor warn when it should, only then, and what does it name? `python -m benchmarks.monitoring PART`.

A valve of an independent plant strokes, and `Monitor` stands beside it, live path and judgement in a row, faster than
real time. Each seed has dampings, noise, errors of stamps and commissioning strokes of its own.

healthy: alarms in strokes without fault, stamps off by 50 µs, noise white or coloured by turns. Wanted: at most one in
1000, and a residual within 10 % of the noise.
growth: Coulomb friction that grows over 50 strokes to five detection limits and stays. Wanted: an alarm within 5
strokes of having got there, the right name within 20, in 9 of 10 seeds. The limit is 1.5 mN with true stamps, 7.6 mN
where each command's is off by 50 µs, because a late command is hardly told from friction then.
laboratory: both at `--rates`, where dampings differ by 10 % from stroke to stroke, loads by a third of it, the sensor's
zero walks by 1 µm a stroke, and hum of 0.5 µm comes on top. Wanted at each rate: at most three alarms in 10,000
healthy strokes, the declared rate within their 95 % interval, friction named in 9 of 10 seeds.
coil: by the coil's current alone, 5 kHz with 1 mA of noise: healthy strokes, and friction that grows over 20 strokes.
gas: a leak or a clogged pilot orifice that begins in service, seen by the positions alone: is it named, and does its
95 % interval hold the truth?

Exit code 1 where a figure falls short. Needs no ROS.
"""

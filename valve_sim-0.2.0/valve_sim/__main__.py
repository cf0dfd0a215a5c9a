"""`python -m valve_sim` is `valve-sim`."""

from valve_sim.cli import main

if __name__ == "__main__":
    main()

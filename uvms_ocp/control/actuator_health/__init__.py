"""Commands and motion in, verdicts out: which thruster or joint does not do what it is asked, and what is left without it."""

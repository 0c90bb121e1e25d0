"""Command line: `run`, `check`, `mission`, `compare`, `campaign`, `show`, `estimate`, `plan`,
`list`, `check-robot`, `schema`, `new-robot`, `new-mission`, `excite`, `map`, `check-recording`,
`identify`, `export`.

Exit codes: 0 done, 1 internal error, 2 bad input or refused by pre-flight, 3 mission not completed
or no plan free of collision, 130 stopped by hand.
"""

BAD_INPUT = 2
NOT_COMPLETED = 3
INTERRUPTED = 130

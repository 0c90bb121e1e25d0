"""Command line: `run`, `check`, `mission`, `compare`, `campaign`, `show`, `estimate`, `plan`,
`list`, `check-robot`, `schema`, `new-robot`, `new-mission`, `excite`, `map`, `check-recording`,
`identify`, `export`. What they end with is in `uvms_ocp.cli.exit_codes`.
"""

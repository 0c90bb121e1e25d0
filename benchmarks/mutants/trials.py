"""Each mutant against its tests, in as many trees as there are jobs; what is known is kept in a
folder.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from recording.progress import show_progress

from mutants.sample import Mutant
from mutants.suite import Suite
from mutants.tree import Outcome, Tree

KILLED = "killed"
SURVIVED = "survived"
# times as long as without the mutant, and [s] for imports on a busy machine
_FACTOR = 3.0
_START = 60.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """What came of one mutant."""

    key: str
    verdict: str
    by: str
    """The test that noticed it, or how it showed otherwise."""
    n_tests: int
    seconds: float
    """[s] that it took."""
    tests: str
    """Fingerprint of the tests: a survivor has another chance with others."""


class Trials:
    """Runs mutants, and remembers."""

    def __init__(self, work: Path, suite: Suite, jobs: int) -> None:
        self._file = work / "trials.jsonl"
        self._suite = suite
        self._jobs = jobs
        self._trees: queue.SimpleQueue[Tree] = queue.SimpleQueue()
        for i in range(jobs):
            self._trees.put(Tree(work, f"tree{i}"))

    def run(self, mutants: Iterable[Mutant], hours: float) -> dict[str, Trial]:
        """Trials by their mutants' keys; none of those that `hours` did not suffice for."""
        known = self._known()
        end = time.monotonic() + 3600.0 * hours
        left = [mutant for mutant in mutants if mutant.key not in known]
        with ThreadPoolExecutor(self._jobs) as pool, self._file.open("a", encoding="utf-8") as file:
            trials = pool.map(
                lambda mutant: self._trial(mutant) if time.monotonic() < end else None, left
            )
            for done, trial in enumerate(trials, 1):
                if trial is not None:
                    known[trial.key] = trial
                    file.write(json.dumps(asdict(trial)) + "\n")
                    file.flush()
                show_progress(done, len(left))
        return known

    def _known(self) -> dict[str, Trial]:
        lines = self._file.read_text(encoding="utf-8").splitlines() if self._file.exists() else []
        trials = [Trial(**json.loads(line)) for line in lines if line.endswith("}")]
        return {
            trial.key: trial
            for trial in trials
            if trial.verdict == KILLED or trial.tests == self._suite.tests
        }

    def _trial(self, mutant: Mutant) -> Trial:
        tests = self._suite.tests_of(mutant)
        begin = time.monotonic()
        verdict, by = (
            (SURVIVED, "no test runs the line") if not tests else self._tried(mutant, tests)
        )
        return Trial(
            key=mutant.key,
            verdict=verdict,
            by=by,
            n_tests=len(tests),
            seconds=round(time.monotonic() - begin, 1),
            tests=self._suite.tests,
        )

    def _tried(self, mutant: Mutant, tests: list[str]) -> tuple[str, str]:
        timeout = _START + _FACTOR * sum(self._suite.seconds[name] for name in tests)
        with self._tree() as tree, tree.changed(mutant.file, mutant.source):
            outcome = tree.test(tests, timeout=timeout, options=("-x", "-n0"))
        return (SURVIVED, "") if outcome.code == 0 else (KILLED, _killer(outcome))

    @contextmanager
    def _tree(self) -> Iterator[Tree]:
        tree = self._trees.get()
        try:
            yield tree
        finally:
            self._trees.put(tree)


def _killer(outcome: Outcome) -> str:
    return outcome.failed[0] if outcome.failed else outcome.text[-120:]

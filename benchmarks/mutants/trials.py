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
# What tests of a mutant may take
_FACTOR = 3.0  # times as long as without the mutant
_START = 60.0  # [s] for imports on a busy machine


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """The verdict of the tests on one mutant."""

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
        finished = self._finished()
        end = time.monotonic() + 3600.0 * hours
        remaining = [mutant for mutant in mutants if mutant.key not in finished]

        def trial_in_time(mutant: Mutant) -> Trial | None:
            return self._trial(mutant) if time.monotonic() < end else None

        with ThreadPoolExecutor(self._jobs) as pool, self._file.open("a", encoding="utf-8") as file:
            trials = pool.map(trial_in_time, remaining)
            for done, trial in enumerate(trials, 1):
                if trial is not None:
                    finished[trial.key] = trial
                    file.write(json.dumps(asdict(trial)) + "\n")
                    file.flush()
                show_progress(done, len(remaining))
        return finished

    def _finished(self) -> dict[str, Trial]:
        """Trials of former runs that still count."""
        if not self._file.exists():
            return {}
        lines = self._file.read_text(encoding="utf-8").splitlines()
        trials = {}
        for line in lines:
            if not line.endswith("}"):  # a run was interrupted while it wrote it
                continue
            trial = Trial(**json.loads(line))
            if trial.verdict == KILLED or trial.tests == self._suite.tests:
                trials[trial.key] = trial
        return trials

    def _trial(self, mutant: Mutant) -> Trial:
        tests = self._suite.tests_of(mutant)
        begin = time.monotonic()
        verdict = SURVIVED
        by = "no test runs the line"
        if tests:
            verdict, by = self._tried(mutant, tests)
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
        if outcome.code == 0:
            return SURVIVED, ""
        return KILLED, _killer(outcome)

    @contextmanager
    def _tree(self) -> Iterator[Tree]:
        tree = self._trees.get()
        try:
            yield tree
        finally:
            self._trees.put(tree)


def _killer(outcome: Outcome) -> str:
    return outcome.failed[0] if outcome.failed else outcome.text[-120:]
